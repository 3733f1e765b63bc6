"""The wire: the messages' types, JSON text to typed messages and back, what may be wrong with them, their schemas."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.wire.codec import decode, decode_update, encode, one_line
    from semloc_core.wire.messages import (
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
        PlaceMatches,
        Position,
        SceneGraphUpdate,
        Status,
        WhyNot,
        WithoutClass,
    )
    from semloc_core.wire.name_counter import NameCounter
else:
    __getattr__ = exports(__name__)

__all__ = [
    "ClassAttribution", "ClassAttributions", "ClassContrast", "Count", "Counterfactual", "ExplainRequest",
    "Explanation", "Fidelity", "Fraction", "Int64", "MapInfo", "Match", "MethodAttributions", "ModelInfo", "Name",
    "NameCounter", "Object", "ObjectAttribution", "ObjectName", "Odometry", "Place", "PlaceMatches", "Position",
    "SceneGraphUpdate", "Status", "WhyNot", "WithoutClass", "decode", "decode_update", "encode", "one_line",
]  # fmt: skip
