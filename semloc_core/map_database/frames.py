"""Names of coordinate frames: each building of a map has its own."""

from __future__ import annotations

from collections.abc import Sequence

ALONE = "map"
"""REP-105's name for the frame that a robot is localised in: of a building that has the map for itself."""
BUILDING = "{building}"
"""In the option ``frame_id``: stands for a building's name."""


def frame_of(pattern: str, buildings: Sequence[str], building: str | None) -> str:
    """The frame of a building.

    Args:
        pattern: the option ``frame_id``: a name, in which ``{building}`` stands for the building's; or ``map``, which
            is a building's own name where the map holds several.
        buildings: of the whole map.
        building: which; None: of an answer that is in none.

    """
    if building is None:
        return ALONE if BUILDING in pattern else pattern
    if pattern == ALONE and len(buildings) > 1:
        return building
    return pattern.replace(BUILDING, building)
