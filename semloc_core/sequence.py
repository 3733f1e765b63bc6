"""A discrete Bayes filter over the places of a map (several buildings at once); numpy only.

Prediction: the robot has walked d metres since, so that it is about d metres from where it was, along the map's
traversability edges (odometry's frame is turned against the map's by an unknown angle: only the length of a
displacement says anything). Correction: the likelihood of what has been seen (`semloc_core.observation`) and the
encoder's similarity to each place.

An online graph remembers: one observation holds most of what those before it held, so they are no independent
evidence. Hence the past counts with an exponent ``memory`` below 1 for each step (a power prior), and steps are counted
in metres walked: a robot that stands still does not grow surer by asking again.

The answer is the place with most belief within the matching radius of it, not the one with most belief.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.labelspace import Labelspace
from semloc_core.observation import (
    REACH_M,
    ObservationConfig,
    ObservationModel,
    Surroundings,
    slot_distances,
    surroundings,
)
from semloc_core.radius_index import RadiusIndex
from semloc_core.scene_graph import SceneGraph

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]

NEIGHBOUR_M = 4.0
"""How far along the edges one step of the prediction goes, metres; a longer way is more steps."""
TESTED_SPREAD_M = 1.0
"""How near a tested place the robot may be as well, standard deviation in metres."""
_MOST_LEGS = 8
"""A longer way than so many steps (a loop closure that moves the frame, most likely) says no more than that."""
_BIN_M = 0.25
"""Kernels are kept for distances rounded to this, metres."""


class FilterConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of `PlaceFilter`; the defaults were chosen on perturbed variants of map graphs."""

    evidence: Annotated[
        float, Meta(gt=0.0, le=1.0, description="exponent on the likelihood: objects are not independent either")
    ] = 1.0
    memory: Annotated[float, Meta(ge=0.0, le=1.0, description="exponent on the past for each step")] = 0.3
    step_m: Annotated[float, Meta(gt=0.0, le=10.0, description="metres walked that are one step")] = 1.0
    similarity: Annotated[
        float, Meta(ge=0.0, le=1e3, description="weight of the encoder's cosine similarity, once much has been seen")
    ] = 20.0
    much_places: Annotated[
        float, Meta(gt=0.0, le=1e6, description="known places within reach from which on much has been seen")
    ] = 200.0
    spread_m: Annotated[
        float, Meta(gt=0.0, le=10.0, description="standard deviation of the way along edges against the way walked, m")
    ] = 0.7
    leak: Annotated[
        float, Meta(gt=0.0, lt=1.0, description="chance, at each step, to be anywhere: a robot carried away, a lift")
    ] = 1e-4


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """Which places of a map are how far from which, as sparse rows (CSR); every place has a row, itself in it.

    Args:
        start: (M + 1,) int64, row i is start[i] … start[i + 1] - 1.
        places: (K,) int64.
        metres: (K,) float32 geodesic distances, symmetric.

    """

    start: Ints
    places: Ints
    metres: Floats
    _kernels: dict[tuple[int, float], Floats] = field(default_factory=dict, repr=False)

    @property
    def n_places(self) -> int:
        """M."""
        return len(self.start) - 1

    def sums(self, values: Floats) -> Floats:
        """(M,) sum of each row of (K,) values."""
        total: Floats = np.add.reduceat(values, self.start[:-1])
        return total

    def kernel(self, metres: float, spread_m: float) -> Floats:
        """(K,) P(the row's place | the other), if the robot walked ``metres``; kept for each rounded distance."""
        key = (round(metres / _BIN_M), spread_m)
        if key not in self._kernels:
            off = (self.metres - np.float32(key[0] * _BIN_M)) / np.float32(spread_m)
            weight = np.exp(np.float32(-0.5) * off * off) + np.float32(1e-9)
            total = self.sums(weight)
            # Distances are symmetric: the sum of a place's row is that of what leads away from it.
            self._kernels[key] = (weight / total[self.places]).astype(np.float32)
        return self._kernels[key]


