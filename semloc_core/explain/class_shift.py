"""Lost or changed? How far the classes that a robot sees lately are from those of the map, and which are responsible.

Both sides are the same statistic: how often each class stands around a place, and how much of a match rests on it.
Live they are taken over the latest answers, of the map over a sample of its places, each explained against itself.
What is usual is measured on the map too: how far neighbouring places of the sample are from the whole of it; but
no less than what a detector makes of an unchanged building.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from semloc_core.encoding import extract
from semloc_core.explain.intrinsic import intrinsic_scores
from semloc_core.explain.scores import class_scores
from semloc_core.graph import Floats, Visibility
from semloc_core.map_database import LoadedMap
from semloc_core.text import percent, short_repr

Mix = Mapping[str, float]
SAMPLE = 80
"""Places of a building that are looked at; spread evenly over it."""
WINDOW = 60
"""Answers in the sliding window."""
FEWEST = 20
"""With fewer answers nothing is said."""
USUAL_PERCENTILE = 95.0
DETECTOR_DISTANCE = 0.4
"""Eighteen homes as a detector saw them are 0.22 to 0.48 away from the same homes as people labelled them (median
0.30, Stanford 3D Scene Graph), and 0.30 to 0.78 from each other (median 0.48): below this nothing can be said."""


def jensen_shannon(p: Floats, q: Floats) -> tuple[float, Floats]:
    """Jensen–Shannon distance (the square root of the divergence in bits) of two distributions.

    Lin, "Divergence Measures Based on the Shannon Entropy", 1991; Endres and Schindelin, 2003, for the root.

    Args:
        p: (C,) weights ≥ 0, with a positive sum.
        q: likewise.

    Returns:
        The distance, in [0, 1], and (C,) how much each entry adds to the divergence, each ≥ 0.

    """
    p, q = p / p.sum(), q / q.sum()
    mean = (p + q) / 2
    parts = np.zeros_like(mean)
    for side in (p, q):
        some = side > 0
        parts[some] += side[some] * np.log2(side[some] / mean[some]) / 2
    parts = np.maximum(parts, 0.0)
    return float(np.sqrt(min(1.0, parts.sum()))), parts


@short_repr
@dataclass(frozen=True)
class Shift:
    """How far a live mix is from the map's.

    Args:
        building: the building of the map.
        distance: Jensen–Shannon distance, in [0, 1].
        usual: up to where that says nothing.
        classes: class name -> live share minus the map's, those that add most to the distance first.

    """

    building: str
    distance: float
    usual: float
    classes: dict[str, float]

    def describe(self, most: int = 3) -> str:
        """The classes responsible, in words."""
        first = list(self.classes.items())[:most]
        named = [f"{'more' if d > 0 else 'less'} {name} ({percent(d, signed=True)})" for name, d in first]
        return ", ".join(named) or "none"


@dataclass(frozen=True, eq=False)
class _Reference:
    """One statistic of one building: class names, their mix over the sample, and up to which distance is usual."""

    names: tuple[str, ...]
    mix: Floats
    usual: float

    def shift(self, live: Mix, building: str) -> Shift | None:
        names = self.names + tuple(sorted(set(live) - set(self.names)))
        ours = np.array([live.get(name, 0.0) for name in names])
        theirs = np.concatenate([self.mix, np.zeros(len(names) - len(self.names))])
        if ours.sum() <= 0 or theirs.sum() <= 0:
            return None
        distance, parts = jensen_shannon(ours, theirs)
        difference = ours / ours.sum() - theirs / theirs.sum()
        order = [i for i in np.argsort(-parts, kind="stable").tolist() if parts[i] > 0]
        return Shift(building, distance, self.usual, {names[i]: float(difference[i]) for i in order})


class ClassShift:
    """Compares the latest answers with the map. Not thread-safe.

    Args:
        loaded: the map; a building's reference is made when it is first asked for (about half a second).

    """

    def __init__(self, loaded: LoadedMap) -> None:
        self._map = loaded
        self._references: dict[str, tuple[_Reference, _Reference]] = {}
        self._seen: deque[tuple[str, Mix]] = deque(maxlen=WINDOW)
        self._shares: deque[tuple[str, Mix]] = deque(maxlen=WINDOW)

    def follow(self, loaded: LoadedMap) -> None:
        """Compare with this map from now on: other buildings of the same one, or the same ones as they are by now."""
        if loaded is self._map:
            return
        before = dict(zip(self._map.buildings, self._map.stored, strict=False))
        now = dict(zip(loaded.buildings, loaded.stored, strict=False))
        self._references = {
            name: found for name, found in self._references.items() if now.get(name) == before.get(name, ())
        }
        self._map = loaded

    def see(self, building: str, classes: Iterable[str]) -> None:
        """Take in an answer.

        Args:
            building: of its best match.
            classes: those of the objects around the query place, one entry an object.

        """
        self._seen.append((building, Counter(self._named(name) for name in classes)))

    def explain(self, building: str, shares: Mix) -> None:
        """Take in attributions: class name -> share."""
        self._shares.append((building, _sum([{self._named(name): share} for name, share in shares.items()])))

    def objects(self) -> Shift | None:
        """How far the objects around the robot are from the map's; None with too few answers."""
        return self._compare(self._seen, 0)

    def attributions(self) -> Shift | None:
        """How far what matches rest on is from what they rest on within the map; None with too few answers."""
        return self._compare(self._shares, 1)

    def _named(self, name: str) -> str:
        """Synonyms are one class."""
        space = self._map.model.labelspace
        return space.classes[index] if (index := space.index(name)) >= 0 else name

    def _compare(self, window: deque[tuple[str, Mix]], which: int) -> Shift | None:
        entries = list(window)
        if len(entries) < FEWEST:
            return None
        building = Counter(name for name, _ in entries).most_common(1)[0][0]
        if building not in self._map.buildings:
            return None
        if building not in self._references:
            self._references[building] = _references(self._map, building)
        return self._references[building][which].shift(_sum(mix for _, mix in entries), building)


