"""The robot's own graph, update by update, and the questions about it that an encoder is asked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding.encoder.base import Encoded
from semloc_core.encoding.encoder.query import QueryEncoder
from semloc_core.encoding.model import Model
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.surroundings import Surroundings
from semloc_core.graph import Ages, Labels, Outcome, SceneGraph, UpdateStream, Visibility, all_unknown, lacks
from semloc_core.text import short_repr
from semloc_core.wire import NameCounter, Object, Odometry, SceneGraphUpdate, yaw_of


@short_repr
@dataclass(frozen=True, eq=False)
class Query:
    """One question: where is ``place``, in the graph as it was after update ``seq``? Nothing in it changes later.

    ``batch`` and ``encoded`` are None where there was nothing to embed; ``reason`` then says why.
    """

    stamp_ns: int
    seq: int
    place: str | None
    batch: Batch | None = None
    encoded: Encoded | None = None
    class_names: tuple[str, ...] = ()
    reason: str = ""


class Reader(Protocol):
    """What a map does with a question: weighs a batch's objects, and encodes it."""

    def weigh(self, batch: Batch) -> Batch:
        """The batch with its objects weighed as the map's are."""

    @property
    def queries(self) -> QueryEncoder:
        """The map's encoder."""


class LiveGraph:
    """What the robot knows, as a model reads it.

    Args:
        model: reads the graph.

    Attributes:
        stream: the graph, and what became of its updates.
        labels: reads the updates' labels, see `read_by`.
        unknown_classes: names of object classes that the model's labelspace lacks -> different objects seen of them.
        ages: how far the robot has walked since it saw what.
        odometry: of the latest update.

    """

    def __init__(self, model: Model) -> None:
        self.stream, self.ages, self.unknown_classes = UpdateStream(), Ages(), NameCounter()
        self.labels: Labels | None = None
        self._said: dict[str, Object] = {}
        self.odometry: Odometry | None = None
        self.surroundings: Surroundings | None = None
        self._seq, self._stamp_ns, self._frame_id, self._model = 0, 0, "", model

    @property
    def graph(self) -> SceneGraph | None:
        """As it is now; None while there is none."""
        return self.stream.graph

    @property
    def visibility(self) -> Visibility | None:
        """Of the graph as it is now."""
        return None if self.surroundings is None else self.surroundings.visibility

    def apply(self, update: SceneGraphUpdate) -> Outcome:
        """Take an update into the graph, all or nothing.

        Raises:
            GraphError: it does not fit the graph; nothing changed.

        """
        said = update
        if self.labels is not None:
            update = self.labels.update(update)
        outcome, change = self.stream.apply(update)
        if outcome is Outcome.REPEATED:
            return outcome
        if outcome is Outcome.APPLIED:
            self._keep(said, update)
        self._seq, self._stamp_ns = update.seq, update.stamp_ns
        self.odometry, self._frame_id = update.odometry, update.frame_id
        graph = self.graph
        if graph is not None and change is not None:
            self.ages.update(graph, change, update.odometry)
        if graph is None:
            self.surroundings = None
        elif self.surroundings is None or self.surroundings.graph is not graph:
            self.surroundings = Surroundings(graph, self._model.labelspace, self._model.encoder.extraction)
        elif change is not None:
            self.surroundings.update(change)
        if outcome is Outcome.APPLIED:
            self._count_unknown(update.objects)
        return outcome

    def _keep(self, said: SceneGraphUpdate, read: SceneGraphUpdate) -> None:
        """Keep what was said of objects whose labels are read otherwise: other labels may read them anew."""
        if said.full:
            self._said.clear()
        for key in said.removed_nodes:
            self._said.pop(key, None)
        for own, other in zip(said.objects, read.objects, strict=True) if self._said or read is not said else ():
            if own != other:
                self._said[own.id] = own
            else:
                self._said.pop(own.id, None)

    def read_by(self, model: Model, labels: Labels | None = None) -> None:
        """Go on with another model; what was seen from where is kept if both look as far.

        Args:
            model: reads the graph from now on.
            labels: read the labels of updates, and those of the graph anew; None leaves them to the model.

        """
        graph, seen, self._model, self.labels = self.graph, self.visibility, model, labels
        self.surroundings = None
        self.unknown_classes.clear()
        if graph is None:
            return
        said = [self._said.get(key, thing) for key, thing in graph.objects.items()]
        read = said if labels is None else labels.objects(said)
        self._said = {own.id: own for own, other in zip(said, read, strict=True) if own != other}
        graph.objects.update({thing.id: thing for thing in read})
        extraction = model.encoder.extraction
        kept = seen if seen is not None and seen.radius_m == extraction.visibility_m else None
        self.surroundings = Surroundings(graph, model.labelspace, extraction, kept)
        self._count_unknown(graph.objects.values())

    def count_on(self, other: LiveGraph) -> None:
        """Go on with another one's counts, not with its graph."""
        self.stream.counts, self.unknown_classes = other.stream.counts, other.unknown_classes

    def stands(self, place: str) -> tuple[NDArray[np.float64], float | None]:
        """(3,) where the robot is at a place, in the updates' frame, metres, and its heading where that is known."""
        graph, odometry = self.graph, self.odometry
        assert graph is not None
        if odometry is None or odometry.frame_id != self._frame_id or place != graph.query_place:
            return np.array(graph.places[place]), None
        return np.array(odometry.position), yaw_of(odometry.orientation_xyzw)

    def unasked(self, place: str | None, reason: str = "") -> Query:
        """A question that nothing is embedded for."""
        return Query(self._stamp_ns, self._seq, place, reason=reason)

    def query(self, place: str | None, map_: Reader) -> Query:
        """Find the query place, extract its surroundings, encode them.

        Args:
            place: asked about instead of the query place.
            map_: weighs the batch and encodes it.

        """
        graph = self.graph
        if place is None and graph is not None:
            place = graph.query_place
        if graph is None or self.surroundings is None:
            return self.unasked(place)
        if place is None:
            return self.unasked(place, "no query place")
        if place not in graph.places:
            return self.unasked(place, "the place asked for is not in the graph")
        if not graph.neighbours[place]:
            return self.unasked(place, "the query place is isolated")
        batch, space = map_.weigh(self.surroundings.batch(place)), self._model.labelspace
        if not bool(batch.is_object.any()):
            why = all_unknown((item.class_ for item in graph.objects.values()), space)
            return self.unasked(place, why or "no object in reach of the query place")
        encoded = map_.queries.encode(batch)
        if not bool(encoded.embedding.any()):
            return self.unasked(place, "the encoder has nothing to say of this place")
        names = tuple(
            space.canonical(graph.objects[node].class_) if is_object else ""
            for node, is_object in zip(batch.node_ids, batch.is_object.tolist(), strict=True)
        )
        return Query(self._stamp_ns, self._seq, place, batch, encoded, names)

    def _count_unknown(self, objects: Iterable[Object]) -> None:
        for item in objects:
            if lacks(self._model.labelspace, item.class_):
                self.unknown_classes.see(item.class_, item.id)
