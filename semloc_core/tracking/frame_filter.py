"""A Bayes filter over where the run's frame lies: an answer is likelier if earlier ones, made elsewhere, agree with it.

An online graph remembers, so that most of what has been seen speaks in the present answer already. What does not are
objects beyond the reach of its test. Hence a few answers are kept, made further apart than that reach: what they rest
on is independent. Each answer says where the run's frame lies in a building; so it says where the robot was at the
time of each kept one, and is as likely by it as what that one gave to this place. How far the frame may have drifted
since is reckoned with (`semloc_core.graph.SHIFT_M`, ``TURN_RAD``).

The past never silences the present: all of it together says `SWAY` nats at most, and is forgotten once answers that are
sure by themselves agree with one another, and not with it (a robot that was carried away, a mapper that began anew).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, expected_square
from semloc_core.matching import Answers
from semloc_core.text import short_repr

APART_M = 12.0
"""Kept answers are so far from one another, and speak from so far on: the reach of the test by layout."""
SAME_M = 4.0
"""A later answer so near a kept one, metres, knows more and takes its place."""
KEPT = 8
"""So many of the latest are kept."""
NEAR_M = 3.0
"""Without drift, two answers so near are one, metres."""
LEAST = 0.01
"""An answer is not less likely by a kept one than this: that may be wrong, or the robot have been carried."""
UNLISTED = 0.1
"""Share of what a kept answer leaves to all other places that a place it does not list has."""
SWAY = 4.0
"""The most that the past says for one answer against another, nats."""
SURE, AGREEING, STEP_M = 0.9, 3, 1.0
"""So many answers, so likely by themselves, each so far from the last, make the past forgotten that denies them."""


@short_repr
@dataclass(frozen=True, eq=False)
class _Answer:
    """Where the robot was in its frame (3,), metres walked by then, and the A places that it may have been at.

    Args:
        at: (3,) metres.
        walked: metres.
        building: (A,) names.
        pose: (A, 3) metres.
        heading: (A,) radians: the robot's frame turned by it is parallel to the building's.
        chance: (A,) P(right).

    """

    at: Floats
    walked: float
    building: NDArray[np.str_]
    pose: Floats
    heading: Floats
    chance: Floats

    @classmethod
    def of(cls, answers: Answers, buildings: Sequence[str], at: Floats, walked: float) -> _Answer:
        names = np.array(buildings)[answers.building]
        return cls(at, walked, names, answers.pose, answers.heading, answers.likely())

    def found_again(self, now: _Answer, drift: float | None) -> NDArray[np.bool_]:
        """(B, A) whether it has the robot where each of the present answers, B, has it then."""
        x, y, z = (self.at - now.at).tolist()
        c, s = np.cos(now.heading), np.sin(now.heading)
        then = now.pose + np.stack([c * x - s * y, s * x + c * y, np.full(len(c), z)], axis=1)
        way = abs(now.walked - self.walked) * (1.0 if drift is None else drift)
        wide = NEAR_M + 2.0 * math.sqrt(way * expected_square(math.hypot(x, y)))
        near = np.linalg.norm(then[:, None] - self.pose, axis=2) <= wide
        near &= now.building[:, None] == self.building
        found: NDArray[np.bool_] = near
        return found


class FrameFilter:
    """What earlier answers say of one more. It goes on through full updates, gaps and lost graphs."""

    def __init__(self) -> None:
        self._kept: list[_Answer] = []
        self._spots: list[Floats] = []
        self._denied: list[_Answer] = []

    def forget(self) -> None:
        """Know nothing."""
        self._kept, self._spots, self._denied = [], [], []

    def observe(
        self, answers: Answers, buildings: Sequence[str], at: Floats, walked: float, drift: float | None
    ) -> Floats:
        """Weigh an answer by those before it, and take it in for those that come after it.

        Args:
            answers: where the robot may be by the present answer alone, A of them.
            buildings: names of the map's, in order.
            at: (3,) metres, where it is in its frame.
            walked: metres so far.
            drift: of the frame, as a variance, see `semloc_core.graph.Ages.drift`; None: a usual one.

        Returns:
            (A,) by how much each is likelier than it says; 1 where nothing is known.

        """
        now = _Answer.of(answers, buildings, at, walked)
        log, elsewhere = self._said(now, drift)
        if not self._denies(now, log, drift):
            self._keep(now)
        left = math.exp(elsewhere) * max(0.0, 1.0 - float(now.chance.sum()))
        found: Floats = np.exp(log) / max(float((np.exp(log) * now.chance).sum()) + left, 1e-12)
        return found

    def _keep(self, now: _Answer) -> None:
        at = now.at
        away = [float(np.linalg.norm(spot - at)) for spot in self._spots]
        nearest = min(range(len(away)), key=away.__getitem__, default=None)
        if nearest is None or away[nearest] >= APART_M:
            self._kept, self._spots = [*self._kept[1 - KEPT :], now], [*self._spots[1 - KEPT :], at]
        elif away[nearest] <= SAME_M:
            self._kept[nearest] = now

    def buildings(self, least: float) -> tuple[str, ...]:
        """Names of those to which the latest answer kept gives at least so much."""
        last = max(self._kept, key=lambda kept: kept.walked, default=None)
        return () if last is None else tuple(np.unique(last.building[last.chance >= least]).tolist())

    def _denies(self, now: _Answer, log: Floats, drift: float | None) -> bool:
        """Whether the past, by what it says (A,), denies an answer that is sure; it is forgotten once some agreed."""
        best = int(now.chance.argmax())
        if now.chance[best] < SURE or log[best] > -SWAY / 2:
            self._denied = []
            return False
        if self._denied and not self._denied[-1].found_again(now, drift)[best][self._denied[-1].chance >= SURE].any():
            self._denied = []
        if not self._denied or now.walked - self._denied[-1].walked >= STEP_M:
            self._denied.append(now)
        if len(self._denied) < AGREEING:
            return True
        self.forget()
        return False

    def _said(self, now: _Answer, drift: float | None) -> tuple[Floats, float]:
        """What the past says for each of A answers, and for the robot being elsewhere: nats below the best of these."""
        log, elsewhere = np.zeros(len(now.chance)), 0.0
        for kept in self._kept:
            if float(np.linalg.norm(kept.at - now.at)) < APART_M:
                continue
            found = kept.found_again(now, drift)
            given = np.where(found, kept.chance, 0.0).max(axis=1)
            left = 1.0 - float(kept.chance.sum())
            log += np.log(np.maximum(given, max(UNLISTED * left, LEAST)))
            # What the present answer does not list may be what the kept one did.
            elsewhere += math.log(max(1.0 - float(kept.chance[found.any(axis=0)].sum()), LEAST))
        best = max(float(log.max()), elsewhere)
        return np.maximum(log - best, -SWAY), max(elsewhere - best, -SWAY)
