"""What a Bayes filter over places needs of a map: distances along its edges and as the crow flies, and a likelihood.

Made building by building, so that a map of some of them is joined in no time; numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Labelspace, SceneGraph, storeys_of
from semloc_core.matching import (
    REACH_M,
    ObservationConfig,
    ObservationModel,
    RadiusIndex,
    Surroundings,
    slot_distances,
    surroundings,
)
from semloc_core.text import short_repr

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]

NEIGHBOUR_M = 4.0
"""How far along the edges one step of the prediction goes, metres; a longer way is more steps."""
TESTED_SPREAD_M = 1.0
"""How near a tested place the robot may be as well, standard deviation in metres."""
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


@short_repr
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


@short_repr
@dataclass(frozen=True, eq=False)
class MapModel:
    """What a filter needs of a map; made once for a map, read by any number of filters.

    Args:
        neighbourhoods: by geodesic distance, up to `NEIGHBOUR_M`.
        matching: by Euclidean distance on one storey, up to the matching radius: what counts as one answer.
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
        """What an observation says once its likeliest places were verified by layout (`semloc_core.matching.layout`).

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


@short_repr
@dataclass(frozen=True, eq=False)
class MapPart:
    """What a filter needs of one building, by itself; rows count from 0."""

    neighbourhoods: Neighbourhoods
    matching: Neighbourhoods
    mapped: Surroundings


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
    parts = [map_part(graph, labelspace, ids, radius_m) for graph, ids in zip(graphs, chosen, strict=True)]
    return joined_model(parts, config)


def map_part(
    graph: SceneGraph, labelspace: Labelspace, places: Sequence[str], radius_m: float = MATCH_RADIUS_M
) -> MapPart:
    """Read one building; arguments as of `map_model`."""
    slots = np.array([graph.index.slots[place] for place in places], dtype=np.int64)
    rows = [slot_distances(graph, place, REACH_M) for place in places]
    near_by = [np.flatnonzero(row[slots] <= NEIGHBOUR_M) for row in rows]
    metres = [row[slots][near].astype(np.float32) for row, near in zip(rows, near_by, strict=True)]
    positions = np.array([graph.places[place] for place in places], dtype=np.float64).reshape(-1, 3)
    on = storeys_of(graph)
    index = RadiusIndex(positions, np.array([on[place] for place in places], dtype=np.int32), radius_m)
    matches = [index.within(row) for row in range(len(places))]
    away = [np.linalg.norm(positions[near] - positions[row], axis=1) for row, near in enumerate(matches)]
    return MapPart(
        _rows(near_by, metres), _rows(matches, away), surroundings(graph, labelspace, places, distances=rows)
    )


def joined_model(parts: Sequence[MapPart], config: ObservationConfig | None = None) -> MapModel:
    """One map of some buildings, in the order of its rows."""
    mapped = Surroundings(
        np.concatenate([part.mapped.objects for part in parts]), np.concatenate([part.mapped.places for part in parts])
    )
    return MapModel(
        _joined([part.neighbourhoods for part in parts]),
        _joined([part.matching for part in parts]),
        ObservationModel(mapped, config),
    )


def _rows(places: Sequence[Ints], metres: Sequence[NDArray[np.floating[Any]]]) -> Neighbourhoods:
    start = np.concatenate([[0], np.cumsum([len(near) for near in places])]).astype(np.int64)
    none = np.zeros(0, dtype=np.int64)
    return Neighbourhoods(start, np.concatenate([none, *places]), np.concatenate([none, *metres]).astype(np.float32))


def _joined(parts: Sequence[Neighbourhoods]) -> Neighbourhoods:
    first = np.cumsum([0, *(part.n_places for part in parts)]).tolist()
    sizes = np.concatenate([np.diff(part.start) for part in parts])
    return Neighbourhoods(
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        np.concatenate([part.places + row for part, row in zip(parts, first, strict=False)]),
        np.concatenate([part.metres for part in parts]),
    )
