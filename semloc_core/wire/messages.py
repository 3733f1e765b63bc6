"""The messages' types: what the JSON Schemas in ``msgs_schema/`` are generated from.

Lengths are metres, angles radians, stamps signed 64-bit integer nanoseconds, node ids strings. A bound that JSON
Schema can express stands here, in the type; the rest is in `semloc_core.wire.checks`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from semloc_core.text import short_repr

NAMELESS = "unknown"
"""Reserved: an object whose position is known and whose class is not. No class of any file, and no class it lacks."""

# Lengths are bounded so that no distance overflows: nothing on Earth is 10⁹ m from anything else.
Metres = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
Length = Annotated[float, msgspec.Meta(ge=0, le=1e9)]
Position = tuple[Metres, Metres, Metres]
Size = tuple[Length, Length, Length]
Angle = Annotated[float, msgspec.Meta(ge=-3.1416, le=3.1416)]
Fraction = Annotated[float, msgspec.Meta(ge=0, le=1)]
Count = Annotated[int, msgspec.Meta(ge=0)]
Rank = Annotated[int, msgspec.Meta(ge=1)]
Name = Annotated[str, msgspec.Meta(min_length=1)]
Int64 = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]
Sequence64 = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Labels = Annotated[dict[Name, Annotated[float, msgspec.Meta(gt=0, le=1)]], msgspec.Meta(min_length=1)]
Status = Literal["match", "ambiguous", "unknown", "no_graph"]


class Place(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A place node: a patch of free space. ``position`` in metres, in the message's frame."""

    id: Name
    position: Position


class Object(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """An object node. ``class`` is a name of the labelspace, ``size`` the box's edge lengths in metres.

    ``class`` ``unknown`` is reserved: a position without a name. ``labels`` says what else the object may be: class ->
    probability, which sum to at most 1; ``class`` is the likeliest. Null: ``class`` is all that is known.
    """

    id: Name
    class_: Name
    position: Position
    size: Size | None = None
    labels: Labels | None = None


class Odometry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The robot's pose in the odometry frame (metres; unit quaternion x, y, z, w).

    Where ``frame_id`` is the update's, the pose is where the robot is among the places and objects; else it only says
    how far the robot went.
    """

    position: Position
    orientation_xyzw: tuple[float, float, float, float]
    frame_id: str | None = None


@short_repr
class SceneGraphUpdate(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """In: a full scene graph, or a delta to the one before. Nodes are upserts."""

    schema: Literal["semloc/scene_graph_update/1"]
    stamp_ns: Int64
    frame_id: str
    seq: Sequence64
    full: bool
    places: list[Place]
    objects: list[Object]
    edges: list[tuple[Name, Name]]
    query_place: Name | None
    sightings: list[tuple[Name, Name]] = []
    removed_nodes: list[Name] = []
    removed_edges: list[tuple[Name, Name]] = []
    odometry: Odometry | None = None


class Pose(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The robot's pose in the frame of the building of its match (m, rad).

    ``covariance`` is row-major over x, y, z and yaw (m², rad²). ``yaw`` is null where the robot's heading in the
    frame of its updates is not known: its variance is then π²/3, and 0 is between it and the rest.
    """

    position: Position
    yaw: Angle | None
    covariance: Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]


