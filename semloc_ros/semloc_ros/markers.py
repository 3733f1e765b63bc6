# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""What RViz and Foxglove draw: the map, the top matches, the query and the objects that speak for the match."""

from __future__ import annotations

import colorsys
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from semloc_core.map_database import LoadedMap
from semloc_core.wire import Match, PlaceMatches, Position, quaternion_of
from semloc_ros.conversions import header, point, quaternion

PLACE_M = 0.15
OBJECT_M = 0.35
MATCH_M = 0.6
TEXT_M = 0.35
ROBOT_M = 0.9
SEEN_M = 0.25
LINE_M = 0.04
ELLIPSE = math.sqrt(-2 * math.log(0.05))
"""Half an axis of the ellipse that holds 95 of 100, in standard deviations (two dimensions)."""
GREY = ColorRGBA(r=0.6, g=0.6, b=0.6, a=0.7)
WHITE = ColorRGBA(r=1.0, g=1.0, b=1.0, a=0.9)
QUERY = ColorRGBA(r=0.0, g=0.45, b=0.7, a=1.0)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What is around a query place, in the frame of the updates.

    Args:
        frame_id: of the positions.
        position: of the query place, metres.
        objects: object id -> position, metres.

    """

    frame_id: str
    position: Position
    objects: Mapping[str, Position]


class MarkerIds:
    """A number for each name, the same for as long as the name keeps coming."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._free: list[int] = []
        self._unused = 0

    def update(self, names: Iterable[str]) -> tuple[dict[str, int], list[int]]:
        """The numbers of the names that are there now, and the numbers that went out of use."""
        wanted = list(dict.fromkeys(names))
        kept = set(wanted)
        gone = [self._numbers.pop(name) for name in list(self._numbers) if name not in kept]
        for name in wanted:
            if name in self._numbers:
                continue
            if not self._free:
                self._free.append(self._unused)
                self._unused += 1
            self._numbers[name] = self._free.pop()
        self._free.extend(gone)
        return {name: self._numbers[name] for name in wanted}, gone


def delete_all() -> MarkerArray:
    """Clears what was drawn of another map."""
    return MarkerArray(markers=[Marker(action=Marker.DELETEALL)])


def match_markers(answer: PlaceMatches, top_n: int, frame_of: Callable[[str], str]) -> MarkerArray:
    """The top matches with their probability, the sure ones green, the unsure ones red; numbered by rank.

    Args:
        answer: the answer.
        top_n: matches that an answer may list.
        frame_of: gives a building's frame.

    """
    head = header(answer.stamp_ns, answer.frame_id)
    shown = MarkerArray()
    for match in answer.matches:
        head = header(answer.stamp_ns, frame_of(match.map))
        ball = _marker(head, "matches", match.rank, Marker.SPHERE, match.position, MATCH_M)
        ball.color = _between_red_and_green(match.probability, 0.95 if match.rank == 1 else 0.6)
        text = _marker(head, "probabilities", match.rank, Marker.TEXT_VIEW_FACING, _above(match.position), TEXT_M)
        text.text, text.color = _label(match), WHITE
        shown.markers += [ball, text]
    for rank in range(len(answer.matches) + 1, top_n + 1):
        shown.markers += [_deletion(head, "matches", rank), _deletion(head, "probabilities", rank)]
    return shown


def query_markers(answer: PlaceMatches, around: Surroundings | None) -> MarkerArray:
    """Where the robot is in its own graph; deleted where it does not say."""
    if around is None:
        return MarkerArray(markers=[_deletion(header(answer.stamp_ns, answer.frame_id), "query", 0)])
    head = header(answer.stamp_ns, around.frame_id)
    cube = _marker(head, "query", 0, Marker.CUBE, around.position, MATCH_M)
    cube.color = QUERY
    return MarkerArray(markers=[cube])


def robot_markers(pose: PoseWithCovarianceStamped, yaw_known: bool) -> MarkerArray:
    """The robot as an arrow, a ball where its heading is not known, on the ellipse that holds it 95 times in 100."""
    head, at = pose.header, pose.pose.pose
    here = (at.position.x, at.position.y, at.position.z)
    robot = _marker(head, "robot", 0, Marker.ARROW if yaw_known else Marker.SPHERE, here, ROBOT_M / 2)
    robot.pose, robot.color = at, QUERY
    if yaw_known:
        robot.scale = Vector3(x=ROBOT_M, y=ROBOT_M / 6, z=ROBOT_M / 6)
    variance, axes = np.linalg.eigh(np.reshape(pose.pose.covariance, (6, 6))[:2, :2])
    lengths = np.maximum(2 * ELLIPSE * np.sqrt(np.maximum(variance, 0)), 0.01)
    ellipse = _marker(head, "robot", 1, Marker.CYLINDER, here, 0.02)
    ellipse.pose.orientation = quaternion(quaternion_of(math.atan2(axes[1, 1], axes[0, 1])))
    ellipse.scale = Vector3(x=float(lengths[1]), y=float(lengths[0]), z=0.02)
    ellipse.color = ColorRGBA(r=QUERY.r, g=QUERY.g, b=QUERY.b, a=0.3)
    return MarkerArray(markers=[robot, ellipse])


def no_robot(head: Header) -> MarkerArray:
    """Deletes what `robot_markers` and `laid_markers` drew."""
    return MarkerArray(
        markers=[_deletion(head, name, i) for name, i in (("robot", 0), ("robot", 1), ("seen", 0), ("explained", 0))]
    )


