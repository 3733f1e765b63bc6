"""The search's answer put to the test by layout, as a localiser does it: `matching.layout` on a live graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Ages, GraphArrays, SceneGraph
from semloc_core.map_database import LoadedMap, object_weights
from semloc_core.matching.layout import LayoutPart, LayoutVerifier, Verified, fragment_of_graph
from semloc_core.matching.layout.answers import Answers
from semloc_core.matching.layout.confidence import confidence
from semloc_core.matching.layout.evidence import Evidence, evidence, evidence_at
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.pose.placed import Placed, placed
from semloc_core.matching.layout.ready import ready
from semloc_core.matching.posterior import Ranking, modes
from semloc_core.text import short_repr

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

_VERIFIERS: WeakKeyDictionary[LoadedMap, LayoutVerifier | None] = WeakKeyDictionary()


def verifier_of(loaded: LoadedMap) -> LayoutVerifier | None:
    """The verifier of a map, made once for it however many localisers share it; None for a map without scene graphs."""
    if loaded not in _VERIFIERS:
        _VERIFIERS[loaded] = _make(loaded) if len(loaded.stored) == len(loaded.buildings) else None
    return _VERIFIERS[loaded]


def share_verifier(loaded: LoadedMap, verifier: LayoutVerifier) -> None:
    """Give a map the verifier that was made for it elsewhere."""
    _VERIFIERS[loaded] = verifier


def _make(loaded: LoadedMap) -> LayoutVerifier:
    read = [_read(loaded, building) for building in loaded.buildings]
    return LayoutVerifier(
        [graph for graph, _, _ in read],
        [rows for _, rows, _ in read],
        len(loaded.model.labelspace),
        weights=[weights for _, _, weights in read],
        storeys=[loaded.storeys[loaded.rows_of(building)] for building in loaded.buildings],
    )


def layout_part(loaded: LoadedMap, building: str) -> LayoutPart:
    """One building of a map, ready to be verified together with others; see `LayoutVerifier.joined`."""
    graph, rows, weights = _read(loaded, building)
    on = loaded.storeys[loaded.rows_of(building)]
    return LayoutPart.of(graph, rows, len(loaded.model.labelspace), weights, on)


def _read(loaded: LoadedMap, building: str) -> tuple[GraphArrays, Ints, NDArray[np.float64]]:
    """A building, its places that are in the map, and how surely each of its objects is still there."""
    graph, labelspace = loaded.graph(building), loaded.model.labelspace
    arrays = GraphArrays.from_scene_graph(graph, labelspace, building)
    by_id = object_weights(graph, labelspace, loaded.history(building), loaded.class_weights)
    weights = np.array([by_id[key] for key in arrays.object_ids], dtype=np.float64)
    index = {place: i for i, place in enumerate(arrays.place_ids)}
    rows = np.array([index[p] for p in loaded.place_ids[loaded.rows_of(building)]], dtype=np.int64)
    return arrays, rows, weights


@short_repr
@dataclass(frozen=True, eq=False)
class Reranked:
    """What verification made of an answer.

    Args:
        ranking: the places tested and the search's, by falling probability.
        verified: the test itself.
        fragment: what was put to it.

    """

    ranking: Ranking
    verified: Verified
    fragment: Fragment


class Reranker:
    """Puts answers to the test.

    Args:
        loaded: the map.
        verifier: of that map.
        within: gives the rows near a row of the map, itself among them.

    """

    def __init__(self, loaded: LoadedMap, verifier: LayoutVerifier, within: Callable[[int], Ints]) -> None:
        self._labelspace = loaded.model.labelspace
        self._verifier = verifier
        self._within = within
        ready()

    def rank(
        self,
        graph: SceneGraph,
        place: str,
        similarity: NDArray[np.float32],
        raw: Ints,
        top_n: int,
        ages: Ages | None = None,
        only: NDArray[np.bool_] | None = None,
        robot: Floats | None = None,
        past: Callable[[Answers], Floats] | None = None,
    ) -> Reranked | None:
        """Test the likeliest places of the map for one place of a graph.

        Args:
            graph: what the robot knows.
            place: where in it the robot is.
            similarity: (M,) of the place's embedding to all places of the map.
            raw: rows of the search's answer, best first: they follow what was tested.
            top_n: how many places to list.
            ages: of the graph's objects; None: all are new.
            only: (M,) bool, the places that the robot can be at; None for all.
            robot: (3,) metres, where in the graph's frame it is; None: at the place.
            past: says by how much each of the A answers, (A,), is likelier by what was before; None: as they say.

        Returns:
            The answer; None where no object around the robot fits anything in the map.

        """
        verifier = self._verifier
        drift = None if ages is None else ages.drift
        fragment = fragment_of_graph(graph, self._labelspace, place, verifier.config, ages, drift)
        found = verifier.verify(fragment, similarity, only)
        if found is None:
            return None
        sure = confidence(found, fragment, verifier.mapped, robot=robot)
        if past is not None:
            sure = sure.weighed(past(sure.answers))
        # Between floors the likeliest place of each is listed, found or not.
        beside = sure.answers.on_each_storey(verifier.mapped)
        known = set(found.rows.tolist())
        rest = np.array([row for row in dict.fromkeys([*beside, *raw.tolist()]) if row not in known], dtype=np.int64)
        # What was not tested is as likely as what was tested near it says, and is listed where that puts it.
        rows, chances = sure.listed(rest)
        probability = dict(zip(rows.tolist(), chances.tolist(), strict=True))
        apart = rows[np.isin(rows, [*known, *beside])]
        shown, separate = rows[:top_n], np.array(modes(apart, self._within), dtype=np.int64)
        return Reranked(Ranking(shown, separate, probability, sure.in_map), found, fragment)

    def placed(self, tested: Reranked, rows: Sequence[int]) -> Mapping[int, Placed]:
        """Where the robot's frame lies in the buildings of rows of the map, see `layout.pose.placed`."""
        return placed(self._verifier.mapped, tested.fragment, tested.verified, rows)

    def evidence(self, tested: Reranked, row: int) -> Evidence:
        """What the test rests on at a row of the map; one that was not tested is, now."""
        found = evidence(self._verifier.mapped, tested.fragment, tested.verified, row)
        return found or evidence_at(self._verifier, tested.fragment, row)
