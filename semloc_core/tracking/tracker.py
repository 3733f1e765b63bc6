"""The filter over places as a localiser runs it: fed with an online graph, update by update."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import SceneGraph, Way
from semloc_core.map_database import LoadedMap
from semloc_core.matching import RIVALS, SHARPNESS, Ranking, Verified, surroundings
from semloc_core.tracking.place_filter import FilterConfig, MapModel, MapPart, PlaceFilter, joined_model, map_part
from semloc_core.wire import Odometry


class Tracker:
    """Where the robot has been says where it can be. Forgets nothing at a full update, a gap or a lost graph.

    How far it walked is the length of odometry's displacement, or without odometry that of the query place. After a
    gap the next observation comes with the whole displacement, and the belief is spread by it; a displacement
    across a restart, where the frame is another one, is as good as any: what is seen then outweighs it in a few steps.

    Args:
        loaded: the map, as loaded from a file (the scene graphs are read).
        config: of the filter.
        model: what the filter needs of that map, where it is known (`filter_part`).

    Raises:
        MapError: the map holds no scene graphs.

    """

    def __init__(self, loaded: LoadedMap, config: FilterConfig | None = None, model: MapModel | None = None) -> None:
        self._labelspace = loaded.model.labelspace
        self._map = loaded
        self._model = model or joined_model([filter_part(loaded, building) for building in loaded.buildings])
        self.filter = PlaceFilter(self._model, config)
        self._observed: tuple[SceneGraph, int] | None = None
        self._way = Way()
        self._in_map = 0.0

    def observe(
        self,
        graph: SceneGraph,
        place: str,
        similarity: NDArray[np.float32],
        odometry: Odometry | None,
        verified: Verified | None = None,
        in_map: float | None = 1.0,
    ) -> None:
        """Take in the graph as it is; once, however often it is asked.

        Args:
            graph: what the robot knows.
            place: where in it the robot is.
            similarity: (M,) of the place's embedding to all places of the map.
            odometry: of the last update, or None.
            verified: what verification by layout made of it, or None.
            in_map: P(the robot is in the map), by that verification; None where it had nothing to say: what it said
                last still holds, and before it has said anything, nothing speaks for the map.

        """
        if self._observed is not None and self._observed[0] is graph and self._observed[1] == graph.version:
            return
        self._observed = (graph, graph.version)
        seen = surroundings(graph, self._labelspace, [place])
        evidence = self._model.evidence(seen, similarity[None], self.filter.config)[0]
        if verified is not None:
            evidence = self._model.tested(evidence, verified.rows, verified.score.astype(np.float32), SHARPNESS)
        self._in_map = self._in_map if in_map is None else in_map
        self.filter.update(evidence, self._way.step(graph.places[place], odometry))

    def carry_over(self, other: Tracker) -> None:
        """Go on with what another one knows, as far as its map has the same places of the same buildings."""
        self.filter.carry_over(other.filter, _same_places(self._map, other._map))
        self._observed, self._way, self._in_map = other._observed, other._way, other._in_map

    def likely_buildings(self, least: float) -> tuple[str, ...]:
        """Buildings that the filter gives at least so much belief."""
        belief = np.bincount(self._map.building_index, self.filter.belief, len(self._map.buildings))
        return tuple(self._map.buildings[number] for number in np.flatnonzero(belief >= least).tolist())

    def ranking(self, n: int) -> Ranking:
        """The ``n`` likeliest answers, and those that may rival the first."""
        rows, chances = self.filter.ranking(max(RIVALS, n))
        # The filter believes that the robot is somewhere in the map; verification may know better.
        sure = (chances.astype(np.float64) * self._in_map).tolist()
        return Ranking(rows[:n], rows, dict(zip(rows.tolist(), sure, strict=True)), self._in_map)


def filter_part(loaded: LoadedMap, building: str) -> MapPart:
    """What a filter needs of one building of a map: takes about a millisecond a place.

    Raises:
        MapError: the map holds no scene graphs.

    """
    return map_part(loaded.graph(building), loaded.model.labelspace, loaded.place_ids[loaded.rows_of(building)])


def _same_places(new: LoadedMap, old: LoadedMap) -> NDArray[np.int64]:
    """(M,) the old row of each of the new map's places, by building and id; -1 where there is none."""
    found = np.full(new.n_places, -1, dtype=np.int64)
    for building in set(new.buildings) & set(old.buildings):
        mine, theirs = new.rows_of(building), old.rows_of(building)
        ids, known = new.place_ids[mine], old.place_ids[theirs]
        if ids == known:
            found[mine] = np.arange(theirs.start, theirs.stop)
        else:
            row_of = {place: row for row, place in enumerate(known, theirs.start)}
            found[mine] = [row_of.get(place, -1) for place in ids]
    return found
