"""How right the answers along a run were, by distance travelled. Memory does not grow with the run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.graph import Floats
from semloc_core.metrics import Histogram, PoseErrors
from semloc_core.wire import PlaceMatches, Position

FROM_METRES = (0.0, 5.0, 10.0, 20.0, 40.0)
"""Where the distance brackets begin; a row's scope is the bracket's beginning (``5m``: 5 m to 10 m)."""
TOP = (1, 5, 10)
LatencyHistogram = Histogram


def error_of(answer: PlaceMatches, position: Position, yaw: float | None) -> tuple[Floats, float | None, Floats] | None:
    """What `PoseErrors.add` takes of an answer's first match; None where that has no pose."""
    pose = answer.matches[0].pose if answer.matches else None
    if pose is None:
        return None
    heading = None if yaw is None or pose.yaw is None else pose.yaw - yaw
    return np.subtract(pose.position, position), heading, np.array(pose.covariance).reshape(4, 4)


@dataclass
class _Bracket:
    queries: int = 0
    answered: int = 0
    accepted: int = 0
    accepted_right: int = 0
    wrong_storey: int = 0
    right: dict[int, int] = field(default_factory=lambda: dict.fromkeys(TOP, 0))
    chance: float = 0.0
    off_m: Histogram = field(default_factory=Histogram)
    poses: PoseErrors = field(default_factory=PoseErrors)


SameStorey = Callable[[str, str, Position], bool]
"""Whether a place (a building and an id) is on the storey that a point of that building is on (m)."""
Chance = Callable[[str, Position], float]
"""The share of a map's places that are right where the robot is at a point (m) of a building."""


def right_matches(answer: PlaceMatches, building: str, position: Position, same_storey: SameStorey) -> list[bool]:
    """For each match in turn, whether it is right: within `MATCH_RADIUS_M` of ``position`` (m) and on its storey."""
    return [
        m.map == building
        and float(np.linalg.norm(np.subtract(m.position, position))) <= MATCH_RADIUS_M
        and same_storey(m.map, m.place, position)
        for m in answer.matches
    ]


def on_wrong_storey(answer: PlaceMatches, building: str, position: Position, same_storey: SameStorey) -> bool:
    """Whether the first match is over or under where the robot is, within the radius in the plane."""
    for m in answer.matches[:1]:
        flat = float(np.linalg.norm(np.subtract(m.position[:2], position[:2])))
        return m.map == building and flat <= MATCH_RADIUS_M and not same_storey(m.map, m.place, position)
    return False


class TraversalScore:
    """Compares answers with where the robot truly was.

    Args:
        buildings: names of the map's buildings. Where there are several, a truth counts only if its frame is the
            name of one, and a match only in that one.
        left_out: names of buildings that the map has besides, in which no answer could be: where the truth is in one,
            answers are wrong.
        same_storey: of the map; None for a map of one storey a building.
        chance: of the map; None where the map is not at hand.

    """

    def __init__(
        self,
        buildings: Sequence[str],
        left_out: Sequence[str] = (),
        same_storey: SameStorey | None = None,
        chance: Chance | None = None,
    ) -> None:
        self._chance = chance
        self._same_storey = same_storey or _one_storey
        self._buildings, self._left_out = tuple(buildings), frozenset(left_out)
        self._brackets = [_Bracket() for _ in FROM_METRES]
        self._total = _Bracket()
        self._travelled = 0.0
        self._last: tuple[str, Position] | None = None
        self.unscored = 0

    def building_of(self, frame_id: str) -> str | None:
        """The building that a ground truth in this frame is in; None where that can't be told."""
        if frame_id in self._buildings or frame_id in self._left_out:
            return frame_id
        return self._buildings[0] if len(self._buildings) == 1 else None

    def right(self, answer: PlaceMatches, building: str, position: Position) -> list[bool]:
        """For each match in turn, whether it is right, were the robot there."""
        return right_matches(answer, building, position, self._same_storey)

    def add(self, answer: PlaceMatches, position: Position, frame_id: str, yaw: float | None = None) -> bool:
        """Score one answer.

        Args:
            answer: the published matches.
            position: where the robot truly was (m), in the frame ``frame_id``.
            frame_id: of the truth; a building's name, or anything where the map has one building only.
            yaw: where it truly headed, radians, in the same frame; None where that is not known.

        Returns:
            Whether the answer could be scored.

        """
        building = self.building_of(frame_id)
        if building is None:
            self.unscored += 1
            return False
        if self._last is not None and self._last[0] == frame_id:
            self._travelled += float(np.linalg.norm(np.subtract(position, self._last[1])))
        self._last = (frame_id, position)
        near = self.right(answer, building, position)
        beside = answer.status == "match" and on_wrong_storey(answer, building, position, self._same_storey)
        error = error_of(answer, position, yaw)
        bracket = self._brackets[int(np.searchsorted(FROM_METRES, self._travelled, side="right")) - 1]
        chance = self._chance(building, position) if self._chance is not None and building in self._buildings else 0.0
        for tally in (bracket, self._total):
            tally.queries += 1
            tally.chance += chance
            tally.answered += bool(near)
            if answer.status == "match":
                tally.accepted += 1
                tally.accepted_right += near[0]
                tally.wrong_storey += beside
            for n in TOP:
                tally.right[n] += any(near[:n])
            if near and near[0]:
                tally.off_m.add(float(np.linalg.norm(np.subtract(answer.matches[0].position, position))))
                if error is not None:
                    tally.poses.add(*error)
        return True

    def rows(self, method: str) -> list[dict[str, object]]:
        """One row for each distance bracket that has queries, and one for all.

        ``answered``: share of queries with any match listed (an unanswered one counts as wrong);
        ``chance``: success@1 of a blind guess, the share of the map's places that are right, averaged over the queries
        (null where the map is not at hand);
        ``accepted``: share with status ``match``; ``precision``: share of those that are right (null where none);
        ``wrong_storey``: how many of them are over or under the truth, on another storey;
        Figures of `PoseErrors` are of the first match's pose, where that match is right.
        ``error_m``: median distance (m) of the first match from the truth, where that match is right (null where none).
        """
        brackets = [(f"{start:g}m", b) for start, b in zip(FROM_METRES, self._brackets, strict=True)]
        return [
            {
                "method": method,
                "scope": scope,
                "queries": b.queries,
                "answered": b.answered / b.queries,
                "chance": b.chance / b.queries if self._chance is not None else None,
                **{f"success@{n}": b.right[n] / b.queries for n in TOP},
                "accepted": b.accepted / b.queries,
                "precision": b.accepted_right / b.accepted if b.accepted else None,
                "wrong_storey": b.wrong_storey,
                "error_m": b.off_m.percentile(50),
                **b.poses.figures(),
            }
            for scope, b in [*brackets, ("all", self._total)]
            if b.queries
        ]


def _one_storey(building: str, place: str, position: Position) -> bool:
    return True