@dataclass(frozen=True, eq=False)
class MapModel:
    """What a filter needs of a map; made once for a map, read by any number of filters.

    Args:
        neighbourhoods: by geodesic distance, up to `NEIGHBOUR_M`.
        matching: by Euclidean distance, up to the matching radius: what counts as one answer.
        observation: the likelihood.

    """

    neighbourhoods: Neighbourhoods
    matching: Neighbourhoods
    observation: ObservationModel

    @property
    def n_places(self) -> int:
        """M."""
        return self.neighbourhoods.n_places

    def evidence(self, seen: Surroundings, similarity: Floats, config: FilterConfig) -> Floats:
        """What N observations say for each place of the map, as logarithms up to a constant a row: (N, M) float32.

        Args:
            seen: what is known around the robot's place.
            similarity: (N, M) float32 cosine similarity of its embedding to each place of the map.
            config: the weights of both.

        """
        much = np.minimum(seen.places.sum(axis=1) / config.much_places, 1.0) * config.similarity
        likelihood = self.observation.log_likelihood(seen)
        log: Floats = np.float32(config.evidence) * likelihood + much[:, None].astype(np.float32) * similarity
        return log

    def tested(self, evidence: Floats, rows: Ints, score: Floats, sharpness: float) -> Floats:
        """What an observation says once its likeliest places were verified by layout (`semloc_core.layout`).

        Verification knows better than rings do: a place that was tested, and what is near it, has what the test
        says; all others are worse than the worst of these, ordered as before.

        Args:
            evidence: (M,) float32, a row of `evidence`.
            rows: (T,) places tested.
            score: (T,) float32 log-likelihood ratios.
            sharpness: exponent on these.

        Returns:
            (M,) float32.

        """
        worst = np.float32(sharpness) * score.min()
        combined: Floats = worst + np.minimum(np.float32(0.5) * (evidence - evidence.max()), np.float32(0.0))
        near = self.matching
        for row, value in zip(rows.tolist(), (np.float32(sharpness) * score).tolist(), strict=True):
            run = slice(int(near.start[row]), int(near.start[row + 1]))
            fades = np.float32(-0.5) * (near.metres[run] / np.float32(TESTED_SPREAD_M)) ** 2
            # One answer, one share of belief, however densely the map's places lie there.
            fades += np.float32(value) - np.log(np.exp(fades).sum())
            combined[near.places[run]] = np.maximum(combined[near.places[run]], fades)
        return combined


def map_model(
    graphs: Sequence[SceneGraph],
    labelspace: Labelspace,
    places: Sequence[Sequence[str]] | None = None,
    config: ObservationConfig | None = None,
    radius_m: float = MATCH_RADIUS_M,
) -> MapModel:
    """Read the buildings of a map: takes about a millisecond a place.

    Args:
        graphs: one a building, in the order of the map's rows.
        labelspace: of the map's model.
        places: of each graph, those that are in the map, in the order of its rows; None for all, by id.
        config: of the observation model.
        radius_m: the matching radius, metres.

    """
    chosen = [sorted(graph.places) for graph in graphs] if places is None else places
    sizes: list[int] = []
    near_by: list[Ints] = []
    metres: list[Floats] = []
    seen: list[Surroundings] = []
    first = 0
    for graph, ids in zip(graphs, chosen, strict=True):
        slots = np.array([graph.index.slots[place] for place in ids], dtype=np.int64)
        rows = [slot_distances(graph, place, REACH_M) for place in ids]
        for row in rows:
            near = np.flatnonzero(row[slots] <= NEIGHBOUR_M)
            sizes.append(len(near))
            near_by.append(near + first)
            metres.append(row[slots][near].astype(np.float32))
        seen.append(surroundings(graph, labelspace, ids, distances=rows))
        first += len(ids)
    mapped = Surroundings(np.concatenate([s.objects for s in seen]), np.concatenate([s.places for s in seen]))
    positions = np.array([graph.places[i] for graph, ids in zip(graphs, chosen, strict=True) for i in ids])
    building = np.repeat(np.arange(len(graphs), dtype=np.int32), [len(ids) for ids in chosen])
    index = RadiusIndex(positions.reshape(-1, 3), building, radius_m)
    matches = [index.within(row) for row in range(first)]
    away = [np.linalg.norm(positions[near] - positions[row], axis=1) for row, near in enumerate(matches)]
    return MapModel(
        Neighbourhoods(_starts(sizes), np.concatenate(near_by), np.concatenate(metres)),
        Neighbourhoods(
            _starts([len(near) for near in matches]),
            np.concatenate(matches),
            np.concatenate(away).astype(np.float32),
        ),
        ObservationModel(mapped, config),
    )


def _starts(sizes: Sequence[int]) -> Ints:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


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
