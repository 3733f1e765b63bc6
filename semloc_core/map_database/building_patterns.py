"""Which buildings of a map are meant: a site's, by patterns over their names, such as ``hq/*``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

from semloc_core.errors import MapError


def matching_buildings(names: Iterable[str], patterns: Sequence[str]) -> tuple[str, ...]:
    """The buildings that a pattern fits, by rising name.

    Args:
        names: a map's buildings.
        patterns: as the shell has them (``*``, ``?``, ``[…]``; a ``*`` takes ``/`` in, case counts); none: all.

    Raises:
        MapError: a pattern that fits no building.

    """
    known = sorted(names)
    if not patterns:
        return tuple(known)
    found: set[str] = set()
    for pattern in patterns:
        fits = [name for name in known if fnmatchcase(name, pattern)]
        if not fits:
            some = ", ".join(known[:8]) + (", …" if len(known) > 8 else "")
            raise MapError(f"expected a pattern that fits a building of the map: {some or 'none'} (got {pattern!r})")
        found.update(fits)
    return tuple(sorted(found))
