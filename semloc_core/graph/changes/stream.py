"""The rules of the update stream: what a sequence number lets in (contract: ``scene_graph_update``).

A full update is always accepted and restarts the count. A delta must have the next number: after a gap nothing is
known until the next full update; a repeated or older one is dropped. Every outcome is counted.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from enum import Enum

from semloc_core.errors import GraphError
from semloc_core.graph.scene_graph import Change, SceneGraph
from semloc_core.wire import Position, SceneGraphUpdate

STAYED_M, STAYED = 1.0, 0.5
"""A full update in which less than this share of the places known before is within so many metres of where it was is
another graph: of a mapper that began anew, or whose frame jumped."""


class Outcome(Enum):
    """What became of an update."""

    APPLIED = "applied"
    REPEATED = "repeated"
    """Its number is the last one's or older; nothing changed."""
    GAP = "gap"
    """Updates before it are missing: the graph is gone until the next full update."""
    WAITING = "waiting"
    """A delta while there is no graph."""


class UpdateStream:
    """A scene graph that is fed by a stream of updates.

    Attributes:
        graph: the graph, or None while there is none.
        counts: how many updates had which outcome; ``rejected`` are those that did not fit the graph.
        anew: whether the last update that was applied began another graph than the one that was known before it, also
            before a gap.

    """

    def __init__(self) -> None:
        self.graph: SceneGraph | None = None
        self.counts: Counter[str] = Counter()
        self.anew = False
        self._seq = -1
        self._lost: Mapping[str, Position] = {}

    def apply(self, update: SceneGraphUpdate) -> tuple[Outcome, Change | None]:
        """Take one update.

        Returns:
            The outcome and, where it is ``APPLIED``, what changed.

        Raises:
            GraphError: the update does not fit the graph; nothing changed, and its number counts as not seen.

        """
        outcome, change = self._apply(update)
        self.counts[outcome.value] += 1
        return outcome, change

    def _apply(self, update: SceneGraphUpdate) -> tuple[Outcome, Change | None]:
        if not update.full:
            if self.graph is None:
                return Outcome.WAITING, None
            if update.seq <= self._seq:
                return Outcome.REPEATED, None
            if update.seq > self._seq + 1:
                self._lost, self.graph = self.graph.places, None
                return Outcome.GAP, None
        graph = self.graph if self.graph is not None else SceneGraph()
        before = self._lost if self.graph is None else graph.places if update.full else {}
        try:
            change = graph.apply(update)
        except GraphError:
            self.counts["rejected"] += 1
            raise
        self.graph, self._seq, self._lost = graph, update.seq, {}
        self.anew = _stayed(before, graph.places) < STAYED * len(before)
        return Outcome.APPLIED, change


def _stayed(before: Mapping[str, Position], now: Mapping[str, Position]) -> int:
    """How many places are about where they were."""
    return sum(id_ in now and math.dist(at, now[id_]) <= STAYED_M for id_, at in before.items())
