"""Answers along walks, verified by layout: how right they are, how honest, and what they make of a foreign building."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semloc_core import metrics
from semloc_core.config import LocaliserConfig
from semloc_core.encoding import Model, embed_graph, similarity_matrix
from semloc_core.evaluate.online.answers import Bools, OnlineWalk, by_chance, steps_at, verdict
from semloc_core.evaluate.online.fragments import answered, embed_walk
from semloc_core.evaluate.relocalise import Arena
from semloc_core.evaluate.verified_answers import (
    Past,
    add_error,
    any_frame,
    fragments_along,
    reranked,
    true_yaw,
)
from semloc_core.graph import Floats, Ints
from semloc_core.matching import LayoutVerifier, Placed
from semloc_core.metrics import PoseErrors, Row, accepted_share, expected_calibration_error
from semloc_core.tracking import FrameFilter


def judge_online_layout(
    method: str,
    model: Model,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    scopes_m: Sequence[float],
    radius_m: float,
    seed: int,
    verifier: LayoutVerifier,
    *,
    filtered: bool = False,
    foreign: bool = False,
) -> list[Row]:
    """Rows of one encoder whose answers are verified, under the name ``METHOD + layout``.

    Each robot's frame is turned against the map's by an angle of its own. Rows hold ``ece`` too, the expected
    calibration error of the probability of the best match at that distance, those of ``filter`` ``none`` the pose's
    errors (`PoseErrors.figures`) where that match is right; those of scope ``foreign …`` say what is accepted as in
    `semloc_core.evaluate.online.foreign.judge_foreign`, by that probability.

    Args:
        method: the encoder's name.
        model: the encoder.
        arena: the buildings.
        paths: W walks.
        scopes_m: K distances.
        radius_m: how near is right.
        seed: of the robots' frames, and of the bootstrap.
        verifier: of the arena's maps.
        filtered: for rows with the filter too.
        foreign: ask also with the robot's building left out of the database.

    """
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    names = tuple(str(building) for building in range(len(arena.maps)))
    shape = (len(paths), len(scopes_m), max(metrics.RANKS))
    kinds = [("none", "any"), ("none", "known"), *([("bayes", "any")] if filtered else [])]
    right = {kind: np.zeros(shape, np.bool_) for kind in kinds}
    chance = {home: np.zeros(shape[:2]) for home in ("any", "known")}
    sure = {kind[0]: np.zeros(shape[:2]) for kind in kinds}
    abroad = {name: np.full(shape[:2], -np.inf) for name in sure}
    errors = [PoseErrors() for _ in scopes_m]
    for i, path in enumerate(paths):
        at = steps_at(path.walk, scopes_m)
        asked = answered(path.walk.at(at))
        for home, by in chance.items():
            by[i] = by_chance(arena, path, at, radius_m, known=home == "known")
        steps = np.arange(at.max() + 1) if filtered else at
        similarity = similarity_matrix(embed_walk(model, path.walk.at(steps)), database)
        fragments = fragments_along(path.walk, steps, verifier, np.random.default_rng([seed, i]))
        rows = np.searchsorted(steps, at)
        chosen = [fragments[row] for row in rows.tolist()]
        at_home = arena.building == path.building
        places_found: list[Placed | None] = []
        best = reranked(verifier, chosen, similarity[rows], chances=sure["none"][i], places=places_found)
        right["none", "any"][i] = verdict(arena, path, at, best, radius_m)
        frame = any_frame(np.random.default_rng([seed, i]))
        for k in np.flatnonzero(right["none", "any"][i][:, 0]).tolist():
            step = int(at[k])
            yaw = true_yaw(frame, path.walk, step)
            add_error(errors[k], places_found[k], chosen[k], path.walk.truth()[step], yaw)
        best = reranked(verifier, chosen, similarity[rows], at_home)
        right["none", "known"][i] = verdict(arena, path, at, best, radius_m)
        if foreign:
            reranked(verifier, chosen, similarity[rows], ~at_home, chances=abroad["none"][i])
        for only in ([None, ~at_home] if foreign else [None]) if filtered else []:
            past, chances = Past(FrameFilter(), names, path.walk.metres[steps]), np.zeros(len(steps))
            best = reranked(verifier, fragments, similarity, only, chances=chances, past=past)[rows]
            if only is None:
                right["bayes", "any"][i], sure["bayes"][i] = verdict(arena, path, at, best, radius_m), chances[rows]
            else:
                abroad["bayes"][i] = chances[rows]
        for name in sure:
            sure[name][i][~asked], abroad[name][i][~asked] = 0.0, -np.inf
    name = f"{method} + layout"
    found: list[Row] = []
    for (filter_, home), verdicts in right.items():
        keys: Row = {"method": name, "filter": filter_, "home": home}
        for k, row in enumerate(success_rows(keys, verdicts, chance[home], groups_of(paths), scopes_m, seed)):
            if home == "any":
                row["ece"] = expected_calibration_error(sure[filter_][:, k], verdicts[:, k, 0])
            if (filter_, home) == ("none", "any"):
                row |= errors[k].figures()
            found.append(row)
    for filter_, its in sure.items() if foreign else ():
        for k, metres in enumerate(scopes_m):
            accepted = accepted_share(its[:, k], abroad[filter_][:, k], right[filter_, "any"][:, k, 0])
            keys = {"method": name, "filter": filter_, "home": "any", "scope": f"foreign {metres:g}m"}
            found.append({**keys, "queries": len(paths), **accepted})
    return found


def judge_kidnapped(
    method: str,
    model: Model,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    radius_m: float,
    verifier: LayoutVerifier,
) -> list[Row]:
    """Metres from where a robot is set down, after a walk elsewhere, to its first right answer that is accepted.

    Each walk comes after another one, half of all walks further on, so mostly in another building. The robot's mapper
    begins a new graph where it is set down; its filter is not told. ``metres_until_right`` is the median of the walks
    (those that were never right count as infinite), ``metres_until_right_p90`` the 90th percentile; ``recovered`` the
    share that were right at all before their end.

    """
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    names = tuple(str(building) for building in range(len(arena.maps)))
    metres: dict[str, list[float]] = {"none": [], "bayes": []}
    for i, path in enumerate(paths):
        past = FrameFilter()
        before = paths[(i + len(paths) // 2) % len(paths)]
        for name, found in metres.items():
            walked = 0.0
            for walk in (before.walk, path.walk) if name == "bayes" else (path.walk,):
                every = np.arange(walk.steps)
                fragments = fragments_along(walk, every, verifier, np.random.default_rng([i, walk is path.walk]))
                similarity = similarity_matrix(embed_walk(model, walk), database)
                its = Past(past, names, walked + walk.metres) if name == "bayes" else None
                chances = np.zeros(walk.steps)
                best = reranked(verifier, fragments, similarity, chances=chances, past=its)
                walked += float(walk.metres[-1])
            right = verdict(arena, path, every, best, radius_m)[:, 0] & (
                chances >= LocaliserConfig().accept_probability
            )
            found.append(float(path.walk.metres[right.argmax()]) if right.any() else float("inf"))
    return [
        {
            "method": f"{method} + layout",
            "filter": name,
            "home": "any",
            "scope": "kidnapped",
            "queries": len(paths),
            "metres_until_right": float(np.quantile(found, 0.5, method="lower")),
            "metres_until_right_p90": float(np.quantile(found, 0.9, method="lower")),
            "recovered": float(np.isfinite(found).mean()),
        }
        for name, found in metres.items()
    ]


def success_rows(
    keys: Row, right: Bools, chance: Floats, groups: Ints | None, scopes_m: Sequence[float], seed: int
) -> list[Row]:
    """A row a scope of verdicts (W, K, 10), with bootstrap intervals over groups (W,) (over walks where None).

    ``chance`` (W, K), of `by_chance`, is averaged over walks.
    """
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for column, metres in enumerate(scopes_m):
        row: Row = {**keys, "scope": f"{metres:g}m", "queries": len(right), "chance": float(chance[:, column].mean())}
        for n in metrics.RANKS:
            success: Bools = right[:, column, :n].max(axis=1)
            low, high = metrics.bootstrap_interval(success, rng, groups=groups)
            row |= {f"success@{n}": float(success.mean()), f"success@{n}_low": low, f"success@{n}_high": high}
        rows.append(row)
    return rows


def groups_of(paths: Sequence[OnlineWalk]) -> Ints | None:
    """(W,) the building of each walk; None where all are in one."""
    groups = np.array([path.building for path in paths], dtype=np.int64)
    return groups if len(np.unique(groups)) > 1 else None
