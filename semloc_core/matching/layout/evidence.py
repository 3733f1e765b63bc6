"""What the test by layout rests on at one place of the map: each object seen, each class missed, each wall crossed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from semloc_core.graph import Floats
from semloc_core.matching.layout.building.objects_by_place import sums
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pose.expected_objects import expected_each
from semloc_core.matching.layout.pose.local_map import around_rows
from semloc_core.matching.layout.verifier import Verified


@dataclass(frozen=True, eq=False)
class Evidence:
    """The score of one place, taken apart: a sum, so each part is exactly what it adds.

    Args:
        row: of the map.
        score: log-likelihood ratio (natural): the objects as mapped around there, against all invented.
        fragment: what was seen, n objects.
        explained: (n,) what each adds, ≥ 0.
        missing: class -> what mapped objects of it that should have been seen take away, > 0.
        walls: what known places take away where the map has no room, ≥ 0.

    """

    row: int
    score: float
    fragment: Fragment
    explained: Floats
    missing: Mapping[int, float]
    walls: float


def evidence(mapped: MappedLayout, fragment: Fragment, verified: Verified, row: int) -> Evidence | None:
    """Take the score of a place apart; None for a place that was not put to the test.

    Args:
        mapped: the map.
        fragment: what is around the robot.
        verified: the test.
        row: of the map.

    """
    found = np.flatnonzero(verified.rows == row)
    if not len(found):
        return None
    i = int(found[0])
    there = around_rows(mapped, verified.rows[i : i + 1])
    turn, shift = np.exp(1j * verified.heading[i : i + 1]), verified.shift[i : i + 1] @ np.array([1.0, 1j])
    weight = mapped.config.looked * expected_each(mapped, fragment, there, turn, shift)
    by_class = sums(there.classes.astype(np.int64), weight, mapped.n_classes)
    return Evidence(
        row=row,
        score=float(verified.score[i]),
        fragment=fragment,
        explained=verified.explained[i],
        missing={int(c): float(by_class[c]) for c in np.flatnonzero(by_class > 0)},
        walls=float(verified.walls[i]),
    )
