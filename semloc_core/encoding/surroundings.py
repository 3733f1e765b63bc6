"""What an encoder reads around places of a graph that changes: kept between updates, so that one costs what changed."""

from __future__ import annotations

from semloc_core.encoding.place_graph import Batch, EgoRows, reach_batch
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.graph import Change, Labelspace, SceneGraph, Visibility


class Surroundings:
    """The batches that `semloc_core.encoding.place_graph.extract` makes of one place, of a graph that changes.

    Args:
        graph: the graph, as it is now.
        labelspace: gives objects their class index.
        extraction: what the encoder asks for.
        visibility: of that graph and ``extraction.visibility_m``, where there is one already.

    """

    def __init__(
        self, graph: SceneGraph, labelspace: Labelspace, extraction: Extraction, visibility: Visibility | None = None
    ) -> None:
        if visibility is None:
            visibility = Visibility(graph, extraction.visibility_m)
        assert visibility.graph is graph, "expected visibility of this graph"
        assert visibility.radius_m == extraction.visibility_m, (visibility.radius_m, extraction.visibility_m)
        self.graph, self.visibility = graph, visibility
        self._labelspace, self._extraction = labelspace, extraction
        self._ego = EgoRows(graph, visibility, labelspace) if extraction.kind == "ego" else None

    def update(self, change: Change) -> None:
        """Take in what an update of the graph changed. Every change must be given, in order."""
        views = self.visibility.update(change)
        if self._ego is not None:
            self._ego.forget(change.places.union(change.objects, views.places, views.objects, *change.edges))

    def batch(self, place: str) -> Batch:
        """What the encoder reads of one place.

        Raises:
            GraphError: not a place of the graph.

        """
        if self._ego is not None:
            return self._ego.batch(place, self._extraction.hops)
        e = self._extraction
        return reach_batch(self.graph, self._labelspace, [place], e.radius_m, e.bands)
