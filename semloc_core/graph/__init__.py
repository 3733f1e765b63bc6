"""The scene graph: as the robot knows it, as a stream of updates, and frozen into arrays. No torch here."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.graph.arrays import Floats, GraphArrays, Ints, label_table
    from semloc_core.graph.changes.ages import Ages, Way
    from semloc_core.graph.changes.delta import GraphDeltas
    from semloc_core.graph.changes.drift import SHIFT_M, TURN_RAD, DriftMeter
    from semloc_core.graph.changes.stream import Outcome, UpdateStream
    from semloc_core.graph.geodesic import ball, connected, many_balls, ranges
    from semloc_core.graph.labels.classes import Labels, advice, all_unknown
    from semloc_core.graph.labels.files import load_labelspace, load_synonyms
    from semloc_core.graph.labels.labelspace import Labelspace, count_unknown, lacks, listed
    from semloc_core.graph.labels.names import LARGEST_ID, all_numbers, is_nameless, number_of
    from semloc_core.graph.labels.reading import Reading, read_graph
    from semloc_core.graph.labels.union import labelspace_from_hydra, union
    from semloc_core.graph.node_ids import INDEX_BITS, full_id, node_number, short_id
    from semloc_core.graph.repair import mend
    from semloc_core.graph.resample import carried_sightings, nearest_parents, place_spacing, resample_places
    from semloc_core.graph.scene_graph import Change, SceneGraph
    from semloc_core.graph.storeys import STOREYS_NEAR, separate, storey_at, storeys_at, storeys_of
    from semloc_core.graph.visibility import Visibility, object_distances, visible_pairs
else:
    __getattr__ = exports(__name__)

__all__ = [
    "Ages", "Change", "DriftMeter", "Floats", "GraphArrays", "GraphDeltas", "INDEX_BITS", "Ints", "LARGEST_ID",
    "Labels", "Labelspace", "Outcome", "Reading", "SHIFT_M", "STOREYS_NEAR", "SceneGraph", "TURN_RAD",
    "UpdateStream", "Visibility", "Way", "advice", "all_numbers", "all_unknown", "ball", "carried_sightings",
    "connected", "count_unknown", "full_id", "is_nameless", "label_table", "labelspace_from_hydra", "lacks", "listed",
    "load_labelspace", "load_synonyms", "many_balls", "mend", "nearest_parents", "node_number", "number_of",
    "object_distances", "place_spacing", "ranges", "read_graph", "resample_places", "separate", "short_id", "storey_at",
    "storeys_at", "storeys_of", "union", "visible_pairs",
]  # fmt: skip