def _references(loaded: LoadedMap, building: str) -> tuple[_Reference, _Reference]:
    """What is usual around a building's places: of objects, and of attributions."""
    graph, model, space = loaded.graph(building), loaded.model, loaded.model.labelspace
    visibility = Visibility(graph, model.encoder.extraction.visibility_m)
    rows = loaded.rows_of(building)
    count = rows.stop - rows.start
    sample = rows.start + np.unique(np.linspace(0, count - 1, min(SAMPLE, count)).astype(np.int64))
    seen: list[Mix] = []
    shares: list[Mix] = []
    with torch.inference_mode():
        for row in sample.tolist():
            place = loaded.place_ids[row]
            batch = extract(graph, visibility, model.labelspace, [place], model.encoder.extraction)
            names = tuple(
                space.classes[space.index(graph.objects[node].class_)] if is_object else ""
                for node, is_object in zip(batch.node_ids, batch.is_object.tolist(), strict=True)
            )
            encoded = model.encoder.encode(batch)
            target = torch.from_numpy(loaded.embeddings[row])
            scores = intrinsic_scores(model.encoder, batch, encoded, names, target)
            seen.append(Counter(scores.classes))
            shares.append({part.class_: part.share for part in class_scores(scores)})
    positions = loaded.positions[sample]
    return _reference(seen, positions), _reference(shares, positions)


def _reference(mixes: list[Mix], positions: Floats) -> _Reference:
    names = tuple(sorted({name for mix in mixes for name in mix}))
    table = np.array([[mix.get(name, 0.0) for name in names] for mix in mixes]).reshape(len(mixes), len(names))
    whole = table.sum(0)
    near = max(1, len(mixes) // 10)
    distances = [0.0]
    for position in positions:
        nearest = np.argsort(((positions - position) ** 2).sum(1), kind="stable")[:near]
        part = table[nearest].sum(0)
        if part.sum() > 0:
            distances.append(jensen_shannon(part, whole)[0])
    return _Reference(names, whole, max(DETECTOR_DISTANCE, float(np.percentile(distances, USUAL_PERCENTILE))))


def _sum(mixes: Iterable[Mix]) -> dict[str, float]:
    total: dict[str, float] = {}
    for mix in mixes:
        for name, value in mix.items():
            total[name] = total.get(name, 0.0) + value
    return total
