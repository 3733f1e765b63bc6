"""Node ids as people read them: ``p86`` for Hydra's 64-bit ``8070450532247928918``, and back."""

from __future__ import annotations

import re
from collections.abc import Container

INDEX_BITS = 56
"""Of the 64 bits the last ones are a number; the first eight are a letter, the kind of node (`p` place, `O` object)."""
_SHORT = re.compile(r"([A-Za-z])\(?(\d{1,17})\)?")
_LETTERS = range(ord("A"), ord("z") + 1)


def node_number(letter: str, index: int) -> int:
    """The 64-bit id of the ``index``-th node of a kind; the index is below 2 to the `INDEX_BITS`."""
    return ord(letter) << INDEX_BITS | index


def short_id(id_: str) -> str:
    """``p86`` of a 64-bit id with a letter; any other id as it is."""
    if id_.isascii() and id_.isdigit() and len(id_) <= 20:
        prefix, index = divmod(int(id_), 1 << INDEX_BITS)
        if prefix in _LETTERS and chr(prefix).isalpha():
            return f"{chr(prefix)}{index}"
    return id_


def full_id(text: str, known: Container[str]) -> str:
    """The id that a person means: one that is known as it stands, else the 64-bit one of ``p86`` or ``p(86)``.

    Args:
        text: what was typed.
        known: ids.

    Returns:
        A known id, or the text where it means none: the caller's refusal then names what was typed.

    """
    if text in known:
        return text
    found = _SHORT.fullmatch(text)
    if found is not None and int(found[2]) < 1 << INDEX_BITS:
        long = str(node_number(found[1], int(found[2])))
        if long in known:
            return long
    return text
