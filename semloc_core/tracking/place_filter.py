"""A discrete Bayes filter over the places of a map (several buildings at once); numpy only.

Prediction: the robot has walked d metres since, so that it is about d metres from where it was, along the map's
traversability edges (odometry's frame is turned against the map's by an unknown angle: only the length of a
displacement says anything). Correction: the likelihood of what has been seen (`semloc_core.matching.observation`) and
the encoder's similarity to each place.

An online graph remembers: one observation holds most of what those before it held, so they are no independent
evidence. Hence the past counts with an exponent ``memory`` below 1 for each step (a power prior), and steps are counted
in metres walked: a robot that stands still does not grow surer by asking again.

The answer is the place with most belief within the matching radius of it, not the one with most belief.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.tracking.filter_model import (
    NEIGHBOUR_M,
    FilterConfig,
    MapModel,
    MapPart,
    joined_model,
    map_model,
    map_part,
)

__all__ = [
    "NEIGHBOUR_M",
    "FilterConfig",
    "MapModel",
    "MapPart",
    "PlaceFilter",
    "joined_model",
    "map_model",
    "map_part",
]

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]

_MOST_LEGS = 8
"""A longer way than so many steps (a loop closure that moves the frame, most likely) says no more than that."""


def _carried(known: tuple[Floats, float] | None, rows: Ints) -> tuple[Floats, float] | None:
    """A belief, and metres walked since, by the rows of another map; None where nothing is left of it."""
    if known is None:
        return None
    kept = np.where(rows >= 0, known[0][np.maximum(rows, 0)], np.float32(0.0))
    total = kept.sum()
    return (kept / total, known[1]) if total > 0 else None


class PlaceFilter:
    """A belief over the M places of a map.

    Args:
        model: the map.
        config: options.
        only: (M,) bool, the places that the robot can be at; None for all.

    """

    def __init__(
        self, model: MapModel, config: FilterConfig | None = None, only: NDArray[np.bool_] | None = None
    ) -> None:
        self._map = model
        self.config = config or FilterConfig()
        self._prior: Floats = np.ones(model.n_places, dtype=np.float32)
        if only is not None:
            self._prior = only.astype(np.float32)
        self._prior /= self._prior.sum()
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        self._belief: Floats = self._prior
        self._past: tuple[Floats, float] | None = None  # a belief a step or more ago, metres walked since
        self._last: tuple[Floats, float] | None = None  # the one that will be it next

    @property
    def belief(self) -> Floats:
        """(M,) float32, sums to 1."""
        return self._belief

    def carry_over(self, other: PlaceFilter, rows: Ints) -> None:
        """Go on with what another filter believes of the places that both maps have.

        Of places that the other one did not have nothing was believed: they get what leaks everywhere, and what is
        seen there from now on. Where none is left that it believed in, nothing is known.

        Args:
            other: its map may have other buildings.
            rows: (M,) the row of each place in the other's map; -1 where it is not.

        """
        belief = _carried((other._belief, 0.0), rows)
        self.reset()
        if belief is not None:
            self._belief = belief[0]
        self._past, self._last = _carried(other._past, rows), _carried(other._last, rows)

    def update(self, evidence: Floats, walked_m: float) -> Floats:
        """Take in one observation.

        Args:
            evidence: (M,) float32, its row of `MapModel.evidence`.
            walked_m: metres since the last update.

        Returns:
            The belief, (M,) float32.

        """
        self._walk(walked_m)
        log = evidence + self._remembered()
        belief = np.exp(log - log.max())
        self._belief = belief / belief.sum()
        if self._last is None or self._last[1] == 0:
            self._last = (self._belief, 0.0)
        return self._belief

    def probabilities(self) -> Floats:
        """(M,) float32 belief that the robot is within the matching radius of each place."""
        near = self._map.matching
        return np.minimum(near.sums(self._belief[near.places]), np.float32(1.0))

    def ranking(self, n: int) -> tuple[Ints, Floats]:
        """The ``n`` likeliest answers, none within the matching radius of a likelier one: (n,) rows, probabilities."""
        near = self._map.matching
        probability = self.probabilities()
        left = probability.copy()
        rows: list[int] = []
        while len(rows) < n and (best := int(left.argmax())) not in rows and left[best] >= 0:
            rows.append(best)
            left[near.places[near.start[best] : near.start[best + 1]]] = -1.0
        chosen = np.array(rows, dtype=np.int64)
        return chosen, probability[chosen]

    def _walk(self, metres: float) -> None:
        if self._past is not None:
            self._past = (self._past[0], self._past[1] + metres)
        if self._last is not None:
            self._last = (self._last[0], self._last[1] + metres)
            if self._last[1] >= self.config.step_m:
                self._past, self._last = self._last, None

    def _remembered(self) -> Floats:
        """(M,) logarithm of what is believed before the observation: the past, moved and forgotten in part."""
        if self._past is None:
            with np.errstate(divide="ignore"):
                known: Floats = np.log(self._prior)
            return known
        belief, metres = self._past
        with np.errstate(divide="ignore"):
            log = np.log(self._moved(belief, metres))
        exponent = np.float32(self.config.memory ** max(metres / self.config.step_m, 1.0))
        remembered: Floats = np.where(np.isneginf(log), log, exponent * log)
        return remembered

    def _moved(self, belief: Floats, walked_m: float) -> Floats:
        """Belief after walking: a mixture over places about that far along the edges, and a leak to anywhere."""
        legs = min(max(1, int(np.ceil(walked_m / (NEIGHBOUR_M - self.config.spread_m)))), _MOST_LEGS)
        near = self._map.neighbourhoods
        kernel = near.kernel(min(walked_m / legs, NEIGHBOUR_M), self.config.spread_m)
        for _ in range(legs):
            # The distances are symmetric: row i holds the places that i is reached from.
            belief = near.sums(kernel * belief[near.places])
        leak = np.float32(self.config.leak)
        moved: Floats = (np.float32(1.0) - leak) * belief + leak * self._prior
        return moved
