"""Bags, in and out: rosbag2's layout on mcap. One place to import from."""

from semloc_core.sources.bag.cdr import (
    POINT_STAMPED,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE,
    STRING,
    StampedPoint,
    StampedPose,
    Truth,
    decode_point,
    decode_pose,
    decode_string,
    encode_point,
    encode_pose,
    encode_pose_with_covariance,
    encode_string,
)
from semloc_core.sources.bag.reader import BagMessage, BagReader, read_messages
from semloc_core.sources.bag.writer import BagWriter, Compression

SCENE_GRAPH_TOPIC = "/scene_graph"
GROUND_TRUTH_TOPIC = "/ground_truth"
"""True poses of a run (geometry_msgs/PoseStamped, or positions: PointStamped), for evaluation only."""

__all__ = [
    "GROUND_TRUTH_TOPIC",
    "SCENE_GRAPH_TOPIC",
    "BagMessage",
    "BagReader",
    "BagWriter",
    "Compression",
    "POINT_STAMPED",
    "POSE_STAMPED",
    "POSE_WITH_COVARIANCE",
    "STRING",
    "StampedPoint",
    "StampedPose",
    "Truth",
    "decode_point",
    "decode_pose",
    "decode_string",
    "encode_point",
    "encode_pose",
    "encode_pose_with_covariance",
    "encode_string",
    "read_messages",
]
