"""What a simulated robot perceives of a building: detector errors, ids of its own, the graph as revealed so far."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from semloc_core.config import Checked, Share, Spread
from semloc_core.graph import SceneGraph
from semloc_core.sources.simulate.drift import Frame
from semloc_core.text import short_repr
from semloc_core.wire import Object, Place, Position

INVENTED_WITHIN_M = 1.5
"""An invented object lies at most this far (per axis) from the place that it is attached to."""


class Sensing(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What errs in what a robot sees as it walks."""

    flicker_rate: Annotated[
        Share, Meta(description="chance, at each update, that an object in range is lost until seen again")
    ] = 0.0
    place_noise_m: Annotated[Spread, Meta(description="standard deviation of a place's position, m per axis")] = 0.0
    drift: Annotated[
        Spread, Meta(description="drift of the updates' frame; 1: 0.5° and 0.03 m per axis, a root metre")
    ] = 0.0


class DetectorErrors(Sensing, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How far a detector is from the truth."""

    miss_rate: Annotated[Share, Meta(description="share of the objects that are never detected")] = 0.1
    false_rate: Annotated[Spread, Meta(description="invented objects for each true one")] = 0.05
    mislabel_rate: Annotated[Share, Meta(description="share of the detected objects that get another class")] = 0.0
    position_noise_m: Annotated[Spread, Meta(description="standard deviation of an object's position, m per axis")] = (
        0.1
    )


@short_repr
@dataclass(frozen=True)
class Perceived:
    """The whole building as this robot would perceive it; it never gets to see what is not in here.

    Attributes:
        places: place id -> position (m) with noise; ids are the building's.
        objects: object id -> object with noise and perhaps another class; ids are the building's or invented.
        parents: object id -> places it is attached to; only objects that have any.
        children: place id -> objects attached to it, sorted; only places that have any.

    """

    places: dict[str, Position]
    objects: dict[str, Object]
    parents: dict[str, frozenset[str]]
    children: dict[str, tuple[str, ...]]


def perceive(graph: SceneGraph, errors: DetectorErrors, rng: np.random.Generator) -> Perceived:
    """Draw the detector's errors for a whole building at once, so that they don't depend on the walk.

    An object is missed for good with ``miss_rate``; one that is not gets another class with ``mislabel_rate``,
    drawn by the frequency of the other classes, and a constant offset of normal noise. For each true object
    ``false_rate`` objects are invented: their class drawn by frequency, near a random place. Objects without
    an edge to a place can't be perceived.
    """
    noise = rng.normal(0.0, 1.0, (len(graph.places), 3)) * errors.place_noise_m
    places = {place: _shifted(graph.places[place], n) for place, n in zip(sorted(graph.places), noise, strict=True)}
    true = [graph.objects[key] for key in sorted(graph.objects) if graph.parents.get(key)]
    frequency = Counter(thing.class_ for thing in true)
    missed, mislabelled = rng.random((2, len(true)))
    noise = rng.normal(0.0, 1.0, (len(true), 3)) * errors.position_noise_m
    objects: dict[str, Object] = {}
    parents: dict[str, frozenset[str]] = {}
    for i, thing in enumerate(true):
        class_ = thing.class_
        if mislabelled[i] < errors.mislabel_rate:
            class_ = _draw({name: n for name, n in frequency.items() if name != class_}, rng) or class_
        if missed[i] >= errors.miss_rate:
            objects[thing.id] = Object(thing.id, class_, _shifted(thing.position, noise[i]), thing.size)
            parents[thing.id] = frozenset(graph.parents[thing.id])
    for key, thing, parent in _invented(graph, places, true, frequency, errors.false_rate, rng):
        objects[key], parents[key] = thing, frozenset({parent})
    children: dict[str, list[str]] = {}
    for key in sorted(parents):
        for parent in parents[key]:
            children.setdefault(parent, []).append(key)
    return Perceived(places, objects, parents, {place: tuple(keys) for place, keys in children.items()})


def _invented(
    graph: SceneGraph,
    places: dict[str, Position],
    true: list[Object],
    frequency: Counter[str],
    false_rate: float,
    rng: np.random.Generator,
) -> Iterable[tuple[str, Object, str]]:
    number = int(rng.binomial(len(true), false_rate % 1.0)) + len(true) * int(false_rate)
    ids = sorted(places)
    for i in range(number):
        key = f"invented-{i}"
        while key in graph.objects or key in graph.places:
            key += "-"
        class_ = _draw(frequency, rng)
        alike = [thing.size for thing in true if thing.class_ == class_]
        parent = ids[int(rng.integers(len(ids)))]
        position = _shifted(places[parent], rng.uniform(-INVENTED_WITHIN_M, INVENTED_WITHIN_M, 3))
        yield key, Object(key, class_, position, alike[int(rng.integers(len(alike)))]), parent


def _draw(frequency: dict[str, int], rng: np.random.Generator) -> str:
    """A class drawn by frequency; empty if there is none."""
    names = sorted(frequency)
    if not names:
        return ""
    counts = np.array([frequency[name] for name in names], dtype=np.float64)
    return names[int(rng.choice(len(names), p=counts / counts.sum()))]


def _shifted(position: Position, by: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Position:
    x, y, z = (float(p + d) for p, d in zip(position, by, strict=True))
    return x, y, z


@short_repr
@dataclass
class Delta:
    """What a step adds to and takes from the revealed graph; the building's ids, sorted."""

    places: list[str] = field(default_factory=list)
    objects: list[str] = field(default_factory=list)
    edges: list[tuple[str, str]] = field(default_factory=list)
    removed: list[str] = field(default_factory=list)


class Revealed:
    """The graph as far as the robot has seen it.

    Args:
        graph: the building, for its traversability.
        perceived: what the robot perceives of it.
        fresh_ids: give nodes names of the run's own (``p0``, ``o0`` …, in the order they are seen), so that no id
            says which place of a map is meant.

    """

    def __init__(self, graph: SceneGraph, perceived: Perceived, *, fresh_ids: bool) -> None:
        self._graph = graph
        self._perceived = perceived
        self._fresh = fresh_ids
        self._names: dict[str, str] = {}
        self._counts: Counter[str] = Counter()
        self._written: dict[str, Frame] = {}
        self.places: set[str] = set()
        self.objects: set[str] = set()

    def see(
        self, in_range: Iterable[str], flicker_rate: float, rng: np.random.Generator, frame: Frame | None = None
    ) -> Delta:
        """Reveal places, and the objects attached to them, each but for a chance of ``flicker_rate``.

        An object that is in range and not detected is taken out of the graph until it is detected again. In a frame
        that drifts all that is in range is written anew, where it then is.
        """
        now = sorted(in_range)
        delta = Delta(places=[place for place in now if place not in self.places])
        self.places.update(delta.places)
        neighbours, new = self._graph.neighbours, set(delta.places)
        if frame is not None:
            delta.places = now
            self._written.update(dict.fromkeys(now, frame))
        pairs = {(min(p, q), max(p, q)) for p in new for q in neighbours[p] if q in self.places}
        delta.edges = sorted(pairs)
        for key in sorted({key for place in now for key in self._perceived.children.get(place, ())}):
            seen = self._perceived.parents[key] & self.places
            if flicker_rate and rng.random() < flicker_rate:
                if key in self.objects:
                    self.objects.remove(key)
                    delta.removed.append(key)
            elif key not in self.objects:
                self.objects.add(key)
                delta.objects.append(key)
                delta.edges.extend((parent, key) for parent in sorted(seen))
            else:
                delta.edges.extend((parent, key) for parent in sorted(seen & new))
                if frame is not None:
                    delta.objects.append(key)
            if frame is not None:
                self._written[key] = frame
        return delta

    def everything(self) -> Delta:
        """The whole graph as revealed so far."""
        neighbours = self._graph.neighbours
        edges = sorted((p, q) for p in self.places for q in neighbours[p] if p < q and q in self.places)
        objects = sorted(self.objects)
        for key in objects:
            edges.extend((parent, key) for parent in sorted(self._perceived.parents[key] & self.places))
        return Delta(sorted(self.places), objects, edges)

    def place(self, key: str) -> Place:
        """A place as it is published."""
        return Place(self.name(key), self._placed(key, self._perceived.places[key]))

    def object(self, key: str) -> Object:
        """An object as it is published."""
        thing = self._perceived.objects[key]
        return msgspec.structs.replace(thing, id=self.name(key), position=self._placed(key, thing.position))

    def _placed(self, key: str, position: Position) -> Position:
        """Where a node was written, metres."""
        frame = self._written.get(key)
        if frame is None:
            return position
        x, y, z = frame.of(np.array(position)).tolist()
        return x, y, z

    def name(self, key: str) -> str:
        """The id under which the run knows a node of the building."""
        if not self._fresh:
            return key
        if key not in self._names:
            prefix = "p" if key in self._perceived.places else "o"
            self._names[key] = f"{prefix}{self._counts[prefix]}"
            self._counts[prefix] += 1
        return self._names[key]
