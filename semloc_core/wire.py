"""The wire: JSON text to typed messages and back. The only file that knows what a message looks like.

Lengths are metres, angles radians, stamps signed 64-bit integer nanoseconds, node ids strings. JSON Schemas of
these types are in ``msgs_schema/`` (see `semloc_core.schemas`). Decoding is strict: unknown fields, wrong types,
non-finite numbers, duplicate ids and self-loops are refused with one line, and so is an edge of a full update
that names an unknown node (for a delta only the graph can tell: `semloc_core.scene_graph`).
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

Position = tuple[float, float, float]
Int64 = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]
Sequence64 = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Status = Literal["match", "ambiguous", "unknown", "no_graph"]


class Place(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A place node: a patch of free space. ``position`` in metres, in the message's frame."""

    id: str
    position: Position


class Object(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """An object node. ``class`` is a name of the labelspace, ``size`` the box's edge lengths in metres."""

    id: str
    class_: str
    position: Position
    size: Position | None = None


class Odometry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The robot's pose in the odometry frame (metres; unit quaternion x, y, z, w)."""

    position: Position
    orientation_xyzw: tuple[float, float, float, float]


class SceneGraphUpdate(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """In: a full scene graph, or a delta to the one before. Nodes are upserts."""

    schema: Literal["semloc/scene_graph_update/1"]
    stamp_ns: Int64
    frame_id: str
    seq: Sequence64
    full: bool
    places: list[Place]
    objects: list[Object]
    edges: list[tuple[str, str]]
    query_place: str | None
    sightings: list[tuple[str, str]] = []
    removed_nodes: list[str] = []
    removed_edges: list[tuple[str, str]] = []
    odometry: Odometry | None = None


class Match(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One place of the map. ``position`` (m) is in the frame of its building ``map``; ``rank`` counts from 1.

    ``probability`` is P(this place lies within 4 m of the truth); the list's need not sum to 1.
    """

    rank: int
    map: str
    place: str
    position: Position
    similarity: float
    probability: float


class MapInfo(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which map answered: file name, content hash (sha256, hex) and number of places."""

    name: str
    hash: str
    places: int


class ModelInfo(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which encoder answered: its name and content hash (sha256, hex)."""

    name: str
    hash: str


class PlaceMatches(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Out: the top-N places. ``latency_ms`` is null in replay; ``calibrated`` says if the probabilities are."""

    schema: Literal["semloc/place_matches/1"]
    stamp_ns: Int64
    frame_id: str
    seq: Sequence64
    query_place: str | None
    status: Status
    matches: list[Match]
    raw_matches: list[Match] | None
    rivals: list[Match]
    map: MapInfo | None
    model: ModelInfo | None
    calibrated: bool
    latency_ms: float | None


class ClassAttribution(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """A class's part in the match: signed ``score``, ``share`` ≥ 0 (shares sum to 1), objects counted."""

    class_: str
    score: float
    share: float
    instances: int


class ObjectAttribution(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """One object's signed ``score``."""

    id: str
    class_: str
    score: float


class Fidelity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Necessity Δ⁺, sufficiency Δ⁻ and the characterisation score at the fraction ``budget`` of objects kept."""

    necessity: float
    sufficiency: float
    characterisation: float
    budget: float


class ClassAttributions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Out: how much each semantic class contributed to the top match, by falling share."""

    schema: Literal["semloc/class_attributions/1"]
    stamp_ns: Int64
    frame_id: str
    seq: Sequence64
    query_place: str | None
    match_map: str | None
    match_place: str | None
    method: str
    classes: list[ClassAttribution]
    objects: list[ObjectAttribution]
    fidelity: Fidelity | None
    completeness_gap: float | None
