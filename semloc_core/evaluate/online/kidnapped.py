"""What else befalls a robot: it is carried away, or it is in a building that no map has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semloc_core import metrics
from semloc_core.encoding import Model, embed_graph, similarity_matrix
from semloc_core.evaluate.online.answers import OnlineWalk, Similarities, believed, steps_at, verdict
from semloc_core.evaluate.online.fragments import answered, embed_walk, surroundings_along
from semloc_core.evaluate.relocalise import Arena
from semloc_core.metrics import Row, accepted_share
from semloc_core.tracking import FilterConfig, MapModel, PlaceFilter


def judge_kidnapped(
    method: str,
    model: Model,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    radius_m: float,
    places: MapModel | None,
) -> list[Row]:
    """Metres from where a robot is set down, after a walk elsewhere, to its first right answer.

    Each walk comes after another one, half of all walks further on, so mostly in another building. The robot's mapper
    begins a new graph where it is set down; its filter is not told. ``metres_until_right`` is the median of the walks
    (those that were never right count as infinite), ``metres_until_right_p90`` the 90th percentile; ``recovered`` the
    share that were right at all before their end.

    """
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    evidence = _Evidence(model, places, database)
    metres: dict[str, list[float]] = {"none": [], "bayes": []} if places is not None else {"none": []}
    for i, path in enumerate(paths):
        every = np.arange(path.walk.steps)
        best = {"none": metrics.top(evidence.similarity(path), max(metrics.RANKS))}
        if places is not None:
            before = paths[(i + len(paths) // 2) % len(paths)]
            robot = PlaceFilter(places)
            believed(robot, before.walk, evidence(before), every[:0])
            best["bayes"] = believed(robot, path.walk, evidence(path), every)
        for name, found in metres.items():
            right = verdict(arena, path, every, best[name], radius_m)[:, 0]
            found.append(float(path.walk.metres[right.argmax()]) if right.any() else float("inf"))
    return [
        {
            "method": method,
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


def judge_foreign(
    method: str,
    model: Model,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    scopes_m: Sequence[float],
    radius_m: float,
    places: MapModel | None,
) -> list[Row]:
    """Answers accepted with the robot's building left out of the database, by metres walked.

    An answer is accepted from that similarity of the best match (with the filter: from that probability) on which keeps
    90 % of the right answers of the same distance, buildings all in the database. ``foreign_accepted`` is the share
    of foreign queries accepted, ``wrong_accepted`` that of the wrong answers at home.
    """
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    evidence = _Evidence(model, places, database)
    filters = ("none", "bayes") if places is not None else ("none",)
    shape = (len(paths), len(scopes_m))
    sure = {(name, away): np.zeros(shape) for name in filters for away in (False, True)}
    right = {name: np.zeros(shape, dtype=np.bool_) for name in filters}
    for i, path in enumerate(paths):
        at = steps_at(path.walk, scopes_m)
        asked = answered(path.walk.at(at))
        for away in (False, True):
            only = arena.building != path.building if away else np.ones(len(database), np.bool_)
            similarity = np.where(only, evidence.similarity(path)[at], np.float32(-2))
            best = metrics.top(similarity, max(metrics.RANKS))
            sure["none", away][i] = np.where(asked, similarity.max(axis=1), -np.inf)
            if not away:
                right["none"][i] = verdict(arena, path, at, best, radius_m)[:, 0]
            if places is not None:
                chances = np.zeros(len(at))
                best = believed(PlaceFilter(places, only=only), path.walk, evidence(path), at, chances)
                sure["bayes", away][i] = np.where(asked, chances, -np.inf)
                if not away:
                    right["bayes"][i] = verdict(arena, path, at, best, radius_m)[:, 0]
    return [
        {
            "method": method,
            "filter": name,
            "home": "any",
            "scope": f"foreign {metres:g}m",
            "queries": len(paths),
            **accepted_share(sure[name, False][:, k], sure[name, True][:, k], right[name][:, k]),
        }
        for name in filters
        for k, metres in enumerate(scopes_m)
    ]


class _Evidence:
    """Similarities and the filter's evidence along walks, those of the last two kept."""

    def __init__(self, model: Model, places: MapModel | None, database: Similarities) -> None:
        self._model, self._places, self._database = model, places, database
        self._kept: dict[int, tuple[OnlineWalk, Similarities, Similarities]] = {}

    def similarity(self, path: OnlineWalk) -> Similarities:
        """(T, M) cosine similarity."""
        return self._of(path)[1]

    def __call__(self, path: OnlineWalk) -> Similarities:
        """(T, M), of `MapModel.evidence`."""
        return self._of(path)[2]

    def _of(self, path: OnlineWalk) -> tuple[OnlineWalk, Similarities, Similarities]:
        if id(path) not in self._kept:
            similarity = similarity_matrix(embed_walk(self._model, path.walk), self._database)
            evidence = similarity
            if self._places is not None:
                seen = surroundings_along(path.walk, self._model.encoder.n_classes)
                evidence = self._places.evidence(seen, similarity, FilterConfig())
            self._kept[id(path)] = (path, similarity, evidence)
            if len(self._kept) > 2:
                del self._kept[next(iter(self._kept))]
        return self._kept[id(path)]
