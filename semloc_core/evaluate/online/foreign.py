"""What an encoder's similarity makes of a robot in a building that no map has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semloc_core import metrics
from semloc_core.encoding import Model, embed_graph, similarity_matrix
from semloc_core.evaluate.online.answers import OnlineWalk, steps_at, verdict
from semloc_core.evaluate.online.fragments import answered, embed_walk
from semloc_core.evaluate.relocalise import Arena
from semloc_core.metrics import Row, accepted_share


def judge_foreign(
    method: str,
    model: Model,
    arena: Arena,
    paths: Sequence[OnlineWalk],
    scopes_m: Sequence[float],
    radius_m: float,
) -> list[Row]:
    """Answers accepted with the robot's building left out of the database, by metres walked.

    An answer is accepted from that similarity of the best match on which keeps 90 % of the right answers of the same
    distance, buildings all in the database. ``foreign_accepted`` is the share of foreign queries accepted,
    ``wrong_accepted`` that of the wrong answers at home.
    """
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    shape = (len(paths), len(scopes_m))
    home, abroad, right = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.bool_)
    for i, path in enumerate(paths):
        at = steps_at(path.walk, scopes_m)
        asked = answered(path.walk.at(at))
        similarity = similarity_matrix(embed_walk(model, path.walk.at(at)), database)
        away = np.where(arena.building != path.building, similarity, np.float32(-2))
        best = metrics.top(similarity, max(metrics.RANKS))
        right[i] = verdict(arena, path, at, best, radius_m)[:, 0]
        home[i] = np.where(asked, similarity.max(axis=1), -np.inf)
        abroad[i] = np.where(asked, away.max(axis=1), -np.inf)
    return [
        {
            "method": method,
            "filter": "none",
            "home": "any",
            "scope": f"foreign {metres:g}m",
            "queries": len(paths),
            **accepted_share(home[:, k], abroad[:, k], right[:, k]),
        }
        for k, metres in enumerate(scopes_m)
    ]
