"""When to trust an answer: each one along walks, what it said of itself, and what misled it where it is wrong.

The walks and answers are those of `semloc_core.evaluate.online.protocol` (rings, verified by layout), one by one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M, LocaliserConfig
from semloc_core.encoding import Model, embed_graph, similarity_matrix
from semloc_core.evaluate.online.answers import OnlineWalk, make_walks, steps_at
from semloc_core.evaluate.online.fragments import answered, embed_walk, stars_along
from semloc_core.evaluate.relocalise import Arena, fitted, make_arena, read_buildings
from semloc_core.evaluate.verified_answers import any_frame, fragments_along, layout_verifier
from semloc_core.explain import SimilarityQuery, explain
from semloc_core.graph import Floats, Ints, union
from semloc_core.matching import Fragment, LayoutVerifier, Placed, Verified, confidence, placed, status_of
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import WalkConfig
from semloc_core.text import short_repr

SCOPES_M = (0.0, 2.5, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 40.0)
LISTED = 10
"""Places that an answer lists."""
STRANGER_M = 2.0
"""A seen object is on the map where that has one of its class so near to it."""
NAMED = 3
"""Classes that are named as what speaks for either place."""


@short_repr
@dataclass(frozen=True, eq=False)
class Judged:
    """One answer.

    Args:
        building: where the robot is.
        walk: number of its walk.
        scope_m: metres walked, at least.
        place: the robot's place.
        truth: (3,) where that is in the building's map, metres.
        fragment: what was around the robot, n objects, in a frame of its own.
        found: the test of the likeliest places; None where nothing fitted anywhere.
        rows: (N,) the places listed, best first.
        said: (N,) the probability of each.
        chance: the share of the map's places that are right.
        rights: (N,) which of them are within the match radius of the robot and on its storey.
        right: so is the first one.
        wrong_storey: the first one is within the match radius of the robot or above or below it, on another storey.
        alone_right: so is the encoder's own best one.
        probability: said of it.
        status: as a localiser with the default options says it.
        abroad: the same two with the robot's building left out of the map.
        step: of its walk.
        placing: where the robot's frame lies by the best place; None where nothing was tested.
        yaw: how that frame truly is turned against the building's, radians.

    """

    building: int
    walk: int
    scope_m: float
    place: str
    truth: Floats
    fragment: Fragment
    found: Verified | None
    rows: Ints
    said: Floats
    chance: float
    rights: NDArray[np.bool_]
    right: bool
    wrong_storey: bool
    alone_right: bool
    probability: float
    status: str
    abroad: tuple[float, str]
    step: int
    placing: Placed | None = None
    yaw: float = 0.0


@short_repr
@dataclass(frozen=True, eq=False)
class Study:
    """All answers, and what they were given from."""

    arena: Arena
    model: Model
    verifier: LayoutVerifier
    walks: Sequence[OnlineWalk]
    answers: Sequence[Judged]
    radius_m: float


def study_trust(
    root: Path,
    *,
    config: WalkConfig | None = None,
    walks: int = 10,
    scopes_m: Sequence[float] = SCOPES_M,
    radius_m: float = MATCH_RADIUS_M,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Study:
    """Answer along walks; the arguments are those of `semloc_core.evaluate.online.protocol.evaluate_online`.

    Raises:
        FileFormatError: no building in the folder, or a file that can't be read.
        GraphError: a building without places to walk between.

    """
    buildings = read_buildings(root)
    labelspace = union([file.labelspace for building in buildings for file in (building.map, building.query)])
    arena = make_arena(buildings, labelspace)
    model, verifier = fitted("rings", arena), layout_verifier(arena.maps, len(labelspace))
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    config = msgspec.structs.replace(config or WalkConfig(), distance_m=max(*scopes_m, 1e-9))
    paths = make_walks(arena, config, walks, seed)
    answers = []
    every = np.arange(len(arena.positions))[None]
    for number, path in enumerate(paths):
        progress(number, len(paths), arena.maps[path.building].name)
        at = steps_at(path.walk, scopes_m)
        asked = path.walk.at(at)
        similarity = similarity_matrix(embed_walk(model, asked), database)
        similar = metrics.top(similarity, 2 * LISTED)
        alone, known = similarity.argmax(axis=1), answered(asked)
        fragments = fragments_along(path.walk, at, verifier, np.random.default_rng([seed, number]))
        turned = any_frame(np.random.default_rng([seed, number])).yaw
        for k, fragment in enumerate(fragments):
            truth = asked.truth()[k]
            near = arena.right(every, path.building, truth[None], radius_m)[0]
            found = verifier.verify(fragment, similarity[k]) if known[k] else None
            probability, status = _said(verifier, fragment, found)
            rows, said = listed(verifier, fragment, found, similar[k])
            same = arena.storey[rows[0]] == arena.truth_storeys(path.building, truth[None])[0]
            flat = np.linalg.norm(arena.positions[rows[0], :2] - truth[:2])
            beside = flat <= radius_m and arena.building[rows[0]] == path.building
            elsewhere = arena.building != path.building
            only = np.where(elsewhere, similarity[k], np.float32(-2))
            abroad = verifier.verify(fragment, only, elsewhere) if known[k] else None
            answers.append(
                Judged(
                    building=path.building,
                    walk=number,
                    scope_m=scopes_m[k],
                    place=path.walk.graph.place_ids[int(asked.places[k])],
                    truth=truth,
                    fragment=fragment,
                    found=found,
                    rows=rows,
                    said=said,
                    chance=float(near.mean() * known[k]),
                    rights=near[rows] & known[k],
                    right=bool(known[k] and near[rows[0]]),
                    wrong_storey=bool(known[k] and beside and not same),
                    alone_right=bool(known[k] and near[alone[k]]),
                    probability=probability,
                    status=status,
                    abroad=_said(verifier, fragment, abroad),
                    step=int(at[k]),
                    placing=_placing(verifier, fragment, found),
                    yaw=-(turned + path.walk.frame(int(at[k])).yaw),
                )
            )
    progress(len(paths), len(paths), "done")
    return Study(arena, model, verifier, paths, answers, radius_m)


def _placing(verifier: LayoutVerifier, fragment: Fragment, found: Verified | None) -> Placed | None:
    if found is None:
        return None
    best = int(found.rows[0])
    return placed(verifier.mapped, fragment, found, [best]).get(best)


def _said(verifier: LayoutVerifier, fragment: Fragment, found: Verified | None) -> tuple[float, str]:
    """Probability of the best place, and status."""
    if found is None:
        return 0.0, "unknown"
    sure = confidence(found, fragment, verifier.mapped)
    probability = float(sure.probability.max())
    return probability, status_of(probability, LocaliserConfig().accept_probability, sure.in_map)


def failures(study: Study, least_m: float = 5.0, most_m: float = 10.0) -> list[Row]:
    """A row for each wrong answer between two distances, by walk and distance.

    ``objects`` are seen, ``strangers`` those of them that the map does not have there (invented, mislabelled or
    displaced by more than `STRANGER_M`); ``fit`` is the score of the answer, ``fit_there`` the best one within the
    match radius of the robot where the search is held to it (None: nothing there fits), ``tried`` whether any place
    there was put to the test at all. What speaks for the answer against that one, in nats (exact: the score is a sum):
    ``classes``, three to either side, ``missing`` (mapped objects not seen) and ``walls``. ``similarity``: the same
    of the embedding's similarity, by exact Shapley values by class.
    """
    return [
        _failure(study, judged) for judged in study.answers if not judged.right and least_m <= judged.scope_m <= most_m
    ]


def strangers(study: Study, judged: Judged) -> list[str]:
    """Classes of the seen objects that the map does not have where they are."""
    graph, mapped = study.walks[judged.walk].walk.graph, study.arena.maps[judged.building]
    index = {id_: i for i, id_ in enumerate(graph.object_ids)}
    found = []
    for id_, class_ in zip(judged.fragment.object_ids, judged.fragment.classes.tolist(), strict=True):
        like = mapped.object_positions[mapped.object_classes == class_]
        if not (np.linalg.norm(like - graph.object_positions[index[id_]], axis=1) <= STRANGER_M).any():
            found.append(study.arena.labelspace.classes[class_])
    return found


def listed(verifier: LayoutVerifier, fragment: Fragment, found: Verified | None, similar: Ints) -> tuple[Ints, Floats]:
    """(N,) rows that an answer lists, best first, and (N,) the probability of each, as a localiser has them.

    Args:
        verifier: of the map.
        fragment: what was around the robot.
        found: the test; None where nothing fitted.
        similar: rows by falling similarity.

    """
    if found is None:
        return similar[:LISTED], np.zeros(min(len(similar), LISTED))
    sure = confidence(found, fragment, verifier.mapped)
    rows, said = sure.listed(similar[~np.isin(similar, found.rows)])
    return rows[:LISTED], said[:LISTED]


def at_truth(study: Study, judged: Judged) -> Verified | None:
    """The same test of the places within the match radius of the robot."""
    every = np.arange(len(study.arena.positions))[None]
    near = study.arena.right(every, judged.building, judged.truth[None], study.radius_m)[0]
    return study.verifier.verify(judged.fragment, None, near)


def _failure(study: Study, judged: Judged) -> Row:
    arena, found, there = study.arena, judged.found, at_truth(study, judged)
    seen = Counter(arena.labelspace.classes[c] for c in judged.fragment.classes.tolist())
    row: Row = {
        "method": "rings + layout",
        "scope": f"{judged.scope_m:g}m",
        "building": arena.maps[judged.building].name,
        "walk": judged.walk,
        "place": judged.place,
        "status": judged.status,
        "probability": round(judged.probability, 3),
        "answer": None,
        "off_m": None,
        "objects": len(judged.fragment.classes),
        "strangers": len(strangers(study, judged)),
        "seen": _listed(seen),
    }
    if found is None:
        return row
    best = int(judged.rows[0])
    if arena.building[best] == judged.building:
        row["off_m"] = round(float(np.linalg.norm(arena.positions[best] - judged.truth)), 1)
    tried = arena.right(found.rows[None], judged.building, judged.truth[None], study.radius_m)[0]
    row |= {"answer": arena.maps[arena.building[best]].name, "fit": round(float(found.score[0]), 2)}
    row["tried"] = int(tried.any())
    if there is None:
        return row | {"fit_there": None}
    names = [arena.labelspace.classes[c] for c in judged.fragment.classes.tolist()]
    speaks: Counter[str] = Counter()
    for name, more in zip(names, (found.explained[0] - there.explained[0]).tolist(), strict=True):
        speaks[name] += more
    return row | {
        "fit_there": round(float(there.score[0]), 2),
        "classes": _ends(speaks),
        "missing": round(float(there.missing[0] - found.missing[0]), 2),
        "walls": round(float(there.walls[0] - found.walls[0]), 2),
        "similarity": _ends(_similarity(study, judged, best) - _similarity(study, judged, int(there.rows[0]))),
    }


class _Signed(Counter[str]):
    """Class by class; a difference keeps what is negative."""

    def __sub__(self, other: Counter[str]) -> _Signed:
        return _Signed({name: self[name] - other[name] for name in self.keys() | other.keys()})


def _similarity(study: Study, judged: Judged, row: int) -> _Signed:
    """Exact Shapley values by class of the similarity to a place of the database."""
    import torch

    space = study.arena.labelspace
    graph = study.arena.maps[int(study.arena.building[row])]
    first = int(np.flatnonzero(study.arena.building == study.arena.building[row])[0])
    target = torch.from_numpy(embed_graph(study.model, graph)[row - first])
    extraction = study.model.encoder.extraction
    one = study.walks[judged.walk].walk.at(np.array([judged.step]))
    batch = stars_along(one, study.model.encoder.n_classes, extraction.radius_m, extraction.bands)
    classes = [space.classes[i] for i in batch.features.argmax(dim=1).tolist()]
    query = SimilarityQuery.from_encoder(study.model.encoder, batch, target, classes)
    scores = explain(query, "class_shapley", np.random.default_rng(0))
    found = _Signed()
    for name, score in zip(scores.classes, scores.scores.tolist(), strict=True):
        found[name] += score
    return found


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{n} {name}" for name, n in sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def _ends(values: Counter[str]) -> str:
    """The largest and the smallest values, named."""
    ordered = sorted(values.items(), key=lambda item: (-item[1], item[0]))
    kept = [o for i, o in enumerate(ordered) if i < NAMED or i >= len(ordered) - NAMED]
    return ", ".join(f"{name} {value:+.2f}" for name, value in kept if abs(value) >= 0.01)
