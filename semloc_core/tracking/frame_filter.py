"""A Bayes filter over where the run's frame lies: an answer is likelier if earlier ones, made elsewhere, agree with it.

An online graph remembers, so that most of what has been seen speaks in the present answer already. What does not are
objects beyond the reach of its test. Hence a few answers are kept, made further apart than that reach: what they rest
on is independent, or nearly so. Each answer says where the run's frame lies in a building; so it says where the robot
was at the time of each kept one. How far the frame may have drifted since is reckoned with
(`semloc_core.graph.SHIFT_M`, ``TURN_RAD``).

The state is where the frame lies: where one of these answers has it, or elsewhere. From a kept answer to the next the
frame goes on, or it is a new one that may lie anywhere, as a robot's that was carried away: a hidden Markov model, so
its forward algorithm (Rabiner, Proc. IEEE 1989, III.A). All that is kept is weighed together each time: an answer that
was sure and wrong, as in a twin, counts for less and less as later ones disagree with it, and a past that is denied
gives way, to much evidence at once and to little that lasts. Against another answer it makes one 1 + w / ((1 - w) a)
times as likely at most, w being `WENT_ON` and a `ANYWHERE`: 6. Where the graph itself begins anew
(`semloc_core.graph.UpdateStream`), so does the frame, and whoever keeps the filter makes it forget.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import SHIFT_M, TURN_RAD, Floats
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
WENT_ON = 0.2
"""P(the frame went on) from a kept answer to the next. Few robots are carried away that often: it also stands for what
answers have in common that are taken as independent. More brings little where rooms are alike and costs much where the
robot was carried, less brings nothing (generated worlds)."""
ANYWHERE = 0.05
"""P(the frame lies where some answer has it) while nothing is known, and such an answer's share in what another, that
does not list it, leaves to all that it does not list."""
WRONG = 0.02
"""P(an answer says nothing), whatever it says."""
LEAST = 1e-3
"""Where a kept answer has the robot less likely than this, it might as well be elsewhere."""


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

    @property
    def left(self) -> float:
        """P(the robot was at none of these places)."""
        return max(0.0, 1.0 - float(self.chance.sum()))


class FrameFilter:
    """What earlier answers say of one more. It goes on through full updates, gaps and lost graphs that come back."""

    def __init__(self) -> None:
        self._kept: list[_Answer] = []
        self._spots: list[Floats] = []

    def forget(self) -> None:
        """Know nothing."""
        self._kept, self._spots = [], []

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
        past = [kept for kept in self._kept if float(np.linalg.norm(kept.at - at)) >= APART_M]
        past.sort(key=lambda kept: kept.walked)
        self._keep(now)
        return _weighed(now, past, drift) if past else np.ones(len(now.chance))

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


def _weighed(now: _Answer, past: Sequence[_Answer], drift: float | None) -> Floats:
    """(A,) by how much the past, oldest first, makes each of the present answers likelier."""
    entries = [now, *reversed(past)]
    of = np.repeat(np.arange(len(entries)), [len(entry.chance) for entry in entries])
    again, chance = _found_again(entries, of, drift), np.concatenate([entry.chance for entry in entries])
    # Frames, each once: as the present has them, then those of others that no newer answer has.
    frames = np.flatnonzero(of == 0)
    for number in range(1, len(entries)):
        own = np.flatnonzero((of == number) & (chance > LEAST))
        frames = np.append(frames, own[~again[own][:, frames].any(axis=1)])
    belief, elsewhere = _anew(np.zeros(len(frames)), 0.0, 0.0)
    for number in range(len(past), 0, -1):
        # P(answer | frame) over that if nothing were known, which by Bayes' rule is P(frame | answer) over P(frame).
        said = np.where(again[frames] & (of == number), chance, 0.0).max(axis=1, initial=0.0)
        mine = of[frames] == number
        said[mine] = chance[frames[mine]]
        left = entries[number].left
        said = np.where(said > 0, said / ANYWHERE, left)
        belief = belief * (said + WRONG * (1.0 - said))
        elsewhere = elsewhere * (left + WRONG * (1.0 - left))
        belief, elsewhere = _anew(belief, elsewhere, WENT_ON)
    listed = belief[: len(now.chance)] / ANYWHERE
    total = float((listed * now.chance).sum()) + now.left * (float(belief[len(listed) :].sum()) + elsewhere)
    found: Floats = listed / max(total, 1e-12)
    return found


def _anew(belief: Floats, elsewhere: float, went_on: float) -> tuple[Floats, float]:
    """Belief in F frames and in all others, which need not sum to 1, once the frame may be a new one."""
    total, n = float(belief.sum()) + elsewhere, len(belief)
    some, other = n * ANYWHERE, max(1.0 - n * ANYWHERE, ANYWHERE)
    new, kept = (1.0 - went_on) / (some + other), went_on / total if total > 0 else 0.0
    return kept * belief + new * ANYWHERE, kept * elsewhere + new * other


def _found_again(entries: Sequence[_Answer], of: NDArray[np.int64], drift: float | None) -> NDArray[np.bool_]:
    """(N, N) whether one answer has the robot, at the time of another, where that one has it; ``of`` are whose."""
    heading, pose = (np.concatenate([getattr(entry, name) for entry in entries]) for name in ("heading", "pose"))
    building = np.concatenate([entry.building for entry in entries])
    at, walked = np.stack([entry.at for entry in entries])[of], np.array([entry.walked for entry in entries])[of]
    x, y, z = np.moveaxis(at - at[:, None], 2, 0)
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    off = np.stack([c * x - s * y, s * x + c * y, z], axis=2) + pose[:, None] - pose
    way = np.abs(walked[:, None] - walked) * (1.0 if drift is None else drift)
    wide = NEAR_M + 2.0 * np.sqrt(way * (2 * SHIFT_M**2 + TURN_RAD**2 * (x * x + y * y)))
    near: NDArray[np.bool_] = (np.linalg.norm(off, axis=2) <= wide) & (building[:, None] == building)
    return near
