"""What traversals have told of a building since it was mapped: which objects were still there, which classes move.

Kept beside the scene graph; `semloc_core.map_merge` reads and writes it. A building that was never merged has none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated

import msgspec

from semloc_core.errors import MapError
from semloc_core.text import short_repr
from semloc_core.wire import Count, Fraction, Name, Position

MAX_HISTORY_BYTES = 128 * 2**20  # of a building's history as JSON

Amount = Annotated[float, msgspec.Meta(ge=0, le=1e12)]

FIRST_SEEN = 0.8
"""Probability that an object is there which one traversal saw and none could confirm."""
MOVE_RATE = 0.2
"""Prior share of objects that are elsewhere at the next traversal."""
MOVE_RATE_COUNTS = 4.0
"""How many objects that prior weighs as much as: of all classes together, and again of a class beside all others."""


class ObjectBelief(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Whether an object is (still) where the map has it.

    Args:
        persistence: probability that it is there, after the last traversal.
        seen: traversals that saw it there, the mapping one among them.
        expected: traversals that saw it or the free space around it.

    """

    persistence: Fraction = FIRST_SEEN
    seen: Count = 1
    expected: Count = 1


class ClassChange(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How many objects of a class, over all traversals, stayed and were moved; expectations, so not whole numbers."""

    stayed: Amount = 0.0
    moved: Amount = 0.0


class Traversal(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A traversal that was merged, and what it led to.

    Args:
        source: where it came from, such as a file name.
        yaw: rotation about the vertical from its frame into the building's, radians.
        translation: the same, metres.
        residual_m: root mean square distance of the objects that it was laid by, metres.
        confirmed: objects seen where they were.
        moved: objects seen elsewhere.
        missing: objects not seen where free space was.
        added: objects that the map did not have.
        forgotten: objects that are no longer believed in.
        places: places added.
        run: digest of its scene graph, by which it is known again; empty of what was merged before these were kept.

    """

    source: str
    yaw: float
    translation: Position
    residual_m: Amount
    confirmed: Count
    moved: Count
    missing: Count
    added: Count
    forgotten: Count
    places: Count
    run: str = ""


@short_repr
class Before(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A building as it was before the last merge: its scene graph, as packed for storage, and its history."""

    digest: str
    size: Count
    graph: bytes
    history: bytes


@short_repr
class History(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A building's history: traversals merged, in order, and what is believed of objects and classes since.

    ``objects`` has those that a traversal could say something about; of others `ObjectBelief` holds by default.
    ``before`` undoes the last merge; None where something else has changed the building since.
    """

    traversals: tuple[Traversal, ...] = ()
    objects: dict[Name, ObjectBelief] = {}
    classes: dict[Name, ClassChange] = {}
    before: Before | None = None


def pack_history(history: History) -> bytes:
    """As JSON, in canonical order; empty for a building that was never merged."""
    return msgspec.json.encode(history, order="sorted") if history.traversals else b""


def unpack_history(data: bytes) -> History:
    """Read what `pack_history` wrote.

    Raises:
        MapError: it is something else, or too much.

    """
    if not data:
        return History()
    if len(data) > MAX_HISTORY_BYTES:
        raise MapError(f"expected a history of at most {MAX_HISTORY_BYTES} bytes (got {len(data)})")
    try:
        return msgspec.json.decode(data, type=History)
    except msgspec.MsgspecError as error:
        raise MapError(f"expected the history that was stored (got a damaged one: {error})") from error


def move_rates(changes: Iterable[Mapping[str, ClassChange]], classes: Iterable[str]) -> dict[str, float]:
    """Share of the objects of each class that are elsewhere at the next traversal, as the data have it.

    Posterior mean of a Beta distribution whose prior is the rate of all classes together (and that one's
    `MOVE_RATE`), each prior worth `MOVE_RATE_COUNTS` objects: a class seen little is judged as the others are.

    Args:
        changes: class changes of one or more buildings: how mobile a class is, is no matter of the building.
        classes: names of interest.

    """
    stayed: dict[str, float] = {}
    moved: dict[str, float] = {}
    for by_class in changes:
        for name, change in by_class.items():
            stayed[name] = stayed.get(name, 0.0) + change.stayed
            moved[name] = moved.get(name, 0.0) + change.moved
    n = MOVE_RATE_COUNTS
    overall = (n * MOVE_RATE + sum(moved.values())) / (n + sum(moved.values()) + sum(stayed.values()))
    return {
        name: (n * overall + moved.get(name, 0.0)) / (n + moved.get(name, 0.0) + stayed.get(name, 0.0))
        for name in sorted(set(classes))
    }
