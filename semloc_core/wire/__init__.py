"""The wire: the messages' types, JSON text to typed messages and back, what may be wrong with them, their schemas."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.wire.checks import DECIMALS, check_links, check_nodes
    from semloc_core.wire.codec import MAX_BYTES, decode, decode_update, encode, one_line, schema_of
    from semloc_core.wire.messages import (
        NAMELESS,
        ClassAttribution,
        ClassAttributions,
        ClassContrast,
        Count,
        Counterfactual,
        ExplainRequest,
        Explanation,
        Fidelity,
        Fraction,
        Int64,
        MapInfo,
        Match,
        MethodAttributions,
        ModelInfo,
        Name,
        Object,
        ObjectAttribution,
        ObjectName,
        Odometry,
        Place,
        PlaceEvidence,
        PlaceMatches,
        Pose,
        Position,
        SceneGraphUpdate,
        Status,
        Transform,
        WhyNot,
        WithoutClass,
    )
    from semloc_core.wire.name_counter import NameCounter
    from semloc_core.wire.poses import (
        TumWriter,
        matched_pose,
        moved,
        orientation_of,
        quaternion_of,
        ros_covariance,
        yaw_of,
    )
    from semloc_core.wire.ros_types import RosField, has_header, ros_fields
else:
    __getattr__ = exports(__name__)

__all__ = [
    "ClassAttribution", "ClassAttributions", "ClassContrast", "Count", "Counterfactual", "DECIMALS", "ExplainRequest",
    "Explanation", "Fidelity", "Fraction", "Int64", "MAX_BYTES", "MapInfo", "Match", "MethodAttributions",
    "ModelInfo", "NAMELESS", "Name", "NameCounter", "Object", "ObjectAttribution", "ObjectName", "Odometry", "Place",
    "PlaceEvidence", "PlaceMatches", "Pose", "Position", "RosField", "SceneGraphUpdate", "Status", "Transform",
    "TumWriter", "WhyNot", "WithoutClass", "check_links", "check_nodes", "decode", "decode_update", "encode",
    "has_header", "matched_pose", "moved", "one_line", "orientation_of", "quaternion_of", "ros_covariance",
    "ros_fields", "schema_of", "yaw_of",
]  # fmt: skip
