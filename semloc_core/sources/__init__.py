"""Where graphs and runs come from: Hydra's files, bags, simulated walks, generated buildings."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.sources.bag import GROUND_TRUTH_TOPIC, SCENE_GRAPH_TOPIC
    from semloc_core.sources.bag.cdr import (
        POSE_WITH_COVARIANCE,
        STRING,
        StampedPose,
        Truth,
        decode_string,
        encode_pose_with_covariance,
        encode_string,
    )
    from semloc_core.sources.bag.reader import BagMessage, BagReader, read_messages
    from semloc_core.sources.bag.writer import BagWriter
    from semloc_core.sources.graph import read_graph
    from semloc_core.sources.hydra.read import AgentPose, HydraFile, read_hydra
    from semloc_core.sources.hydra.stream import DsgStream, odometry, query_place
    from semloc_core.sources.hydra.write import node_id, write_hydra
    from semloc_core.sources.run import Run, decode_truth, graph_at_end, is_run, read_run, write_run
    from semloc_core.sources.simulate.drift import Frame
    from semloc_core.sources.simulate.traversal import SimulationConfig, Step, simulate_traversal
    from semloc_core.sources.simulate.walks import Bools, Walk, WalkConfig, walk
    from semloc_core.sources.truth import TOLERANCE_S, TruthMatcher
    from semloc_core.sources.world.furnishings import KINDS
    from semloc_core.sources.world.kinds import BuildingKind, draw_pair
    from semloc_core.sources.world.office import OfficeConfig, make_office, write_world
    from semloc_core.sources.world.stacked import draw_stacked
else:
    __getattr__ = exports(__name__)

__all__ = [
    "AgentPose", "BagMessage", "BagReader", "BagWriter", "Bools", "BuildingKind", "DsgStream", "Frame",
    "GROUND_TRUTH_TOPIC", "HydraFile", "KINDS", "OfficeConfig", "POSE_WITH_COVARIANCE", "Run", "SCENE_GRAPH_TOPIC",
    "STRING", "SimulationConfig", "StampedPose", "Step", "TOLERANCE_S", "Truth", "TruthMatcher", "Walk", "WalkConfig",
    "decode_string", "decode_truth", "draw_pair", "draw_stacked", "encode_pose_with_covariance", "encode_string",
    "graph_at_end", "is_run", "make_office", "node_id", "odometry", "query_place", "read_graph", "read_hydra",
    "read_messages", "read_run", "simulate_traversal", "walk", "write_hydra", "write_run", "write_world",
]  # fmt: skip
