"""Where a simulated robot goes: by way of random goals over the traversability graph, or along recorded poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from heapq import heappop, heappush
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from semloc_core.errors import ConfigError, GraphError
from semloc_core.graph import SceneGraph, ball, connected
from semloc_core.text import short_repr
from semloc_core.wire import Position

Neighbours = Mapping[str, Mapping[str, float]]


@short_repr
class WalkPoint(NamedTuple):
    """A point of a walk.

    Attributes:
        position: true position, metres.
        heading: direction of motion in the xy plane, radians.
        travelled: metres walked so far.
        near: place -> metres to it, of the one or two places from which the graph is seen here.

    """

    position: Position
    heading: float
    travelled: float
    near: Mapping[str, float]

    @property
    def place(self) -> str:
        """The nearest place."""
        return min(self.near, key=lambda place: (self.near[place], place))


class _Sample(NamedTuple):
    places: tuple[str, str]
    fraction: float
    position: Position
    heading: float
    travelled: float


class _Segment(NamedTuple):
    """A straight piece of a walk, and the places at its ends where these are places."""

    start: Position
    end: Position
    places: tuple[str, str] = ("", "")


def largest_component(graph: SceneGraph) -> list[str]:
    """The connected component with most places, sorted; of several, the one with the first id."""
    return max(connected(graph.neighbours), key=len)


def shortest_path(neighbours: Neighbours, start: str, goal: str) -> list[str]:
    """Places of a shortest path (Dijkstra) from ``start`` to ``goal``, both included; the goal must be reachable."""
    best, via = {start: 0.0}, {start: start}
    heap = [(0.0, start)]
    settled: set[str] = set()
    while heap:
        distance, place = heappop(heap)
        if place == goal:
            break
        if place in settled:
            continue
        settled.add(place)
        for other, length in neighbours[place].items():
            through = distance + length
            known = best.get(other, math.inf)
            # Equal ways are told apart by id, so that the order of a graph's dictionaries has no say.
            if other not in settled and (through < known or (through == known and place < via[other])):
                best[other], via[other] = through, place
                heappush(heap, (through, other))
    path = [goal]
    while path[-1] != start:
        path.append(via[path[-1]])
    return path[::-1]


def walk_to_goals(
    graph: SceneGraph, start: str, step_m: float, distance_m: float, rng: np.random.Generator
) -> Iterator[WalkPoint]:
    """Walk shortest paths from ``start`` to one random goal after the other, within its component.

    Args:
        graph: what is walked.
        start: a place, or empty for a random one of the largest component.
        step_m: metres from point to point.
        distance_m: where to stop, metres walked; no limit if 0.
        rng: chooses start and goals.

    Raises:
        GraphError: the graph has no places.
        ConfigError: ``start`` is not a place.

    """
    if not graph.places:
        raise GraphError("expected a graph with places to walk on (got none)")
    if start and start not in graph.places:
        raise ConfigError(f"expected a place of the graph to start from (got {start!r})")
    places = sorted(ball(graph.neighbours, start, math.inf)) if start else largest_component(graph)
    start = start or places[int(rng.integers(len(places)))]
    if all(length == 0 for place in places for length in graph.neighbours[place].values()):
        yield WalkPoint(graph.places[start], 0.0, 0.0, {start: 0.0})
        return
    segments = (
        _Segment(graph.places[a], graph.places[b], (a, b)) for a, b in _legs(graph.neighbours, places, start, rng)
    )
    for sample in _sample(segments, step_m):
        if distance_m and sample.travelled > distance_m * (1 + 1e-12):
            return
        a, b = sample.places
        length = graph.neighbours[a][b]
        near = {a: sample.fraction * length, b: (1 - sample.fraction) * length}
        yield WalkPoint(sample.position, sample.heading, sample.travelled, near)


def walk_along(graph: SceneGraph, poses: Sequence[Position], step_m: float) -> Iterator[WalkPoint]:
    """Follow recorded positions (m) in straight lines; the graph is seen from the place nearest to each point.

    Raises:
        GraphError: the graph has no places.

    """
    if not graph.places:
        raise GraphError("expected a graph with places to walk on (got none)")
    ids = sorted(graph.places)
    places = np.array([graph.places[place] for place in ids])
    segments = [_Segment(a, b) for a, b in pairwise(poses) if a != b]
    still = [_Sample(("", ""), 0.0, pose, 0.0, 0.0) for pose in poses[:1]]
    samples = _sample(iter(segments), step_m) if segments else iter(still)
    for sample in samples:
        nearest = ids[int(np.argmin(((places - np.array(sample.position)) ** 2).sum(axis=1)))]
        yield WalkPoint(sample.position, sample.heading, sample.travelled, {nearest: 0.0})


def _legs(
    neighbours: Neighbours, places: Sequence[str], start: str, rng: np.random.Generator
) -> Iterator[tuple[str, str]]:
    """Edges of an endless walk by way of random goals."""
    while True:
        others = [place for place in places if place != start]
        path = shortest_path(neighbours, start, others[int(rng.integers(len(others)))])
        yield from pairwise(path)
        start = path[-1]


def _sample(segments: Iterator[_Segment], step_m: float) -> Iterator[_Sample]:
    """Points every ``step_m`` of a polyline, from its start on."""
    travelled, heading, count = 0.0, 0.0, 0
    for start, end, places in segments:
        length = math.dist(start, end)
        if start[:2] != end[:2]:
            heading = math.atan2(end[1] - start[1], end[0] - start[0])
        while length > 0 and count * step_m <= travelled + length:
            fraction = min(max((count * step_m - travelled) / length, 0.0), 1.0)
            x, y, z = (p + fraction * (q - p) for p, q in zip(start, end, strict=True))
            yield _Sample(places, fraction, (x, y, z), heading, count * step_m)
            count += 1
        travelled += length
