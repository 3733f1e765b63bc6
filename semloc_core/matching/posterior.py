"""From similarities to probabilities, and from probabilities to an answer: match, or ambiguous between rivals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.map_database import LoadedMap
from semloc_core.matching.radius_index import RadiusIndex
from semloc_core.text import short_repr
from semloc_core.wire import Status

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Similarities = NDArray[np.float32]
NOTHING = 40.0
"""Weights below e to the power of less this are none."""
CANDIDATES = 256
"""How many of the most similar places are looked at for rivals; the rest is too unlike to be one."""
IN_MAP = 0.5
"""Below this probability of being in the map at all, an answer that is not accepted is unknown, not ambiguous."""
RIVAL_RATIO = 0.5
"""A place elsewhere rivals the best one from this fraction of its probability on."""


@short_repr
@dataclass(frozen=True, eq=False)
class Ranking:
    """Rows of the map to be shown, best first; rows no two of which are one answer; the probability of each.

    ``in_map`` is P(the robot is in one of the map's buildings), 1 where nothing speaks of it.
    """

    rows: Ints
    separate: Ints
    probability: dict[int, float]
    in_map: float = 1.0

    def doubted(self) -> Ranking:
        """The same places of which nothing stood the test: none of them is likely."""
        return Ranking(self.rows, self.rows[:1], dict.fromkeys(self.probability, 0.0), 0.0)

    def rivals(self) -> Ints:
        """Answers other than the first that are nearly as likely, by falling probability."""
        best = self.probability[int(self.rows[0])]
        elsewhere = [r for r in self.separate[1:].tolist() if self.probability[r] >= RIVAL_RATIO * best]
        return np.array(sorted(elsewhere, key=lambda row: -self.probability[row]), dtype=np.int64)


def status_of(probability: float, accept: float, in_map: float) -> Status:
    """What an answer with a match is called, by P(its best place is right) and P(the robot is in the map)."""
    if probability >= accept:
        return "match"
    return "ambiguous" if in_map >= IN_MAP else "unknown"


def most_similar(loaded: LoadedMap, z: Similarities, n: int, index: RadiusIndex) -> tuple[Ranking, Similarities]:
    """The places most similar to an embedding (D,), ``n`` to be shown; (M,) similarities to all places."""
    rows, _, everywhere = loaded.index.everywhere(z, max(CANDIDATES, n))
    shown, separate = rows[:n], np.array(modes(rows, index.within), dtype=np.int64)
    asked = np.concatenate([shown, separate])
    chances = place_probabilities(everywhere, loaded.model.temperature, asked, index.within)
    return Ranking(shown, separate, dict(zip(asked.tolist(), chances.tolist(), strict=True))), everywhere


def place_probabilities(
    similarities: NDArray[np.float32], temperature: float, rows: Ints, within: Callable[[int], Ints]
) -> Floats:
    """P(the truth lies within the match radius of a place), for each of some places on its own.

    A softmax over the similarities to all places of the map, its temperature fitted in training, summed over the
    places near each one. Not calibrated: nothing in it knows of a building that is not in the map.

    Args:
        similarities: (M,) cosine similarities of the query to every place of the map.
        temperature: of the softmax, > 0.
        rows: (K,) places asked for.
        within: gives the rows near a row, itself among them.

    Returns:
        (K,) float64 in [0, 1].

    """
    # Powers in float32, sums in float64, of those that are not nothing: far faster on a large map, and far more exact
    # than is shown.
    best = similarities.max()
    some = np.flatnonzero(similarities >= best - np.float32(NOTHING * temperature))
    weights = np.zeros_like(similarities)
    weights[some] = np.exp((similarities[some] - best) * np.float32(1.0 / temperature))
    total = float(weights.sum(dtype=np.float64))
    if not len(rows):
        return np.zeros(0, dtype=np.float64)
    near = [within(int(row)) for row in rows]  # each has the row itself, so none is empty
    starts = np.cumsum([0, *map(len, near[:-1])])
    sums = np.add.reduceat(weights[np.concatenate(near)].astype(np.float64), starts)
    chances: Floats = np.minimum(1.0, sums / total)
    return chances


def modes(rows: Ints, within: Callable[[int], Ints]) -> list[int]:
    """Thin a ranking to places that are not near a better-ranked one.

    Args:
        rows: (K,) places by falling similarity.
        within: gives the rows near a row.

    Returns:
        The best place of each neighbourhood, in the order given.

    """
    taken: set[int] = set()
    kept: list[int] = []
    for row in rows.tolist():
        if row not in taken:
            kept.append(row)
            taken.update(within(row).tolist())
    return kept
