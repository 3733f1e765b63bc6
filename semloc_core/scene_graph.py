"""The scene graph as the robot knows it now: places, objects, and what connects them. No torch here."""

from __future__ import annotations

from dataclasses import dataclass, field

from semloc_core.wire import Object, Position, SceneGraphUpdate


@dataclass(frozen=True)
class Change:
    """What an update touched, for whoever keeps something derived from the graph.

    Args:
        full: everything is new; the sets below are then empty.
        places: places added, moved or removed.
        edges: traversability edges added or removed, as (a, b) with a < b.
        objects: objects added, changed (class, position, parents, sightings) or removed.

    """

    full: bool = False
    places: frozenset[str] = frozenset()
    edges: frozenset[tuple[str, str]] = frozenset()
    objects: frozenset[str] = frozenset()


@dataclass
class SceneGraph:
    """Mutable graph state. Read the attributes freely; change them only through `apply`.

    Attributes:
        places: place id -> position (m).
        objects: object id -> the object (class name, position, size).
        neighbours: place id -> {neighbouring place id: Euclidean length (m)}; symmetric; every place has a row.
        parents: object id -> places that the object has an edge to; every object has a row.
        children: place id -> objects with an edge to it; only places that have any.
        sightings: object id -> places it was explicitly seen from; only objects that have any.
        version: counts accepted updates.

    """

    places: dict[str, Position] = field(default_factory=dict)
    objects: dict[str, Object] = field(default_factory=dict)
    neighbours: dict[str, dict[str, float]] = field(default_factory=dict)
    parents: dict[str, set[str]] = field(default_factory=dict)
    children: dict[str, set[str]] = field(default_factory=dict)
    sightings: dict[str, set[str]] = field(default_factory=dict)
    version: int = 0

    def apply(self, update: SceneGraphUpdate) -> Change:
        """Apply an update, all or nothing."""
        raise NotImplementedError
