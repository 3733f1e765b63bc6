"""Online: a robot has walked a few metres, its graph is a fragment: in which building, and where in it, it is.

ROOT/*/query.json is revealed along walks and asked against ROOT/*/map.json, all maps in one database. A match is
right in the same building, within 4 m and on the same storey, as in `semloc_core.evaluate.relocalise`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import GENERAL, Model, embed_graph, similarity_matrix
from semloc_core.evaluate.online.agreement import Agreement
from semloc_core.evaluate.online.another_day import AnotherDay, on_another_day
from semloc_core.evaluate.online.answers import (
    Bools,
    OnlineWalk,
    by_chance,
    make_walks,
    steps_at,
    verdict,
)
from semloc_core.evaluate.online.clipper import original_clipper, register_clipper
from semloc_core.evaluate.online.clipper_walks import judge_clipper
from semloc_core.evaluate.online.foreign import judge_foreign
from semloc_core.evaluate.online.fragments import embed_walk
from semloc_core.evaluate.online.verified import (
    PEER,
    groups_of,
    judge_kidnapped,
    judge_online_layout,
    paired_rows,
    success_rows,
)
from semloc_core.evaluate.relocalise import Arena, fitted, make_arena, read_buildings, read_distractors, relabelled
from semloc_core.evaluate.verified_answers import layout_verifier
from semloc_core.graph import Labelspace, union
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import WalkConfig

ENCODERS = ("bag_of_words", "rings", GENERAL)
SCOPES_M = (0.0, 2.5, 5.0, 10.0, 20.0, 40.0)
"""Metres walked at which an answer is judged: the first one from there on."""


def evaluate_online(
    root: Path,
    *,
    models: Sequence[Model] = (),
    encoders: Sequence[str] = ENCODERS,
    config: WalkConfig | None = None,
    walks: int = 10,
    scopes_m: Sequence[float] = SCOPES_M,
    filtered: bool = True,
    verified: bool = True,
    kidnapped: bool = False,
    foreign: bool = False,
    bound: bool = True,
    peer: bool = False,
    distractors: Sequence[Path] = (),
    another_day: AnotherDay | None = None,
    query_labels: Mapping[str, str] | None = None,
    radius_m: float = MATCH_RADIUS_M,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """success@1/5/10 by metres walked.

    Args:
        root: holds a folder a building, each with ``map.json`` and ``query.json``.
        models: trained models to judge, each in its own labelspace; ``method`` is the encoder's name and the first
            digits of the model's hash.
        encoders: encoders with nothing to train; what they count they count on the maps, which the general one is
            fitted to.
        config: how the robot walks and what it sees; ``distance_m`` is overridden by the last scope.
        walks: walks a building, on average: a building has them by its number of places, so that the robot is
            equally likely to start at any place of any building.
        scopes_m: metres walked at which answers are judged.
        filtered: judge verified answers with the filter (`semloc_core.tracking.frame_filter`) too.
        verified: judge all but bag of words with answers verified by layout too (`judge_online_layout`).
        kidnapped: judge also how soon a robot is right again that was carried away (`judge_kidnapped`).
        foreign: judge also how many answers are accepted in a building that no map has (`judge_foreign`).
        bound: judge `semloc_core.evaluate.online.agreement` too.
        peer: judge CLIPPER too (`semloc_core.evaluate.online.clipper_walks`), its authors' own where their package
            ``clipperpy`` is installed, as ``clipper, original``; rows of methods ``METHOD − PEER`` hold ``gain`` with
            its paired interval.
        distractors: folders of buildings that are in the map too (`read_distractors`).
        another_day: what has changed in the buildings that the robot walks through; None: nothing has.
        query_labels: what the queries' detector calls the maps' classes, led back by the cross-walk; None: the same.
        radius_m: how near is right.
        seed: of walks and bootstrap.
        progress: told of every method and building.

    Returns:
        For each method, for ``filter`` ``none`` (and ``bayes``, of verified answers), for ``home`` ``any`` (all
        buildings are searched) and ``known`` (only the one that the robot is in), a row a scope (``0m``, ``5m`` …):
        ``success@N`` with a 95 % bootstrap interval ``_low``, ``_high`` over buildings (over walks where there is only
        one), ``chance``, the share of the places searched that are right, averaged over walks, and ``queries``, one a
        walk.

    Raises:
        FileFormatError: no building in the folder, or a file that can't be read.
        GraphError: a building without places to walk between.

    """
    buildings = read_buildings(root)
    if query_labels is not None:
        buildings = relabelled(buildings, query_labels)
    others = read_distractors(distractors)
    files = [file for building in buildings for file in (building.map, building.query)]
    labelspace = union([file.labelspace for file in (*files, *others)])

    def arena_of(space: Labelspace) -> Arena:
        made = make_arena(buildings, space, others)
        return made if another_day is None else on_another_day(made, another_day, seed)

    arena = arena_of(labelspace)
    verdicts: dict[str, Bools] = {}
    config = msgspec.structs.replace(config or WalkConfig(), distance_m=max(*scopes_m, 1e-9))
    total = len(encoders) + len(models) + bound
    rows: list[Row] = []
    paths = make_walks(arena, config, walks, seed)

    def judge(name: str, model: Model, its: Arena, paths: Sequence[OnlineWalk]) -> None:
        rows.extend(judge_online(name, model, its, paths, scopes_m, radius_m, seed))
        if verified and name != "bag_of_words":
            verifier = layout_verifier(its.maps, len(its.labelspace))
            rows.extend(
                judge_online_layout(
                    name,
                    model,
                    its,
                    paths,
                    scopes_m,
                    radius_m,
                    seed,
                    verifier,
                    filtered=filtered,
                    foreign=foreign,
                    verdicts=verdicts if peer else None,
                )
            )
            if kidnapped:
                rows.extend(judge_kidnapped(name, model, its, paths, radius_m, verifier))
        if foreign:
            rows.extend(judge_foreign(name, model, its, paths, scopes_m, radius_m))

    for done, name in enumerate(encoders):
        progress(done, total, name)
        judge(name, fitted(name, arena), arena, paths)
    for done, model in enumerate(models, len(encoders)):
        name = f"{model.encoder.name} {model.hash[:8]}"
        progress(done, total, name)
        if model.labelspace.hash == labelspace.hash:
            judge(name, model, arena, paths)
        else:
            own = arena_of(model.labelspace)
            own_walks = make_walks(own, config, walks, seed)
            judge(name, model, own, own_walks)
    if bound:
        progress(total - 1, total, "agreement")
        agreement = Agreement(arena.maps, len(arena.labelspace))
        mapped = replace(arena, queries=arena.maps[: len(buildings)])
        for name, seen in (("agreeing places", arena), ("agreeing places, perfect detector", mapped)):
            through = make_walks(seen, config, walks, seed)
            rows += judge_agreement(name, agreement, arena, through, scopes_m, config.range_m, radius_m, seed)
    if peer:
        by = original_clipper()
        method = PEER if by is None else f"{PEER}, original"
        rows += judge_clipper(
            arena,
            paths,
            scopes_m,
            radius_m,
            seed,
            None,
            progress,
            method=method,
            by=by or register_clipper,
            verdicts=verdicts,
        )
        rows += paired_rows(verdicts, groups_of(paths), scopes_m, seed)
    progress(total, total, "done")
    return rows


def judge_online(
    method: str,
    model: Model,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    scopes_m: Sequence[float],
    radius_m: float,
    seed: int,
) -> list[Row]:
    """The rows of one encoder's similarity; see `evaluate_online`."""
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    verdicts = {h: np.zeros((len(paths), len(scopes_m), max(metrics.RANKS)), np.bool_) for h in ("any", "known")}
    chance = {home: np.zeros((len(paths), len(scopes_m))) for home in verdicts}
    for i, path in enumerate(paths):
        at = steps_at(path.walk, scopes_m)
        similarity = similarity_matrix(embed_walk(model, path.walk.at(at)), database)
        for home, right in verdicts.items():
            only = arena.building == path.building if home == "known" else np.ones(len(database), np.bool_)
            best = metrics.top(np.where(only, similarity, np.float32(-2)), max(metrics.RANKS))
            right[i] = verdict(arena, path, at, best, radius_m)
            chance[home][i] = by_chance(arena, path, at, radius_m, known=home == "known")
    rows = []
    for home, right in verdicts.items():
        keys: Row = {"method": method, "filter": "none", "home": home}
        rows += success_rows(keys, right, chance[home], groups_of(paths), scopes_m, seed)
    return rows