class Transform(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """From the frame of the updates into a building's: turned by ``yaw`` about gravity, then moved (rad, m)."""

    translation: Position
    yaw: Angle


class Match(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One place of the map. ``position`` (m) is in the frame of its building ``map``; ``rank`` counts from 1.

    ``probability`` is P(this place lies within 4 m of the truth); the list's need not sum to 1. ``pose`` is the robot's
    if this answer is right; null for a place that was not put to the test by layout.
    """

    rank: Rank
    map: str
    place: Name
    position: Position
    similarity: float
    probability: Fraction
    pose: Pose | None = None


class MapInfo(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which map answered: file name, content hash (sha256, hex) and number of places."""

    name: str
    hash: str
    places: Count


class ModelInfo(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which encoder answered: its name and content hash (sha256, hex)."""

    name: str
    hash: str


class PlaceMatches(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Out: the top-N places. ``latency_ms`` is null in replay; ``calibrated`` says if the probabilities are.

    ``status`` is ``unknown`` where there is nothing to go by (no ``matches``), and where the robot is probably in no
    building of the map (``matches`` are the best of it). ``raw_matches`` is the similarity search's list where another
    is published: verified by layout, or filtered. ``transform`` is the best match's, null where its ``pose`` is.
    """

    schema: Literal["semloc/place_matches/1"]
    stamp_ns: Int64
    frame_id: str
    seq: Sequence64
    query_place: Name | None
    status: Status
    matches: list[Match]
    raw_matches: list[Match] | None
    rivals: list[Match]
    map: MapInfo | None
    model: ModelInfo | None
    calibrated: bool
    latency_ms: Annotated[float, msgspec.Meta(ge=0)] | None
    transform: Transform | None = None


class ClassAttribution(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """A class's part in the match: signed ``score``, ``share`` ≥ 0 (shares sum to 1), objects counted."""

    class_: Name
    score: float
    share: Fraction
    instances: Count


class ObjectAttribution(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """One object's signed ``score``; of ``layout`` also the ``mapped`` object that explains it, null if none does."""

    id: Name
    class_: Name
    score: float
    mapped: Name | None = None


class Fidelity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Necessity Δ⁺, sufficiency Δ⁻ and the characterisation score at the fraction ``budget`` of objects kept."""

    necessity: float
    sufficiency: float
    characterisation: float
    budget: Fraction


class ClassAttributions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Out: how much each semantic class contributed to the top match, by falling share.

    ``attention`` and its like say what the encoder's similarity rests on; ``layout``, the evidence, what the decision
    does, in nats and exactly: there ``missed`` are mapped objects that should have been seen (``score`` < 0), and
    ``walls`` (≤ 0) is what known places cost where the map has no room; null of other methods. ``unattributed`` is what
    the method gave to no object (attention that places kept), null where it has no meaning.
    """

    schema: Literal["semloc/class_attributions/1"]
    stamp_ns: Int64
    frame_id: str
    seq: Sequence64
    query_place: Name | None
    match_map: str | None
    match_place: Name | None
    method: str
    classes: list[ClassAttribution]
    objects: list[ObjectAttribution]
    fidelity: Fidelity | None
    completeness_gap: float | None
    unattributed: float | None = None
    missed: list[ObjectAttribution] | None = None
    walls: float | None = None


class ExplainRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """In: explain a pair. Null ``query_place``: the last query; ``place``: its top match (of building ``map``).

    The top match is the one published, after verification by layout and a filter where these are on. ``methods`` names
    the explainers, null means all of them.
    """

    schema: Literal["semloc/explain_request/1"]
    stamp_ns: Int64
    frame_id: str
    seq: Sequence64
    query_place: Name | None = None
    map: str | None = None
    place: Name | None = None
    methods: Annotated[list[Name], msgspec.Meta(min_length=1)] | None = None


class MethodAttributions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What one explainer says of the pair; the fields mean what they mean in ``class_attributions``."""

    method: Name
    classes: list[ClassAttribution]
    objects: list[ObjectAttribution]
    fidelity: Fidelity | None
    completeness_gap: float | None
    missed: list[ObjectAttribution] | None = None
    walls: float | None = None


class ObjectName(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """An object of the query place's surroundings."""

    id: Name
    class_: Name


class Counterfactual(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Without the objects ``removed``, ``place`` of building ``map`` would be the most similar place.

    It is of the search by similarity alone: verification by layout and filters may make another place the top match.
    ``removed`` is empty, and the rest null, where no removal that was tried changes the top match.
    """

    removed: list[ObjectName]
    map: str | None
    place: Name | None
    similarity: float | None


class ClassContrast(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """A class's signed part in the difference: positive speaks for the place asked for, negative for the top."""

    class_: Name
    score: float


class PlaceEvidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the test by layout rests on at one place: ``score`` is the sum of the objects', the missed and the walls."""

    map: str
    place: Name
    score: float
    objects: list[ObjectAttribution]
    missed: list[ObjectAttribution]
    walls: float


class WhyNot(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Why the top match is (``map``, ``place``) and not the explained place, which is the ``rank``-th.

    ``evidence`` is the test that decides taken apart at both, the explained place first, then the top match; null
    where nothing was tested. ``classes`` compares the two by similarity, which only proposes. A place that the answer
    does not list ranks behind those listed and those more similar.
    """

    map: str
    place: Name
    similarity: float
    rank: Rank
    classes: list[ClassContrast]
    evidence: list[PlaceEvidence] | None = None


class WithoutClass(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"class_": "class"}):
    """The answer if the robot had seen no object of a class: the best place then, and how sure it would be.

    ``same``: that place is the published one, or within 4 m of it; ``status`` is the answer's then. Where nothing would
    be left to go by, ``map`` and ``place`` are null and ``probability`` is 0.
    """

    class_: Name
    map: str | None
    place: Name | None
    probability: Fraction
    same: bool
    status: Status | None = None


class Explanation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Out: the answer to an ``explain_request``, with its ``seq``: every method on one query–place pair.

    ``similarity`` is the pair's, ``position`` the explained place's in its building's frame, and ``probability`` the
    answer's of it: of a place that it does not list, what the test by layout makes of it, null where there was none.
    ``counterfactual`` is null where it was not computed, ``why_not`` also where the explained place is the top match.
    ``without`` asks the whole question again, similarity and test by layout, without one class after another, those
    that count most in the test first; null where the explained place was not put to that test. ``error`` is one line
    where the request can't be answered, else null.
    """

    schema: Literal["semloc/explanation/1"]
    stamp_ns: Int64
    frame_id: str
    seq: Sequence64
    query_place: Name | None
    match_map: str | None
    match_place: Name | None
    similarity: float | None
    methods: list[MethodAttributions]
    counterfactual: Counterfactual | None = None
    why_not: WhyNot | None = None
    without: list[WithoutClass] | None = None
    error: str | None = None
    position: Position | None = None
    probability: Fraction | None = None


MESSAGES: dict[str, type[msgspec.Struct]] = {
    "scene_graph_update": SceneGraphUpdate,
    "place_matches": PlaceMatches,
    "class_attributions": ClassAttributions,
    "explain_request": ExplainRequest,
    "explanation": Explanation,
}
