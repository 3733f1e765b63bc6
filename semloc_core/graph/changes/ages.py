"""How far the robot has walked since what it knows of an object last changed."""

from __future__ import annotations

import math

from semloc_core.graph.changes.drift import DriftMeter
from semloc_core.graph.scene_graph import Change, SceneGraph
from semloc_core.wire import Object, Odometry, Position

STANDS_STILL_M = 0.3
"""The robot has not moved before it is so far from where it last had: odometry's jitter is no way walked."""


class Way:
    """Metres walked, from odometry's displacements, or without odometry from those of the query place."""

    def __init__(self) -> None:
        self._stood: tuple[Position, bool] | None = None

    def step(self, place: Position | None, odometry: Odometry | None) -> float:
        """Metres since the last step that counted.

        Args:
            place: where the query place is; None where there is none.
            odometry: of the update, or None.

        """
        position = place if odometry is None else odometry.position
        if position is None:
            return 0.0
        by_odometry = odometry is not None
        if self._stood is None or self._stood[1] != by_odometry:  # positions of two kinds can't be compared
            self._stood = (position, by_odometry)
            return 0.0
        metres = math.dist(self._stood[0], position)
        if metres < STANDS_STILL_M:
            return 0.0
        self._stood = (position, by_odometry)
        return metres


class Ages:
    """The age of each object of a graph that changes, in metres walked.

    An object that is sent again as it was keeps its age, in a full update too, and after a gap in the stream.
    """

    def __init__(self) -> None:
        self._way = Way()
        self.walked = 0.0
        """Metres walked so far."""
        self._known: dict[str, tuple[Object, float]] = {}
        self._meter = DriftMeter()
        self._written: dict[str, tuple[Position, float]] = {}

    def update(self, graph: SceneGraph, change: Change, odometry: Odometry | None) -> None:
        """Take in what an update of the graph changed.

        Args:
            graph: as it is now.
            change: what differs from before; all objects of a graph that is new.
            odometry: of the update.

        """
        here = graph.places.get(graph.query_place) if graph.query_place is not None else None
        self.walked += self._way.step(here, odometry)
        known = self._known
        for key in change.objects:
            item = graph.objects.get(key)
            if item is None:
                known.pop(key, None)
                self._written.pop(key, None)
            elif key not in known or known[key][0] != item:
                known[key] = (item, self.walked)
                self._measure(key, item, here)
        if len(known) > len(graph.objects):  # of a graph that was lost
            self._known = {key: value for key, value in known.items() if key in graph.objects}
            self._written = {key: value for key, value in self._written.items() if key in graph.objects}

    @property
    def drift(self) -> float | None:
        """How much the frame drifts, by what was written anew; None where that was too little."""
        return self._meter.drift

    def _measure(self, key: str, item: Object, here: Position | None) -> None:
        """Take in that an object was written anew; what is written while the robot stands says nothing of drift."""
        before = self._written.get(key)
        metres = 0.0 if before is None else self.walked - before[1]
        if before is not None and metres > 0 and here is not None:
            self._meter.add(math.dist(before[0][:2], item.position[:2]), metres, math.dist(here[:2], item.position[:2]))
        if before is None or metres > 0:
            self._written[key] = (item.position, self.walked)

    def __call__(self, key: str) -> float:
        """Metres walked since an object of the graph changed; 0 for one that is not known."""
        found = self._known.get(key)
        # Rounded: objects that were seen at one place are of one age, whatever the last bit of the way there.
        return 0.0 if found is None else round(self.walked - found[1], 6)
