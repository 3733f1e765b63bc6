"""Damage to bytes: what a cosmic ray, a cut cable and somebody with ill will do to a file or a message."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Sequence
from typing import Any

TOKENS = (
    b"[", b"]", b"{", b"}", b'"', b"\\", b",", b":", b"-", b"\x00", b"\xff", b"\xed\xa0\x80", b"\\ud800", b"\r\n",
    b"NaN", b"1e999", b"9" * 40, b"null", b"true", b"%", b"&a ", b"*a ", b"[" * 300, b"PK\x03\x04",
    b"SQLite format 3\x00",
)  # fmt: skip
NUMBERS = (0, 1, 2**7, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 0.5, -0.0, 2**31, 2**63 - 1, 2**63, -(2**63), 2**64, 10**400, 1e9, -1e9, 1.0000001e9,
    1e308, 5e-324, float("nan"), float("inf"), "", "a", "\x00", "\n", "\x1b[2J", "é😀", "\ud800", "x" * 5000, [], {},
    [[]], [None], [0, 0], [0, 0, 0], ["a", "a"], ["a", "b"], "NaN", "../../etc/passwd", "semloc/scene_graph_update/2",
)  # fmt: skip


def damage(data: bytes, rng: random.Random, others: Sequence[bytes] = ()) -> bytes:
    """One input from another: bytes changed, moved, cut, put in; now and then with a piece of another input."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        at = rng.randrange(len(found) + 1)
        kind = rng.randrange(9)
        if kind == 0 and at < len(found):
            found[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del found[at : at + rng.choice((1, 2, 8, 64, 1024))]
        elif kind == 2:
            found[at:at] = rng.choice(TOKENS)
        elif kind == 3:
            found[at:at] = found[at : at + rng.choice((1, 8, 64, 512))]
        elif kind == 4:
            token = rng.choice(TOKENS)
            found[at : at + len(token)] = token
        elif kind == 5:
            size, order = rng.choice((1, 2, 4, 8)), rng.choice(("little", "big"))
            number = rng.choice(NUMBERS) % 256**size
            found[at : at + size] = number.to_bytes(size, order)
        elif kind == 6:
            found[at : at + 16] = rng.randbytes(rng.choice((1, 16)))
        elif kind == 7 and others:
            other = rng.choice(others)
            start = rng.randrange(len(other) + 1)
            found[at : at + 64] = other[start : start + rng.choice((16, 64, 4096))]
        elif kind == 8 and rng.random() < 0.2:
            del found[at:]
    return bytes(found)


def damage_json(data: bytes, rng: random.Random) -> bytes:
    """Another JSON document: values of other kinds, members gone, twice or new, what lists hold in another order."""
    document = json.loads(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        at, key = _somewhere(document, rng)
        if at is None:
            break
        kind = rng.randrange(8)
        if kind <= 2:
            at[key] = copy.deepcopy(rng.choice(VALUES))
        elif kind == 3:
            del at[key]
        elif kind == 4 and isinstance(at, list):
            at.insert(rng.randrange(len(at) + 1), copy.deepcopy(at[key]))
        elif kind == 4:
            at[rng.choice(("extra", "x", "class", "id", "full"))] = 1
        elif kind == 5:
            other, other_key = _somewhere(document, rng)
            if other is not None:
                at[key] = copy.deepcopy(other[other_key])
        elif kind == 6 and isinstance(at, list):
            rng.shuffle(at)
        elif kind == 7 and type(at[key]) in (int, float) and abs(at[key]) < 1e300:
            at[key] += rng.choice((-1, 1, 1e-9, 0.5, 1e6))
    text = json.dumps(document, ensure_ascii=rng.random() < 0.5)
    return text.encode("utf-8", "surrogatepass")


def _somewhere(document: Any, rng: random.Random) -> tuple[Any, Any]:
    """A container in the document and a key of it."""
    at = document
    while isinstance(at, dict | list) and at:
        key = rng.choice(list(at)) if isinstance(at, dict) else rng.randrange(len(at))
        inner = at[key]
        if not (isinstance(inner, dict | list) and inner) or rng.random() < 0.25:
            return at, key
        at = inner
    return None, None
