"""Intervals of figures that are means over places: whole squares of the building are drawn, not single places."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Floats, Ints

BLOCK_M = MATCH_RADIUS_M
"""Neighbouring places see the same objects: whole squares of this side are drawn, metres."""

Statistic = Callable[[int, Floats], float]
"""(run, weight of each place (Q,)) -> the figure in that run."""


def bootstrap(
    of: Statistic, squares_of: Sequence[Ints], draws: int, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Mean of a figure over runs, and its 95 % interval.

    Args:
        of: the figure in one run.
        squares_of: of each run (Q,) the square of each place, 0 … B-1.
        draws: how many.
        rng: draws runs with replacement, and in each run squares with replacement.

    """
    figure = float(np.mean([of(r, np.ones(len(s))) for r, s in enumerate(squares_of)]))
    found = []
    for _ in range(draws):
        values = []
        for r in rng.integers(0, len(squares_of), len(squares_of)).tolist():
            number = int(squares_of[r].max(initial=-1)) + 1
            weight = np.bincount(rng.integers(0, number, number), minlength=number).astype(np.float64)[squares_of[r]]
            values.append(of(r, weight))
        found.append(np.mean(values))
    known = np.array(found)[~np.isnan(found)]
    if len(known) == 0:
        return figure, float("nan"), float("nan")
    return figure, float(np.percentile(known, 2.5)), float(np.percentile(known, 97.5))


def squares(positions: Floats) -> Ints:
    """(Q,) number of the square, of side `BLOCK_M`, that each place lies in."""
    _, number = np.unique(np.floor(positions / BLOCK_M).astype(np.int64), axis=0, return_inverse=True)
    return number.reshape(-1).astype(np.int64)
