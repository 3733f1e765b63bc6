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
    from semloc_core.sources.bag.typed import DETECTIONS
    from semloc_core.sources.bag.writer import BagWriter
    from semloc_core.sources.detections.frames import LateError, NoPathError, Rigid
    from semloc_core.sources.detections.grid import Grid
    from semloc_core.sources.detections.growth.builder import GraphBuilder
    from semloc_core.sources.detections.growth.config import BuilderConfig
    from semloc_core.sources.detections.growth.things import Detection, View
    from semloc_core.sources.detections.nav2 import graph_of as graph_of_grid
    from semloc_core.sources.detections.nav2 import read_nav2, read_objects
    from semloc_core.sources.detections.recording import write_detections
    from semloc_core.sources.detections.simulate import DetectorConfig, Glance, simulate_detections
    from semloc_core.sources.detections.stream import DetectionStream, StreamConfig, transform_of
    from semloc_core.sources.graph import read_building, read_graph
    from semloc_core.sources.hydra.file import AgentPose, HydraFile
    from semloc_core.sources.hydra.read import read_hydra
    from semloc_core.sources.hydra.stream import DsgStream, odometry, query_place
    from semloc_core.sources.hydra.write import node_id, write_hydra
    from semloc_core.sources.runs.kind import is_run
    from semloc_core.sources.runs.read import graph_at_end, read_run
    from semloc_core.sources.runs.run import Run, decode_truth
    from semloc_core.sources.runs.write import write_run, write_updates
    from semloc_core.sources.simulate.drift import Frame
    from semloc_core.sources.simulate.traversal import SimulationConfig, Step, simulate_traversal
    from semloc_core.sources.simulate.walks import Bools, Walk, WalkConfig, walk, walks_through
    from semloc_core.sources.truth import TOLERANCE_S, TruthMatcher
    from semloc_core.sources.world.furnishings import KINDS
    from semloc_core.sources.world.kinds import BuildingKind, draw_pair
    from semloc_core.sources.world.office import OfficeConfig, make_office, write_world
    from semloc_core.sources.world.second_run import SecondRun
    from semloc_core.sources.world.stacked import draw_flat, draw_stacked
else:
    __getattr__ = exports(__name__)

__all__ = [
    "AgentPose", "BagMessage", "BagReader", "BagWriter", "Bools", "BuilderConfig", "BuildingKind", "DETECTIONS",
    "Detection", "DetectionStream", "DetectorConfig", "DsgStream", "Frame", "GROUND_TRUTH_TOPIC", "Glance",
    "GraphBuilder", "Grid", "HydraFile", "KINDS", "LateError", "NoPathError", "OfficeConfig", "POSE_WITH_COVARIANCE",
    "Rigid", "Run", "SCENE_GRAPH_TOPIC", "STRING", "SecondRun", "SimulationConfig", "StampedPose", "Step",
    "StreamConfig", "TOLERANCE_S", "Truth", "TruthMatcher", "View", "Walk", "WalkConfig", "decode_string",
    "decode_truth", "draw_flat", "draw_pair", "draw_stacked", "encode_pose_with_covariance", "encode_string",
    "graph_at_end", "graph_of_grid", "is_run", "make_office", "node_id", "odometry", "query_place", "read_building",
    "read_graph", "read_hydra", "read_messages", "read_nav2", "read_objects", "read_run", "simulate_detections",
    "simulate_traversal", "transform_of", "walk", "walks_through", "write_detections", "write_hydra", "write_run",
    "write_updates", "write_world",
]  # fmt: skip
