"""What can be wrong with a message that its JSON Schema can't say: duplicates, self-loops, unknown nodes, order."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from semloc_core.errors import MessageError
from semloc_core.wire.messages import (
    NAMELESS,
    ClassAttribution,
    ClassAttributions,
    ExplainRequest,
    Explanation,
    Match,
    Object,
    ObjectAttribution,
    PlaceMatches,
    SceneGraphUpdate,
)

QUATERNION_TOLERANCE = 1e-2  # publishers round; farther off than this it is not a rotation
COVARIANCE_TOLERANCE = 1e-5  # numbers are rounded on output
DECIMALS = 6  # of every float on output: micrometres, and far below what a similarity means
SHARE_TOLERANCE = 1e-3  # shares are rounded on output


def check_update(update: SceneGraphUpdate) -> None:
    """Refuse what can be told from the update alone; the rest is `SceneGraph.apply`'s.

    Raises:
        MessageError: a duplicate id, a self-loop, an edge between objects, a sighting that is not
            [place, object], a query place that is an object, labels that do not add up; in a full update also an
            unknown node.

    """
    places, objects = check_nodes(update)
    if update.full:
        check_links(update, places.__contains__, objects.__contains__)
    else:  # what is not in it may be any node that the graph has
        check_links(update, lambda node: node not in objects, lambda node: node not in places)
    for a, b in update.removed_edges:
        if a == b:
            raise MessageError(f"expected removed_edges between two nodes (got a self-loop of {a!r})")
    if update.odometry is not None:
        norm = math.sqrt(sum(x * x for x in update.odometry.orientation_xyzw))
        if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
            raise MessageError(f"expected orientation_xyzw to be a unit quaternion (got norm {norm:.6g})")


def check_nodes(update: SceneGraphUpdate) -> tuple[set[str], set[str]]:
    """The ids of an update's places and objects; MessageError where one is given twice, or labels can't be."""
    places = {place.id for place in update.places}
    objects = {thing.id for thing in update.objects}
    if len(places) + len(objects) < len(update.places) + len(update.objects) or not places.isdisjoint(objects):
        _check_unique("node id", [p.id for p in update.places] + [o.id for o in update.objects])
    for thing in update.objects:
        if thing.labels is not None:
            _check_labels(thing, thing.labels)
    return places, objects


def _check_labels(thing: Object, labels: Mapping[str, float]) -> None:
    for name, p in labels.items():
        if not 0.0 < p <= 1.0:  # false for NaN too
            raise MessageError(f"expected labels with probabilities in (0, 1] (got {name!r}: {p} for {thing.id!r})")
        if name.casefold() == NAMELESS:
            raise MessageError(f"expected labels without {NAMELESS!r}, which is what they lack of 1 (for {thing.id!r})")
    # As they are written: what is accepted once is accepted again.
    rounded = {name: round(p, DECIMALS) for name, p in labels.items()}
    total = math.fsum(rounded.values())
    if total > 1.0 + SHARE_TOLERANCE:
        raise MessageError(f"expected labels that sum to at most 1 (got {total:.6g} for {thing.id!r})")
    if thing.class_ not in rounded or rounded[thing.class_] < max(rounded.values()):
        raise MessageError(f"expected class to be the likeliest of labels (got {thing.class_!r} for {thing.id!r})")


def check_links(update: SceneGraphUpdate, is_place: Callable[[str], bool], is_object: Callable[[str], bool]) -> None:
    """Refuse edges, sightings and a query place that do not fit the nodes.

    Args:
        update: the message.
        is_place: whether a node may be a place, once the update is applied.
        is_object: whether it may be an object.

    Raises:
        MessageError: the first thing that is wrong.

    """
    for a, b in update.edges:
        if a == b:
            raise MessageError(f"expected edges between two nodes (got a self-loop of {a!r})")
        ends = is_place(a), is_place(b)
        if all(ends):
            continue
        if not any(ends) and is_object(a) and is_object(b):
            raise MessageError(f"expected a place at one end of an edge (got objects {a!r} and {b!r})")
        for node, joins in zip((a, b), ends, strict=True):
            if not (joins or is_object(node)):
                raise MessageError(f"expected edges between known nodes (got unknown {node!r})")
    for place, seen in update.sightings:
        if place == seen:
            raise MessageError(f"expected a sighting [place, object] (got a self-loop of {place!r})")
        if not (is_place(place) and is_object(seen)):
            raise MessageError(f"expected a sighting [place, object] of known nodes (got [{place!r}, {seen!r}])")
    query = update.query_place
    if query is not None and not is_place(query):
        kind = "an object" if is_object(query) else "unknown"
        raise MessageError(f"expected query_place to be a place of the graph (got {query!r}, {kind})")


def check_matches(message: PlaceMatches) -> None:
    """Refuse ranks that do not count 1, 2, … and a match without one.

    Raises:
        MessageError: as said.

    """
    for name in ("matches", "raw_matches"):
        _check_ranks(name, getattr(message, name) or [])
    for match in [*message.matches, *message.rivals]:
        if match.pose is not None:
            _check_covariance(match.pose.covariance)
    for match in message.raw_matches or []:
        if match.pose is not None:
            raise MessageError(f"expected no pose in raw_matches, which were not tested (got one of {match.place!r})")
    if message.status == "match" and not message.matches:
        raise MessageError("expected at least one match with status 'match' (got none)")


def _check_covariance(values: Sequence[float]) -> None:
    size = math.isqrt(len(values))
    for i in range(size):
        if values[i * size + i] < 0:
            raise MessageError(f"expected variances that are not negative (got {values[i * size + i]:.6g})")
        for j in range(i):
            a, b = values[i * size + j], values[j * size + i]
            if abs(a - b) > COVARIANCE_TOLERANCE * max(abs(a), abs(b), 1.0):
                raise MessageError(f"expected a symmetric covariance (got {a:.6g} and {b:.6g})")


def _check_ranks(name: str, matches: Sequence[Match]) -> None:
    ranks = [match.rank for match in matches]
    if ranks != list(range(1, len(ranks) + 1)):
        raise MessageError(f"expected ranks 1, 2, … in {name} (got {ranks[:20]})")
    _check_unique(f"place in {name}", [(match.map, match.place) for match in matches])


def check_attributions(message: ClassAttributions) -> None:
    """Refuse duplicate classes or objects, shares that rise or do not sum to 1 (all 0: nothing contributed).

    Raises:
        MessageError: as said.

    """
    _check_scores(message.classes, message.objects)


def _check_scores(classes: Sequence[ClassAttribution], objects: Sequence[ObjectAttribution]) -> None:
    _check_unique("class", [row.class_ for row in classes])
    _check_unique("object id", [row.id for row in objects])
    shares = [row.share for row in classes]
    if any(a < b for a, b in pairwise(shares)):
        raise MessageError(f"expected classes by falling share (got {shares[:20]})")
    total = math.fsum(shares)
    if total and abs(total - 1.0) > SHARE_TOLERANCE:
        raise MessageError(f"expected shares that sum to 1 (got {total:.6g})")


def check_explain_request(message: ExplainRequest) -> None:
    """Refuse a method that is asked for twice.

    Raises:
        MessageError: as said.

    """
    _check_unique("method", message.methods or [])


def check_explanation(message: Explanation) -> None:
    """Refuse what `check_attributions` refuses, in any method; a method twice; half a counterfactual.

    Raises:
        MessageError: as said.

    """
    _check_unique("method", [row.method for row in message.methods])
    for row in message.methods:
        _check_scores(row.classes, row.objects)
    if (found := message.counterfactual) is not None:
        _check_unique("removed object id", [thing.id for thing in found.removed])
        if bool(found.removed) != (found.place is not None):
            got = "objects but no place" if found.removed else f"place {found.place!r} but no objects"
            raise MessageError(f"expected a counterfactual with both removed objects and a place (got {got})")
    if message.why_not is not None:
        _check_unique("class", [row.class_ for row in message.why_not.classes])


def _check_unique(what: str, values: Iterable[Any]) -> None:
    values = list(values)
    if len(set(values)) < len(values):
        value, times = Counter(values).most_common(1)[0]
        raise MessageError(f"expected each {what} once (got {value!r} {times} times)")


CHECKS: dict[type[Any], Callable[[Any], None]] = {
    SceneGraphUpdate: check_update,
    PlaceMatches: check_matches,
    ClassAttributions: check_attributions,
    ExplainRequest: check_explain_request,
    Explanation: check_explanation,
}