@dataclass(frozen=True)
class Laid:
    """An object that the robot sees, laid on the map.

    Args:
        position: in the building's frame, metres.
        colour: of its class.
        mapped: where the mapped object that explains it is, metres; None where none does.

    """

    position: Position
    colour: ColorRGBA
    mapped: Position | None


def laid_markers(head: Header, objects: Sequence[Laid]) -> MarkerArray:
    """Seen objects on the map, each joined to what it was matched with."""
    seen = _marker(head, "seen", 0, Marker.SPHERE_LIST, (0.0, 0.0, 0.0), SEEN_M)
    joined = _marker(head, "explained", 0, Marker.LINE_LIST, (0.0, 0.0, 0.0), LINE_M)
    joined.color = WHITE
    for item in objects:
        seen.points.append(point(item.position))
        seen.colors.append(item.colour)
        if item.mapped is not None:
            joined.points += [point(item.position), point(item.mapped)]
    # A list without points is refused by those who draw.
    return MarkerArray(markers=[m if m.points else _deletion(head, m.ns, m.id) for m in (seen, joined)])


def attribution_markers(
    scores: Mapping[str, float], around: Surroundings, ids: MarkerIds, stamp_ns: int
) -> MarkerArray:
    """Objects from pale (say nothing) to orange (speak for the match most) or purple (against it).

    Args:
        scores: object id -> signed score.
        around: where the objects are.
        ids: gives each object its number; keep it from call to call.
        stamp_ns: of the answer.

    """
    head = header(stamp_ns, around.frame_id)
    known = {node: score for node, score in scores.items() if node in around.objects}
    largest = max((abs(score) for score in known.values()), default=0.0) or 1.0
    numbers, gone = ids.update(known)
    shown = MarkerArray(markers=[_deletion(head, "attributions", number) for number in gone])
    for node, number in numbers.items():
        cube = _marker(head, "attributions", number, Marker.CUBE, around.objects[node], OBJECT_M)
        strength = abs(known[node]) / largest
        cube.color = _fade(0.08 if known[node] >= 0 else 0.78, strength)
        shown.markers.append(cube)
    return shown


def map_markers(loaded: LoadedMap, frame_of: Callable[[str], str], stamp: Time) -> MarkerArray:
    """The map: all places, objects by class, names of buildings, each in its own frame; what was drawn is cleared."""
    shown = delete_all()
    for building in loaded.buildings:
        head = Header(stamp=stamp, frame_id=frame_of(building))
        rows = loaded.rows_of(building)
        places = _marker(head, f"places of {building}", 0, Marker.SPHERE_LIST, (0.0, 0.0, 0.0), PLACE_M)
        places.points = [point(tuple(p)) for p in loaded.positions[rows].tolist()]
        places.color = GREY
        middle = loaded.positions[rows].mean(0)
        text = _marker(head, "buildings", len(shown.markers), Marker.TEXT_VIEW_FACING, tuple(middle.tolist()), 1.0)
        text.text, text.color = building, WHITE
        shown.markers += [places, text, *_map_objects(loaded, building, head)]
    return shown


def _map_objects(loaded: LoadedMap, building: str, head: Header) -> list[Marker]:
    positions: dict[str, list[Position]] = defaultdict(list)
    for item in loaded.graph(building).objects.values() if loaded.stored else ():
        positions[item.class_].append(item.position)
    space = loaded.model.labelspace
    found = []
    for number, name in enumerate(sorted(positions)):
        cubes = _marker(head, f"objects of {building}", number, Marker.CUBE_LIST, (0.0, 0.0, 0.0), OBJECT_M)
        cubes.points = [point(p) for p in positions[name]]
        cubes.color = class_colour(space.index(name), len(space))
        found.append(cubes)
    return found


def class_colour(index: int, count: int) -> ColorRGBA:
    """A class's colour: hues spread over the labelspace; grey for a class that it lacks (-1)."""
    if index < 0:
        return GREY
    red, green, blue = colorsys.hsv_to_rgb(index / count, 0.65, 0.9)
    return ColorRGBA(r=red, g=green, b=blue, a=0.8)


def _marker(head: Header, namespace: str, number: int, kind: int, position: Sequence[float], size: float) -> Marker:
    marker = Marker(header=head, ns=namespace, id=number, type=kind, action=Marker.ADD)
    marker.pose.position = point((position[0], position[1], position[2]))
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(x=size, y=size, z=size)
    return marker


def _deletion(head: Header, namespace: str, number: int) -> Marker:
    return Marker(header=head, ns=namespace, id=number, action=Marker.DELETE)


def _above(position: Position) -> Position:
    x, y, z = position
    return x, y, z + MATCH_M


def _label(match: Match) -> str:
    return f"{match.rank}: {match.probability:.2f}"


def _between_red_and_green(value: float, alpha: float) -> ColorRGBA:
    red, green, blue = colorsys.hsv_to_rgb(value / 3, 0.9, 0.9)
    return ColorRGBA(r=red, g=green, b=blue, a=alpha)


def _fade(hue: float, strength: float) -> ColorRGBA:
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.15 + 0.85 * strength, 0.95)
    return ColorRGBA(r=red, g=green, b=blue, a=0.3 + 0.7 * strength)
