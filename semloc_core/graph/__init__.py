"""The scene graph: as the robot knows it, as a stream of updates, and frozen into arrays. No torch here."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.graph.arrays import Floats, GraphArrays, Ints
    from semloc_core.graph.delta import GraphDeltas
    from semloc_core.graph.geodesic import ball, many_balls, ranges
    from semloc_core.graph.labelspace import (
        Labelspace,
        all_numbers,
        count_unknown,
        labelspace_from_hydra,
        listed,
        load_labelspace,
        load_synonyms,
        union,
    )
    from semloc_core.graph.resample import carried_sightings, nearest_parents, place_spacing, resample_places
    from semloc_core.graph.scene_graph import Change, SceneGraph
    from semloc_core.graph.stream import Outcome, UpdateStream
    from semloc_core.graph.visibility import Visibility, object_distances, visible_pairs
else:
    __getattr__ = exports(__name__)

__all__ = [
    "Change", "Floats", "GraphArrays", "GraphDeltas", "Ints", "Labelspace", "Outcome", "SceneGraph", "UpdateStream",
    "Visibility", "all_numbers", "ball", "carried_sightings", "count_unknown", "labelspace_from_hydra", "listed",
    "load_labelspace", "load_synonyms", "many_balls", "nearest_parents", "object_distances", "place_spacing", "ranges",
    "resample_places", "union", "visible_pairs",
]  # fmt: skip
