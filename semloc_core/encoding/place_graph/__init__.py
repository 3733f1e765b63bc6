"""Places and what is around them, as tensors: the input of every encoder.

A `Batch` holds query places with their surroundings. `extract` makes one of a few places of the online graph,
`extract_all` one of all places of a building; `repeat` and `union` put batches together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding.place_graph.batch import Batch
from semloc_core.encoding.place_graph.combine import repeat, union
from semloc_core.encoding.place_graph.ego import EgoRows, ego_batch
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.encoding.place_graph.reach import reach_all_batch, reach_batch, take_stars
from semloc_core.encoding.place_graph.whole import whole_graph_batch
from semloc_core.graph import GraphArrays, Labelspace, SceneGraph, Visibility

__all__ = [
    "Batch", "EgoRows", "Extraction", "ego_batch", "extract", "extract_all", "reach_all_batch", "reach_batch", "repeat",
    "take_stars", "union", "whole_graph_batch",
]  # fmt: skip


def extract(
    graph: SceneGraph,
    visibility: Visibility,
    labelspace: Labelspace,
    places: Sequence[str],
    extraction: Extraction,
) -> Batch:
    """What an encoder reads of some places of the online graph.

    Args:
        graph: the scene graph.
        visibility: up to date with the graph; for ``ego`` its radius must be the extraction's.
        labelspace: gives objects their class index.
        places: B root places.
        extraction: what the encoder asks for.

    Raises:
        GraphError: a root is not a place of the graph.

    """
    if extraction.kind == "reach":
        return reach_batch(graph, labelspace, places, extraction.radius_m, extraction.bands)
    return ego_batch(graph, visibility, labelspace, places, extraction.hops)


def extract_all(
    arrays: GraphArrays, n_classes: int, extraction: Extraction, roots: NDArray[np.int64] | None = None
) -> Batch:
    """What an encoder reads of all P places of a building: roots 0 … P-1 in the order of ``arrays``.

    Args:
        arrays: the building.
        n_classes: C of the labelspace that ``arrays`` was made with.
        extraction: what the encoder asks for.
        roots: (B,) only these places, by index; ``ego`` has all of them in one graph whatever is asked for.

    """
    if extraction.kind == "reach":
        return reach_all_batch(arrays, n_classes, extraction.radius_m, roots, extraction.bands)
    return whole_graph_batch(arrays, n_classes, extraction.hops, extraction.radius_m)
