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
            raise MapError(f"expected a pattern that fits a building of the map: {_some(known)} (got {pattern!r})")
        found.update(fits)
    return tuple(sorted(found))


def unknown_building(name: str, known: Sequence[str]) -> MapError:
    """The error for a building that a map does not have; says which ones it has."""
    return MapError(f"expected one of the map's buildings: {_some(known)} (got {name!r})")


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (", …" if len(names) > 8 else "") or "none"
