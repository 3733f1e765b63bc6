"""Detections, poses of the robot and, where there is one, an occupancy grid become a scene graph and its updates.

An object is what detections near each other, of like size and class, or of one tracking id, are of. Whatever is
looked up is looked up in cells of a metre: what a view costs does not depend on how large the graph is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
from msgspec import Meta

from semloc_core.config import Checked
from semloc_core.errors import ConfigError, MessageError
from semloc_core.graph import Floats, ball
from semloc_core.sources.detections.frames import Rigid
from semloc_core.sources.detections.grid import EDGE_LENGTHS, Grid, free_places
from semloc_core.sources.detections.nav2 import short
from semloc_core.sources.detections.things import Cells, Detection, Seen, Thing, View
from semloc_core.sources.hydra.write import node_id
from semloc_core.wire import Object, Odometry, Place, Position, SceneGraphUpdate

JUMP_M = 2.0
"""Farther the robot does not go between two poses: its frame jumped, and nothing says that one can walk there."""
STOREY_M = 1.0
"""Places that are farther apart in height are not near each other."""
DETOUR = 3.0
"""A near place is near for the robot too if the known way there is no longer than so many spacings."""
MEMORY = 20.0
"""Sightings that a position and a histogram of labels remember."""
MOVED_M = 0.02
"""An object that moved less is not written anew."""
MOVED_SHARE = 0.05
"""Nor is one whose labels' shares changed less."""


