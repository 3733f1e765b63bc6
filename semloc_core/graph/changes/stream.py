"""The rules of the update stream: what a sequence number lets in (contract: ``scene_graph_update``).

A full update is always accepted and restarts the count. A delta must have the next number: after a gap nothing is
known until the next full update; a repeated or older one is dropped. Every outcome is counted.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum

from semloc_core.errors import GraphError
from semloc_core.graph.scene_graph import Change, SceneGraph
from semloc_core.wire import SceneGraphUpdate


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

    """

    def __init__(self) -> None:
        self.graph: SceneGraph | None = None
        self.counts: Counter[str] = Counter()
        self._seq = -1

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
                self.graph = None
                return Outcome.GAP, None
        graph = self.graph if self.graph is not None else SceneGraph()
        try:
            change = graph.apply(update)
        except GraphError:
            self.counts["rejected"] += 1
            raise
        self.graph, self._seq = graph, update.seq
        return Outcome.APPLIED, change
