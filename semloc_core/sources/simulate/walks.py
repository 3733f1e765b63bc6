"""Walks through a building, and how much of it has been seen at each step: the graph as arrays and masks over them.

What a simulated run (`semloc_core.sources.simulate`) streams as messages, here for a whole walk at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from semloc_core.config import Spread
from semloc_core.errors import GraphError
from semloc_core.graph import DriftMeter, Floats, GraphArrays, Ints, nearest_parents
from semloc_core.sources.simulate.drift import Frame
from semloc_core.sources.simulate.sensor import Sensing
from semloc_core.text import short_repr

Bools = NDArray[np.bool_]
NEAR_M = 4.0
"""Objects so near were in range and written anew at a step, as far as a robot's own measure of drift goes."""
MEASURED = 50
"""Steps of the walk that this measure looks back at."""


class WalkConfig(Sensing, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the robot walks and what it sees."""

    distance_m: Annotated[float, Meta(gt=0.0, le=1e5, description="how far each walk goes, m")] = 40.0
    range_m: Annotated[float, Meta(ge=0.0, le=1e3, description="sensing range along traversability edges, m")] = 4.0
    object_noise_m: Annotated[Spread, Meta(description="standard deviation of an object's position, m per axis")] = 0.0


@short_repr
@dataclass(frozen=True, eq=False)
class Written:
    """When what the online graph has was written last, at each of T steps of a walk, and where the frame was then.

    A node that changes is written anew: once where nothing drifts, at each step that it is in range of where all does.

    Args:
        places: (T, P) number of a step of the whole walk; -1 for places that are not known.
        objects: (T, O) the same.
        metres: (S,) walked at each step of the whole walk.
        frames: S, where the run's frame has the building; empty where it is the building's own.
        here: (S, 3) where the robot truly was, metres.

    """

    places: Ints
    objects: Ints
    metres: Floats
    frames: tuple[Frame, ...]
    here: Floats

    def at(self, steps: Ints) -> Written:
        """Only some of the T steps."""
        return replace(self, places=self.places[steps], objects=self.objects[steps])

    def moved(self, positions: Floats, written: Ints) -> Floats:
        """(N, 3) positions in the building as they were written, at (N,) steps."""
        if not self.frames:
            return positions
        found = positions.copy()
        for number in np.unique(written[written >= 0]).tolist():
            found[written == number] = self.frames[number].of(positions[written == number])
        return found


@short_repr
@dataclass(frozen=True, eq=False)
class Walk:
    """T steps from place to neighbouring place.

    Args:
        graph: the building as this robot perceives it: P places, O objects.
        positions: (P, 3) float64, where its places truly are, metres.
        places: (T,) where the robot is.
        metres: (T,) walked so far (true metres).
        seen_places: (T, P) bool, what the online graph has at each step.
        seen_objects: (T, O) bool, the same.
        written: when that was written; None: nothing drifts, and all of it is new.

    """

    graph: GraphArrays
    positions: Floats
    places: Ints
    metres: Floats
    seen_places: Bools
    seen_objects: Bools
    written: Written | None = None

    @property
    def steps(self) -> int:
        """T."""
        return len(self.places)

    def truth(self) -> Floats:
        """(T, 3) where the robot truly is, metres."""
        truth: Floats = self.positions[self.places]
        return truth

    def at(self, steps: Ints) -> Walk:
        """Only some of the steps."""
        return replace(
            self,
            places=self.places[steps],
            metres=self.metres[steps],
            seen_places=self.seen_places[steps],
            seen_objects=self.seen_objects[steps],
            written=None if self.written is None else self.written.at(steps),
        )

    def ages(self, step: int) -> Floats:
        """(o,) metres walked since each object of the online graph at a step was written."""
        if self.written is None:
            return np.zeros(int(self.seen_objects[step].sum()))
        written = self.written.objects[step][self.seen_objects[step]]
        ages: Floats = self.metres[step] - self.written.metres[written]
        return ages

    def drift(self, step: int) -> float | None:
        """How much the frame drifts, as a robot would know at a step (`DriftMeter`)."""
        if self.written is None or not self.written.frames:
            return None
        # What was written at a step of the whole walk is what was in range then.
        number, meter = int(self.written.places[step, self.places[step]]), DriftMeter()
        positions = self.graph.object_positions[self.seen_objects[step]]
        for i in range(max(number - MEASURED, 0), number):
            before, after = self.written.frames[i], self.written.frames[i + 1]
            metres = float(self.written.metres[i + 1] - self.written.metres[i])
            here = self.written.here[i + 1]
            away = np.linalg.norm((positions - here)[:, :2], axis=1)
            moved = np.linalg.norm((after.of(positions) - before.of(positions))[:, :2], axis=1)
            for m, a in zip(moved[away <= NEAR_M].tolist(), away[away <= NEAR_M].tolist(), strict=True):
                if metres > 0:
                    meter.add(m, metres, a)
        return meter.drift

    def frame(self, step: int) -> Frame:
        """Where the run's frame has the building, as the robot perceives it, at a step."""
        # The robot's own place is always in range: it is written as the frame then is.
        if self.written is None or not self.written.frames:
            return Frame()
        return self.written.frames[int(self.written.places[step, self.places[step]])]

    def part(self, step: int) -> tuple[GraphArrays, int]:
        """The online graph at a step by itself, and the index of the robot's place in it."""
        graph, places, objects = self.graph, self.seen_places[step], self.seen_objects[step]
        if self.written is not None:
            graph = replace(
                graph,
                place_positions=self.written.moved(graph.place_positions, self.written.places[step]),
                object_positions=self.written.moved(graph.object_positions, self.written.objects[step]),
            )
        index = np.cumsum(places) - 1
        seen = graph.with_objects(objects)
        edges = seen.place_edges[:, places[seen.place_edges].all(axis=0)]
        parents = seen.object_parents[:, places[seen.object_parents[1]]]
        sightings = seen.sightings[:, places[seen.sightings[0]]]
        part = replace(
            seen,
            place_ids=tuple(seen.place_ids[i] for i in np.flatnonzero(places)),
            place_positions=seen.place_positions[places],
            place_edges=index[edges].astype(np.int64),
            object_parents=np.stack([parents[0], index[parents[1]]]).astype(np.int64),
            sightings=np.stack([index[sightings[0]], sightings[1]]).astype(np.int64),
        )
        return part, int(index[self.places[step]])


def walk(graph: GraphArrays, config: WalkConfig, rng: np.random.Generator) -> Walk:
    """Start anywhere and walk shortest paths to one random goal after the other.

    Walk, noise and flicker draw from generators of their own: another noise does not change the way.

    Args:
        graph: the building.
        config: how far, and what is seen.
        rng: source of all that is random.

    Raises:
        GraphError: no place has a neighbour to walk to.

    """
    way_rng, noise_rng, flicker_rng = rng.spawn(3)
    lengths = graph.edge_lengths()
    n = graph.n_places
    # An edge of no length would vanish from a sparse matrix.
    matrix = csr_matrix((np.maximum(lengths, 1e-9), tuple(graph.place_edges)), shape=(n, n))
    distances, via = dijkstra(matrix, directed=False, return_predecessors=True)
    places, metres = _way(connected_components(matrix, directed=False)[1], distances, via, config.distance_m, way_rng)
    perceived = _perceived(graph, config, noise_rng)
    in_range = distances[places] <= config.range_m
    seen_places = np.logical_or.accumulate(in_range, axis=0)
    now, seen_objects = _seen_objects(perceived, in_range, config.flicker_rate, flicker_rng)
    drifts = config.drift > 0
    frames = _frames(graph.place_positions[places], metres, config.drift, rng.spawn(1)[0]) if drifts else ()
    written = Written(
        _written(in_range, seen_places, drifts),
        _written(now & seen_objects, seen_objects, drifts),
        metres,
        frames,
        graph.place_positions[places],
    )
    return Walk(perceived, graph.place_positions, places, metres, seen_places, seen_objects, written)


def walks_through(graph: GraphArrays, config: WalkConfig, rng: np.random.Generator, number: int) -> Iterator[Walk]:
    """So many walks, one after the other; none through a building where no place has a neighbour to walk to."""
    for _ in range(number):
        try:
            way = walk(graph, config, rng)
        except GraphError:
            return
        yield way


def _way(
    component: NDArray[np.int32],
    distances: Floats,
    via: NDArray[np.int32],
    distance_m: float,
    rng: np.random.Generator,
) -> tuple[Ints, Floats]:
    size = np.bincount(component)
    starts = np.flatnonzero(size[component] > 1)
    if not len(starts):
        raise GraphError("expected a building with places to walk between (got none)")
    here = int(rng.choice(starts))
    goals = np.flatnonzero(component == component[here])
    places, metres = [here], [0.0]
    while metres[-1] < distance_m:
        goal = int(rng.choice(goals[goals != here]))
        path = [goal]
        while path[-1] != here:
            path.append(int(via[here, path[-1]]))
        for place in path[-2::-1]:
            metres.append(metres[-1] + float(distances[places[-1], place]))
            places.append(place)
            if metres[-1] >= distance_m:
                break
        here = goal
    return np.array(places, dtype=np.int64), np.array(metres)


def _perceived(graph: GraphArrays, config: WalkConfig, rng: np.random.Generator) -> GraphArrays:
    """The building with noise; an object that is moved goes to the place that is then nearest."""
    place_noise, object_noise = rng.spawn(2)
    if config.place_noise_m > 0:
        offsets = place_noise.normal(0.0, config.place_noise_m, graph.place_positions.shape)
        graph = replace(graph, place_positions=graph.place_positions + offsets)
    if config.object_noise_m > 0:
        moved = graph.object_positions + object_noise.normal(0.0, config.object_noise_m, graph.object_positions.shape)
        parents = nearest_parents(moved, graph.place_positions, np.unique(graph.object_parents[0]))
        graph = replace(graph, object_positions=moved, object_parents=parents)
    return graph


def _frames(here: Floats, metres: Floats, drift: float, rng: np.random.Generator) -> tuple[Frame, ...]:
    """The run's frame at each step, the first one the building's own."""
    frames = [Frame()]
    for position, step in zip(here[1:], np.diff(metres).tolist(), strict=True):
        frames.append(frames[-1].drifted(position, step, rng, drift))
    return tuple(frames)


def _written(now: Bools, seen: Bools, drifts: bool) -> Ints:
    """(T, N) the last step at which nodes that are now in range changed; -1 where they are not known."""
    changed = now.copy()
    if not drifts:
        changed[1:] &= ~seen[:-1]
    steps = np.where(changed, np.arange(len(now))[:, None], -1)
    return np.where(seen, np.maximum.accumulate(steps, axis=0), -1).astype(np.int64)


def _seen_objects(
    graph: GraphArrays, in_range: Bools, flicker_rate: float, rng: np.random.Generator
) -> tuple[Bools, Bools]:
    """(T, O) which objects are in range, and which ones the online graph has."""
    child, parent = graph.object_parents
    now = np.zeros((len(in_range), graph.n_objects), dtype=np.bool_)
    steps, links = np.nonzero(in_range[:, parent])
    now[steps, child[links]] = True
    if flicker_rate == 0:
        return now, np.logical_or.accumulate(now, axis=0)
    lost = rng.random(now.shape) < flicker_rate
    seen = np.zeros_like(now)
    for step, (near, off) in enumerate(zip(now, lost, strict=True)):
        seen[step] = np.where(near, ~off, seen[step - 1] if step else False)
    return now, seen
