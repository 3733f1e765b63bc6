"""The peer along walks: what CLIPPER, registering all that the robot has seen against every home, makes of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from time import process_time

import numpy as np

from semloc_core import metrics
from semloc_core.evaluate.online.answers import Bools, OnlineWalk, by_chance, steps_at, verdict
from semloc_core.evaluate.online.clipper import ClipperConfig, Register, register_clipper
from semloc_core.evaluate.online.verified import PEER, groups_of, success_rows
from semloc_core.evaluate.relocalise import Arena
from semloc_core.evaluate.verified_answers import any_frame, true_yaw, written_in
from semloc_core.graph import Floats, GraphArrays
from semloc_core.metrics import Progress, Row, no_progress


def judge_clipper(
    arena: Arena,
    paths: Sequence[OnlineWalk],
    scopes_m: Sequence[float],
    radius_m: float,
    seed: int,
    config: ClipperConfig | None = None,
    progress: Progress = no_progress,
    *,
    method: str = PEER,
    by: Register = register_clipper,
    verdicts: dict[str, Bools] | None = None,
) -> list[Row]:
    """A row a scope of the peer's answers, in the same frames as `judge_online_layout` turns the robots' into.

    A home's answer is its place next to the pose found there; homes are listed by the score of the registration. Of
    right answers the rows hold the pose's error: ``position_error_m`` and ``heading_error_deg``, medians, and the same
    ``_p90``; ``cpu_ms`` is the process's own time an answer, its median.

    Args:
        arena: the homes.
        paths: W walks.
        scopes_m: K distances.
        radius_m: how near is right.
        seed: of the robots' frames, and of the bootstrap.
        config: of the registration.
        progress: told of every walk.
        method: what to call it.
        by: registers, `register_clipper` or `original_clipper`.
        verdicts: where to put, by method, whether the best answer is right, (W, K).

    """
    right = np.zeros((len(paths), len(scopes_m), max(metrics.RANKS)), np.bool_)
    chance = np.zeros(right.shape[:2])
    error = np.full((len(paths), len(scopes_m), 2), np.nan)
    seconds = np.zeros(right.shape[:2])
    for i, path in enumerate(paths):
        progress(i, len(paths), method)
        at = steps_at(path.walk, scopes_m)
        frame = any_frame(np.random.default_rng([seed, i]))
        best = np.full(right.shape[1:], -1, dtype=np.int64)
        for k, step in enumerate(at.tolist()):
            part, place = path.walk.part(step)
            begun = process_time()
            found = _answers(arena, written_in(frame, part), place, config or ClipperConfig(), by)[: best.shape[1]]
            seconds[i, k] = process_time() - begun
            best[k, : len(found)] = [row for _, row, _, _ in found]
            if found:
                _, _, where, yaw = found[0]
                off = math.remainder(yaw - true_yaw(frame, path.walk, step), 2 * math.pi)
                error[i, k] = np.linalg.norm(where - path.walk.truth()[step]), math.degrees(abs(off))
        right[i] = verdict(arena, path, at, best, radius_m)
        chance[i] = by_chance(arena, path, at, radius_m)
    keys: Row = {"method": method, "filter": "none", "home": "any"}
    rows = success_rows(keys, right, chance, groups_of(paths), scopes_m, seed)
    if verdicts is not None:
        verdicts[method] = right[:, :, 0]
    for k, row in enumerate(rows):
        row["cpu_ms"] = 1e3 * float(np.median(seconds[:, k]))
        for name, values in zip(("position_error_m", "heading_error_deg"), error[right[:, k, 0], k].T, strict=True):
            if len(values):
                row |= {name: float(np.median(values)), f"{name}_p90": float(np.quantile(values, 0.9))}
    return rows


def _answers(
    arena: Arena, part: GraphArrays, place: int, config: ClipperConfig, by: Register
) -> list[tuple[float, int, Floats, float]]:
    """Score, row of the database, position, yaw: one a home that anything could be registered against, best first."""
    found: list[tuple[float, int, Floats, float]] = []
    known, first = part.object_classes >= 0, 0
    seen, classes = part.object_positions[known], part.object_classes[known]
    for home in arena.maps:
        mapped = home.object_classes >= 0
        fit = by(seen, classes, home.object_positions[mapped], home.object_classes[mapped], config)
        if fit is not None:
            where = fit.transform.apply(part.place_positions[place : place + 1])[0]
            row = first + int(np.linalg.norm(home.place_positions - where, axis=1).argmin())
            found.append((fit.score, row, where, fit.transform.yaw))
        first += home.n_places
    return sorted(found, key=lambda answer: (-round(answer[0], 6), answer[1]))