class BuilderConfig(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of `GraphBuilder`; make one with `of`, which checks ranges."""

    min_score: Annotated[
        float, Meta(ge=0.0, le=1.0, description="detections whose best class scores lower are left out")
    ] = 0.3
    association_m: Annotated[
        float, Meta(gt=0.0, le=100.0, description="a detection so near an object may be of it, m; large ones reach out")
    ] = 0.6
    confirm_after: Annotated[int, Meta(ge=1, le=1000, description="sightings after which an object is published")] = 3
    forget_after: Annotated[
        int, Meta(ge=1, le=100000, description="an object is forgotten when looked at so often in a row and not seen")
    ] = 10
    range_m: Annotated[
        float, Meta(gt=0.0, le=1000.0, description="how far the detector sees: what is nearer counts as looked at, m")
    ] = 4.0
    horizontal_fov_deg: Annotated[
        float, Meta(gt=0.0, le=360.0, description="what counts as looked at: width of the field of view, degrees")
    ] = 60.0
    vertical_fov_deg: Annotated[
        float, Meta(gt=0.0, le=180.0, description="what counts as looked at: height of the field of view, degrees")
    ] = 40.0
    place_spacing_m: Annotated[float, Meta(ge=0.1, le=100.0, description="distance between places, m")] = 0.6
    robot_radius_m: Annotated[
        float, Meta(gt=0.0, le=10.0, description="radius of the robot: where it fits there may be places, m")
    ] = 0.25
    full_every_s: Annotated[
        float, Meta(ge=0.0, le=3600.0, description="seconds between full updates; 0: each update is full")
    ] = 5.0


class GraphBuilder:
    """A scene graph that grows as a robot looks around. The same input makes the same updates.

    Args:
        config: options.
        frame_id: of all poses and of the updates.

    """

    def __init__(self, config: BuilderConfig, frame_id: str) -> None:
        if not frame_id:
            raise ConfigError("expected a frame for the graph (got an empty name)")
        self.config, self.frame_id = config, frame_id
        self._things: dict[str, Thing] = {}
        self._thing_cells = Cells()
        self._tracks: dict[tuple[str, str], str] = {}
        self._tracks_of: dict[str, set[tuple[str, str]]] = {}
        self._places: dict[str, Floats] = {}
        self._place_cells = Cells()
        self._ways: dict[str, dict[str, float]] = {}
        self._children: dict[str, set[str]] = {}
        self._grid: Grid | None = None
        self._blocks: dict[tuple[int, int, int], str] = {}
        self._of_grid: frozenset[str] = frozenset()
        self._count = {"p": 0, "O": 0}
        self._here = ""
        self._robot: Rigid | None = None
        self._stamp_ns = 0
        # What receivers have, of what may have changed since.
        self._sent_things: dict[str, tuple[Object, str]] = {}
        self._sent_places: dict[str, Position] = {}
        self._sent_ways: set[tuple[str, str]] = set()
        self._new: dict[str, set[str]] = {"places": set(), "objects": set()}
        self._new_ways: set[tuple[str, str]] = set()
        self._seq = -1
        self._full_ns: int | None = None

    def ask_full(self) -> None:
        """Have the next update be a full one."""
        self._full_ns = None

    def walk(self, robot: Rigid, stamp_ns: int) -> None:
        """The robot is here (pose in the graph's frame, time in ns): a place, and a way to it, where there is none."""
        self._robot, self._stamp_ns = robot, max(stamp_ns, self._stamp_ns)
        here, position = self._here, robot.translation
        spacing = self.config.place_spacing_m
        near = [key for key in self._near_places(position, spacing) if self._reachable(key, position)]
        if near:
            self._here = min(near, key=lambda key: (_distance(self._places[key], position), key))
        else:
            self._here = self._add_place(position)
            self._join_in_sight(self._here)
        came = here and here != self._here and _distance(self._places[here], position) <= JUMP_M
        if came and self._line_is_free(here, self._here):
            self._join(here, self._here)

    def see(self, view: View) -> None:
        """Take in what a sensor saw, all or nothing.

        Raises:
            MessageError: a pose, size or score is none.

        """
        seen = [found for detection in view.detections if (found := self._checked(view, detection)) is not None]
        self.walk(view.robot, view.stamp_ns)
        matched = self._associate(seen, view.source)
        hit: set[str] = set()
        for one, key in zip(seen, matched, strict=True):
            thing = self._things[key] if key else self._add_thing(one)
            hit.add(thing.key)
            self._fuse(thing, one)
            if one.track:
                self._follow((view.source, one.track), thing.key)
        for key in sorted(set(self._looked_at(view)) - hit):
            thing = self._things[key]
            thing.missed += 1
            if thing.missed >= self.config.forget_after:
                self._forget(thing)

    def set_grid(self, grid: Grid) -> None:
        """Take an occupancy grid in the graph's frame: places over its free space, in place of the last one's.

        Where a place stays in its block it keeps its id. This costs the grid's size.

        Raises:
            GraphError: the robot fits nowhere in it; all is as it was.

        """
        known = self._grid
        same = known is not None and (known.resolution, known.origin) == (grid.resolution, grid.origin)
        if same and known is not None and np.array_equal(known.cells, grid.cells):
            return
        space = free_places(grid, self.config.place_spacing_m, self.config.robot_radius_m)
        self._grid = grid
        height = float(self._robot.translation[2]) if self._robot is not None else 0.0
        blocks, self._blocks = self._blocks, {}
        ids: list[str] = []
        for block, (x, y) in zip(space.blocks, space.points.tolist(), strict=True):
            key = blocks.pop(block, "")
            position = np.array([x, y, self._places[key][2] if key else height])
            if key:
                self._move_place(key, position)
            else:
                key = self._add_place(position)
            self._blocks[block] = key
            ids.append(key)
        for key in blocks.values():
            self._remove_place(key)
        own = self._of_grid = frozenset(ids)
        wanted = {_ordered(ids[a], ids[b]) for a, b in space.edges.T.tolist()}
        for a in sorted(self._places):
            for b in sorted(self._ways[a]):
                both = a in own and b in own
                if a < b and ((a, b) not in wanted if both else not self._line_is_free(a, b)):
                    self._part(a, b)
        for a, b in sorted(wanted):
            self._join(a, b)
        for a in sorted(self._places.keys() - own):
            self._join_in_sight(a)
        if self._robot is not None:
            self.walk(self._robot, self._stamp_ns)
        for key in sorted(self._things):
            self._hang(self._things[key])

    def update(self) -> SceneGraphUpdate:
        """What changed since the last update; everything, every few seconds and where `ask_full` asked for it."""
        stamp_ns, due = self._stamp_ns, self._full_ns
        full = due is None or stamp_ns >= due + round(self.config.full_every_s * 1e9)
        if full:
            self._full_ns = stamp_ns
        places = sorted(self._places if full else self._new["places"])
        things = sorted(self._things if full else self._new["objects"])
        removed, objects, edges, cut = [], [], [], []
        put: list[Place] = []
        if full:
            self._sent_places, self._sent_things, self._sent_ways = {}, {}, set()
        for key in places:
            if key not in self._places:
                if self._sent_places.pop(key, None) is not None:
                    removed.append(key)
                continue
            position = _rounded(self._places[key])
            if self._sent_places.get(key) != position:
                self._sent_places[key] = position
                put.append(Place(key, position))
        for key in things:
            thing, was = self._things.get(key), self._sent_things.get(key)
            if thing is None or thing.sightings < self.config.confirm_after:
                if was is not None:
                    del self._sent_things[key]
                    removed.append(key)
                continue
            now = self._object(thing)
            if was is None or now != was[0]:
                objects.append(now)
            if was is None or thing.parent != was[1]:
                edges.append((thing.parent, key))
                if was is not None and was[1] in self._sent_places:
                    cut.append((was[1], key))
            self._sent_things[key] = now, thing.parent
        ways = {_ordered(a, b) for a in places for b in self._ways.get(a, ())} if full else self._new_ways
        for way in sorted(ways):
            there = way[1] in self._ways.get(way[0], ())
            if there and way not in self._sent_ways:
                self._sent_ways.add(way)
                edges.append(way)
            elif not there and way in self._sent_ways:
                self._sent_ways.discard(way)
                if way[0] in self._sent_places and way[1] in self._sent_places:
                    cut.append(way)
        self._new = {"places": set(), "objects": set()}
        self._new_ways = set()
        self._seq += 1
        return SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=stamp_ns,
            frame_id=self.frame_id,
            seq=self._seq,
            full=full,
            places=put,
            objects=objects,
            edges=edges,
            query_place=self._here or None,
            removed_nodes=removed,
            removed_edges=cut,
            odometry=self._odometry(),
        )

    def _odometry(self) -> Odometry | None:
        if self._robot is None:
            return None
        x, y, z, w = (round(float(value), 9) for value in self._robot.quaternion)
        return Odometry(_rounded(self._robot.translation), (x, y, z, w), self.frame_id)

    def _object(self, thing: Thing) -> Object:
        size = None if thing.size is None else _rounded(thing.size)
        return Object(thing.key, thing.class_(), self._written(thing), size, self._labels(thing))

    def _labels(self, thing: Thing) -> dict[str, float] | None:
        """What a thing may be, where that is several: what it was said to be, as long as that hardly changed."""
        shares, was = thing.shares(), self._sent_things.get(thing.key)
        if len(shares) < 2:
            return None
        said = (was[0].labels if was is not None and was[0].class_ == thing.class_() else None) or {}
        same = said.keys() == shares.keys() and all(abs(said[name] - p) < MOVED_SHARE for name, p in shares.items())
        return said if same else shares

    def _written(self, thing: Thing) -> Position:
        """Where a thing is said to be: where it was said to be, as long as it hardly moved."""
        was = self._sent_things.get(thing.key)
        if was is not None and _distance(np.array(was[0].position), thing.position) < MOVED_M:
            return was[0].position
        return _rounded(thing.position)

    # Objects.

    def _checked(self, view: View, detection: Detection) -> Seen | None:
        """A detection in the graph's frame; None where it scores too low."""
        scores = dict(detection.scores)
        for name, score in scores.items():
            if not (name and 0.0 <= score <= 1.0):
                raise MessageError(f"expected class names with scores in 0 … 1 (got {name!r}: {score})")
        size = detection.size
        if size is not None and not all(0.0 <= edge <= 1e9 for edge in size):
            raise MessageError(f"expected a size of 0 m and more (got {size})")
        if scores and max(scores.values()) < self.config.min_score:
            return None
        total = sum(scores.values())
        if total > 1.0:
            scores = {name: score / total for name, score in scores.items()}
        pose = view.sensor @ detection.pose
        if not (np.abs(pose.translation) <= 1e9).all():
            raise MessageError(f"expected a position of at most 10⁹ m (got {pose.translation.tolist()})")
        box = np.abs(pose.rotation) @ np.array(size) if size is not None and any(size) else None
        away = _distance(pose.translation, view.sensor.translation)
        return Seen(pose.translation, box, scores, detection.track, away)

    def _associate(self, seen: list[Seen], source: str) -> list[str]:
        """For each detection the object that it is of; empty: a new one. Each object once, the nearest first."""
        matched = [""] * len(seen)
        taken: set[str] = set()
        for i, one in enumerate(seen):
            key = self._tracks.get((source, one.track), "") if one.track else ""
            # Trackers give an id anew: it holds as far as an object may have moved.
            if key and key not in taken and _distance(self._things[key].position, one.position) <= JUMP_M:
                matched[i] = key
                taken.add(key)
        costs = []
        for i, one in enumerate(seen):
            if matched[i]:
                continue
            reach = self.config.association_m + 0.05 * one.away
            for key in self._thing_cells.near(one.position, reach + self._largest(one)):
                if (cost := self._cost(one, self._things[key], reach)) is not None:
                    costs.append((cost, i, key))
        for _, i, key in sorted(costs):
            if not matched[i] and key not in taken:
                matched[i] = key
                taken.add(key)
        return matched

    @staticmethod
    def _largest(one: Seen) -> float:
        return 0.0 if one.size is None else 0.25 * float(one.size.max())

    def _cost(self, one: Seen, thing: Thing, reach: float) -> float | None:
        """How unlike a detection and an object are, 0 … 1; None: too unlike to be one."""
        reach += self._largest(one)
        cost = _distance(one.position, thing.position) / reach
        shares = thing.shares()
        common = sum(min(share, one.scores.get(name, 0.0)) for name, share in shares.items())
        most = min(sum(one.scores.values()), sum(shares.values()))
        if most > 0:  # what has no name is like anything
            cost += 0.5 * (1.0 - min(common / most, 1.0))
        if one.size is not None and thing.size is not None:
            ratio = np.log((one.size + 0.1) / (thing.size + 0.1))
            cost += 0.2 * float(np.abs(ratio).mean())
        return round(cost, 9) if cost <= 1.0 else None

    def _add_thing(self, one: Seen) -> Thing:
        thing = Thing(self._next("O"), one.position, one.size, 0.0, {})
        self._things[thing.key] = thing
        self._thing_cells.put(thing.key, thing.position)
        return thing

    def _fuse(self, thing: Thing, one: Seen) -> None:
        weight = 1.0 / max(one.away, 1.0) ** 2  # stereo's and depth cameras' errors grow with the square
        part = weight / (thing.weight + weight)
        self._thing_cells.drop(thing.key, thing.position)
        thing.position = thing.position + part * (one.position - thing.position)
        self._thing_cells.put(thing.key, thing.position)
        thing.weight = min(thing.weight + weight, MEMORY)
        if one.size is not None:
            thing.size = one.size if thing.size is None else thing.size + part * (one.size - thing.size)
        fade = min(1.0, MEMORY / (thing.total + 1.0))
        names = [*thing.labels, *(name for name in one.scores if name not in thing.labels)]
        thing.labels = {name: fade * (thing.labels.get(name, 0.0) + one.scores.get(name, 0.0)) for name in names}
        thing.total = fade * (thing.total + 1.0)
        thing.sightings += 1
        thing.missed = 0
        thing.seen_from.add(self._here)
        self._hang(thing)
        self._new["objects"].add(thing.key)

    def _follow(self, track: tuple[str, str], key: str) -> None:
        """From now on a tracking id is of this object."""
        if (was := self._tracks.get(track)) is not None:
            self._tracks_of[was].discard(track)
        self._tracks[track] = key
        self._tracks_of.setdefault(key, set()).add(track)

    def _forget(self, thing: Thing) -> None:
        self._thing_cells.drop(thing.key, thing.position)
        for track in self._tracks_of.pop(thing.key, ()):
            del self._tracks[track]
        self._children[thing.parent].discard(thing.key)
        del self._things[thing.key]
        self._new["objects"].add(thing.key)

    def _looked_at(self, view: View) -> Iterator[str]:
        """Objects that the sensor would see: in range and field of view, and nothing known is between."""
        turn, range_m = view.sensor.rotation, self.config.range_m
        where = view.sensor.translation
        wide, high = (
            math.radians(value) / 2 for value in (self.config.horizontal_fov_deg, self.config.vertical_fov_deg)
        )
        for key in self._thing_cells.near(where, range_m):
            thing = self._things[key]
            x, y, z = (float(value) for value in turn.T @ (thing.position - where))
            ahead, left, up = (z, -x, -y) if view.optical else (x, y, z)
            if math.hypot(ahead, left, up) > range_m or abs(math.atan2(left, ahead)) > wide:
                continue
            if abs(math.atan2(up, math.hypot(ahead, left))) <= high and self._unhidden(thing, where):
                yield key

    def _unhidden(self, thing: Thing, where: Floats) -> bool:
        """Whether an object is in sight of a sensor by the grid; without one, whether it was seen from this place."""
        if self._grid is None or not self._grid.at(self._grid.open, where[None, :2])[0]:
            return self._here in thing.seen_from
        size = None if thing.size is None else _rounded(thing.size)
        return bool(self._grid.sight(where[None, :2], thing.position[None, :2], short(size))[0])

    def _hang(self, thing: Thing) -> None:
        """Hang an object on the nearest of the places that see it: by the grid, else from where it was seen."""
        seen = [key for key in thing.seen_from if key in self._places]
        if self._grid is not None:
            size = None if thing.size is None else _rounded(thing.size)
            near = [
                key
                for key in self._near_places(thing.position, 2.0 + short(size), JUMP_M)
                if key in self._of_grid and key not in thing.seen_from
            ]
            if near:
                starts = np.array([self._places[key][:2] for key in near])
                ends = np.broadcast_to(thing.position[:2], starts.shape)
                clear = self._grid.sight(starts, ends, short(size))
                seen += [key for key, good in zip(near, clear.tolist(), strict=True) if good]
        best = min(seen or [self._here], key=lambda key: (round(_distance(self._places[key], thing.position), 6), key))
        if best != thing.parent:
            if thing.parent in self._children:
                self._children[thing.parent].discard(thing.key)
            thing.parent = best
            self._children[best].add(thing.key)
            self._new["objects"].add(thing.key)

    # Places.

    def _next(self, prefix: str) -> str:
        self._count[prefix] += 1
        return node_id(prefix, self._count[prefix] - 1)

    def _near_places(self, position: Floats, radius_m: float, storey_m: float = STOREY_M) -> list[str]:
        found = []
        for key in self._place_cells.near(position, radius_m):
            away = self._places[key] - position
            if math.hypot(away[0], away[1]) <= radius_m and abs(away[2]) <= storey_m:
                found.append(key)
        return sorted(found)

    def _reachable(self, key: str, position: Floats) -> bool:
        """Whether a place is near for the robot, and not only behind a wall."""
        if key == self._here or _distance(self._places[key], position) <= self.config.robot_radius_m:
            return True  # its own body is where a wall would be
        if self._grid is not None and self._grid.at(self._grid.free, position[None, :2])[0]:
            return self._sees(position, key)
        return key in ball(self._ways, self._here, DETOUR * self.config.place_spacing_m) if self._here else False

    def _join_in_sight(self, place: str) -> None:
        """Join a place to those of the grid that are near and in sight over free cells."""
        position = self._places[place]
        for key in self._near_places(position, EDGE_LENGTHS * self.config.place_spacing_m) if self._of_grid else ():
            if key in self._of_grid and key != place and self._sees(position, key):
                self._join(place, key)

    def _sees(self, position: Floats, key: str) -> bool:
        """Whether all of the straight way from a position to a place is known to be free."""
        assert self._grid is not None
        return bool(self._grid.clear(self._grid.free, position[None, :2], self._places[key][None, :2])[0])

    def _line_is_free(self, a: str, b: str) -> bool:
        """Whether no known wall is between two places."""
        grid = self._grid
        return grid is None or bool(grid.sight(self._places[a][None, :2], self._places[b][None, :2])[0])

    def _add_place(self, position: Floats) -> str:
        key = self._next("p")
        self._places[key] = np.array(_rounded(position))
        self._place_cells.put(key, self._places[key])
        self._ways[key], self._children[key] = {}, set()
        self._new["places"].add(key)
        return key

    def _move_place(self, key: str, position: Floats) -> None:
        position = np.array(_rounded(position))
        if (position == self._places[key]).all():
            return
        self._place_cells.drop(key, self._places[key])
        self._places[key] = position
        self._place_cells.put(key, position)
        for other in self._ways[key]:
            self._ways[key][other] = self._ways[other][key] = _distance(position, self._places[other])
        self._new["places"].add(key)

    def _remove_place(self, key: str) -> None:
        for other in list(self._ways[key]):
            self._part(key, other)
        for child in self._children.pop(key):
            self._things[child].parent = ""
        self._place_cells.drop(key, self._places.pop(key))
        del self._ways[key]
        self._new["places"].add(key)
        if self._here == key:
            self._here = ""

    def _join(self, a: str, b: str) -> None:
        if b not in self._ways[a]:
            self._ways[a][b] = self._ways[b][a] = _distance(self._places[a], self._places[b])
            self._new_ways.add(_ordered(a, b))

    def _part(self, a: str, b: str) -> None:
        del self._ways[a][b], self._ways[b][a]
        self._new_ways.add(_ordered(a, b))


def _distance(a: Floats, b: Floats) -> float:
    return math.dist(a.tolist(), b.tolist())


def _ordered(a: str, b: str) -> tuple[str, str]:
    return (a, b) if a < b else (b, a)


def _rounded(values: Floats) -> Position:
    x, y, z = (round(value, 3) + 0.0 for value in values.tolist())
    return x, y, z