def judge_agreement(
    method: str,
    agreement: Agreement,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    scopes_m: Sequence[float],
    range_m: float,
    radius_m: float,
    seed: int,
) -> list[Row]:
    """How far the objects seen could lead at all: the rows of `semloc_core.evaluate.online.agreement`."""
    every = np.arange(len(arena.positions))[None]
    share = np.zeros((len(paths), len(scopes_m)))
    number = np.zeros((len(paths), len(scopes_m)))
    for i, path in enumerate(paths):
        at = steps_at(path.walk, scopes_m)
        unexplained = agreement.unexplained(path.walk, at, range_m)
        right = arena.right(every, path.building, path.walk.truth()[at], radius_m)
        best = np.where(right, unexplained, np.inf).min(axis=1)
        agree = unexplained <= best[:, None]
        number[i] = agree.sum(axis=1)
        share[i] = (agree & right).sum(axis=1) / np.maximum(number[i], 1)
    rows: list[Row] = []
    rng = np.random.default_rng(seed)
    groups = groups_of(paths)
    for column, metres in enumerate(scopes_m):
        low, high = metrics.bootstrap_interval(share[:, column], rng, groups=groups)
        rows.append(
            {
                "method": method,
                "filter": "none",
                "home": "any",
                "scope": f"{metres:g}m",
                "queries": len(paths),
                "success@1": float(share[:, column].mean()),
                "success@1_low": low,
                "success@1_high": high,
                "agreeing": float(np.median(number[:, column])),
            }
        )
    return rows
