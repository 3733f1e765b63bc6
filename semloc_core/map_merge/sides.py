"""What is merged and what comes of it: a building and a traversal as alignment reads them, and the building then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import place_cells
from semloc_core.graph import GraphArrays, Labelspace, SceneGraph
from semloc_core.map_database import ObjectBelief
from semloc_core.map_merge.align import Scene
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True, eq=False)
class Side:
    """A scene graph as alignment and comparison read it.

    Args:
        graph: the graph.
        arrays: the same as arrays, ids sorted.
        names: class name of each object, another detector's joined to the labelspace's.
        embeddings: (P, D) of its places.

    """

    graph: SceneGraph
    arrays: GraphArrays
    names: tuple[str, ...]
    embeddings: NDArray[np.float32]

    @classmethod
    def of(cls, graph: SceneGraph, labelspace: Labelspace, embeddings: NDArray[np.float32]) -> Side:
        """Freeze a graph; ``embeddings`` are of its places by rising id."""
        arrays = GraphArrays.from_scene_graph(graph, labelspace)
        names = tuple(labelspace.canonical(graph.objects[key].class_) for key in arrays.object_ids)
        return cls(graph, arrays, names, embeddings)

    def scene(self, number: Mapping[str, int]) -> Scene:
        """For alignment, with classes numbered alike on both sides."""
        arrays = self.arrays
        parents = np.full(arrays.n_objects, -1, dtype=np.int64)
        parents[arrays.object_parents[0][::-1]] = arrays.object_parents[1][::-1]
        classes = np.array([number[name] for name in self.names], dtype=np.int64)
        return Scene(arrays.object_positions, classes, parents, arrays.place_positions, self.area())

    def area(self, of: NDArray[np.bool_] | None = None) -> float:
        """Free space, m², of all places or of some."""
        arrays = self.arrays
        cells = place_cells(arrays.n_places, arrays.place_edges, arrays.edge_lengths())
        return float(cells.sum() if of is None else cells[of].sum())


@short_repr
@dataclass(frozen=True, eq=False)
class Revision:
    """The building as it is now.

    Args:
        graph: its scene graph.
        beliefs: what is believed of each of its objects.
        counts: how many objects were ``confirmed``, ``moved``, ``missing``, ``added`` and ``forgotten``; ``places``
            added.

    """

    graph: SceneGraph
    beliefs: dict[str, ObjectBelief]
    counts: dict[str, int]
