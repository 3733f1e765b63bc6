"""What `semloc_core.evaluate.trust` found, as rows and as points of its pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.evaluate.trust import Judged, Study, strangers
from semloc_core.evaluate.verified_answers import add_error
from semloc_core.graph import Floats
from semloc_core.metrics import BINS, PoseErrors, Row, expected_calibration_error
from semloc_core.text import short_repr

STATUSES = ("match", "ambiguous", "unknown")
THRESHOLDS = (0.5, 0.8, 0.9)
OBJECTS = (0, 1, 4, 7, 10, 15)
SHARES = (0.0, 0.2, 0.4, 0.6)
RANKED = {"rank_1": slice(0, 1), "ranks_2_to_10": slice(1, 10)}
"""Places listed whose probabilities are judged apart."""
LEAST = 5
"""A tenth of the probabilities with fewer answers has no point in the diagram: its share would be noise."""


def status_rows(study: Study) -> list[Row]:
    """By metres walked: how many answers are right, what each status's share of the answers is, and how often right.

    The errors of the pose (`PoseErrors.figures`) are those of right answers. ``chance``: how many blind guesses would
    be right. Rows of scope ``foreign …``: the same shares with the robot's building left out of the map.
    """
    rows: list[Row] = []
    for scope in _scopes(study):
        answers = [judged for judged in study.answers if judged.scope_m == scope]
        row: Row = {
            "method": "rings + layout",
            "scope": f"{scope:g}m",
            "queries": len(answers),
            "chance": float(np.mean([judged.chance for judged in answers])),
            "right": float(np.mean([judged.right for judged in answers])),
        }
        for status in STATUSES:
            right = [judged.right for judged in answers if judged.status == status]
            row |= {status: len(right) / len(answers), f"{status}_right": float(np.mean(right)) if right else None}
        matches = [judged for judged in answers if judged.status == "match"]
        row["wrong_storey"] = sum(judged.wrong_storey for judged in matches)
        row |= {
            f"ece_{name}": expected_calibration_error(*said_and_so(answers, ranks)) for name, ranks in RANKED.items()
        }
        errors = PoseErrors()
        for judged in answers:
            if judged.right:
                add_error(errors, judged.placing, judged.fragment, judged.truth, judged.yaw)
        row |= errors.figures()
        rows.append(row)
    if len(study.arena.maps) < 2:
        return rows
    for scope in _scopes(study):
        said = [judged.abroad[1] for judged in study.answers if judged.scope_m == scope]
        shares = {status: said.count(status) / len(said) for status in STATUSES}
        rows.append({"method": "rings + layout", "scope": f"foreign {scope:g}m", "queries": len(said), **shares})
    return rows


def said_and_so(answers: Sequence[Judged], ranks: slice) -> tuple[Floats, NDArray[np.bool_]]:
    """The probabilities of the places listed at some ranks, and which of these places are right."""
    none = np.zeros(0)
    said = np.concatenate([none, *(judged.said[ranks] for judged in answers)])
    right = np.concatenate([none.astype(np.bool_), *(judged.rights[ranks] for judged in answers)])
    return said, right


def calibration_rows(study: Study) -> list[Row]:
    """What was said and what was so, by tenth of the probability: of the first place listed, and of those after it.

    ``ece`` in the rows of scope ``all`` is the expected calibration error over all distances.
    """
    rows: list[Row] = []
    for name, ranks in RANKED.items():
        said, right = said_and_so(study.answers, ranks)
        ece = expected_calibration_error(said, right)
        rows.append({"method": name, "scope": "all", "places": len(said), "ece": ece})
        of = np.minimum((said * BINS).astype(np.int64), BINS - 1)
        for b in np.unique(of).tolist():
            mine = of == b
            scope = f"{b / BINS:g} to {(b + 1) / BINS:g}"
            figures = {"said": float(said[mine].mean()), "so": float(right[mine].mean())}
            rows.append({"method": name, "scope": scope, "places": int(mine.sum()), **figures})
    return rows


def threshold_rows(study: Study) -> list[Row]:
    """What other thresholds on the probability accept: a share of the answers, right ones among it, and abroad."""
    rows: list[Row] = []
    for threshold in THRESHOLDS:
        for scope in _scopes(study):
            answers = [judged for judged in study.answers if judged.scope_m == scope]
            right = [judged.right for judged in answers if judged.probability >= threshold]
            rows.append(
                {
                    "method": f"p >= {threshold:g}",
                    "scope": f"{scope:g}m",
                    "accepted": len(right) / len(answers),
                    "accepted_right": float(np.mean(right)) if right else None,
                    "accepted_wrong": len(right) - sum(right),
                    "foreign_accepted": float(np.mean([judged.abroad[0] >= threshold for judged in answers])),
                }
            )
    return rows


def condition_rows(study: Study, least_m: float = 5.0, most_m: float = 10.0) -> list[Row]:
    """How right answers between two distances are by objects seen, by share of strangers among them, by building."""
    answers = [judged for judged in study.answers if least_m <= judged.scope_m <= most_m]
    groups: dict[str, list[Judged]] = {}
    for judged in answers:
        n = len(judged.fragment.classes)
        share = len(strangers(study, judged)) / max(n, 1)
        for kind, value, steps in (("objects", n, OBJECTS), ("strangers", share, SHARES)):
            low = max(step for step in steps if step <= value)
            groups.setdefault(f"{kind} from {low:g}", []).append(judged)
        groups.setdefault(study.arena.maps[judged.building].name, []).append(judged)
    return [
        {
            "method": "rings + layout",
            "scope": name,
            "queries": len(group),
            "chance": float(np.mean([judged.chance for judged in group])),
            "right": float(np.mean([judged.right for judged in group])),
            "match": float(np.mean([judged.status == "match" for judged in group])),
            "match_wrong": sum(judged.status == "match" and not judged.right for judged in group),
        }
        for name, group in sorted(groups.items(), key=lambda item: (item[0].split()[0], len(item[0]), item[0]))
    ]


def success_points(study: Study, seed: int = 0) -> tuple[list[float], dict[str, list[tuple[float, float, float]]]]:
    """Metres walked, and name -> (mean, low, high) at each, with 95 % bootstrap intervals over buildings."""
    kinds: dict[str, Callable[[Judged], bool]] = {
        "right": lambda judged: judged.right,
        "right, by similarity alone": lambda judged: judged.alone_right,
        "says match": lambda judged: judged.status == "match",
        "says match and is wrong": lambda judged: judged.status == "match" and not judged.right,
    }
    curves: dict[str, list[tuple[float, float, float]]] = {}
    for name, is_so in kinds.items():
        rng = np.random.default_rng(seed)
        curves[name] = []
        for scope in _scopes(study):
            answers = [judged for judged in study.answers if judged.scope_m == scope]
            so = np.array([is_so(judged) for judged in answers])
            groups = np.array([judged.building for judged in answers])
            low, high = metrics.bootstrap_interval(so, rng, groups=groups)
            curves[name].append((float(so.mean()), low, high))
    return _scopes(study), curves


def reliability_points(answers: Sequence[Judged], seed: int = 0) -> list[tuple[float, float, float, float, float]]:
    """(said, so, low, high, share of all) for each tenth of the probability with `LEAST` answers; 95 % by bootstrap."""
    said = np.array([judged.probability for judged in answers])
    right = np.array([judged.right for judged in answers])
    groups = np.array([judged.building for judged in answers])
    rng = np.random.default_rng(seed)
    of = np.minimum((said * BINS).astype(np.int64), BINS - 1)
    points = []
    for b in range(BINS):
        mine: NDArray[np.bool_] = of == b
        if mine.sum() >= LEAST:
            low, high = metrics.bootstrap_interval(right[mine], rng, groups=groups[mine])
            points.append((float(said[mine].mean()), float(right[mine].mean()), low, high, float(mine.mean())))
    return points


@short_repr
@dataclass(frozen=True, eq=False)
class Laid:
    """A wrong answer, ready to be drawn; all in metres, each in its building's frame.

    Args:
        judged: the answer.
        there: index of the building that it names.
        path: (T, 2) the way walked.
        answer: (2,) where it puts the robot.
        seen_here: class -> (n, 2) seen objects where the robot is.
        seen_there: the same, laid where the answer has them.

    """

    judged: Judged
    there: int
    path: Floats
    answer: Floats
    seen_here: dict[str, Floats]
    seen_there: dict[str, Floats]


def worst(study: Study, least_m: float = 5.0, most_m: float = 10.0) -> Laid | None:
    """The wrong answer between two distances that was surest of itself; None where all are right."""
    wrong = [
        judged
        for judged in study.answers
        if not judged.right and judged.found is not None and least_m <= judged.scope_m <= most_m
    ]
    if not wrong:
        return None
    judged = max(wrong, key=lambda judged: (judged.probability, -judged.walk, -judged.scope_m))
    found = judged.found
    assert found is not None
    way, row = study.walks[judged.walk].walk, int(found.rows[0])
    index = {id_: i for i, id_ in enumerate(way.graph.object_ids)}
    here = way.graph.object_positions[[index[id_] for id_ in judged.fragment.object_ids]][:, :2]
    c, s = np.cos(found.heading[0]), np.sin(found.heading[0])
    answer = study.arena.positions[row, :2] + found.shift[0]
    there = judged.fragment.objects[:, :2] @ np.array([[c, s], [-s, c]]) + answer
    names = np.array([study.arena.labelspace.classes[i] for i in judged.fragment.classes.tolist()])
    return Laid(
        judged=judged,
        there=int(study.arena.building[row]),
        path=way.truth()[: judged.step + 1, :2],
        answer=answer,
        seen_here={name: here[names == name] for name in sorted(set(names.tolist()))},
        seen_there={name: there[names == name] for name in sorted(set(names.tolist()))},
    )


def _scopes(study: Study) -> list[float]:
    return sorted({judged.scope_m for judged in study.answers})
