"""How often the robot's building is among the few that it answers from, on generated buildings and on real ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semloc_core.encoding import embed_graph, general_model
from semloc_core.errors import GraphError
from semloc_core.evaluate.online.fragments import embed_walk
from semloc_core.evaluate.town import SCOPES_M, Town
from semloc_core.fleet import MappedObjects, ObjectVotes, ShortlistConfig, nearest_first, shortlist
from semloc_core.map_database import ExactSearch
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import WalkConfig, walk

LIMITS = tuple(ShortlistConfig(buildings=buildings) for buildings in (16, 64, 128, 256, 384))


def evaluate_shortlist(
    town: Town,
    limits: Sequence[ShortlistConfig] = LIMITS,
    walks: int = 2,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """Ask along walks through second runs; each query by itself, no list before it.

    Args:
        town: the buildings, all in one map, searched exactly.
        limits: of the lists compared, each also by similarity alone, as of a map that does not say its objects.
        walks: through each building.
        seed: of the walks.
        progress: told of every building.

    Returns:
        A row for each list and metres walked (``scope``): ``listed``, the share of queries whose building is on the
        list, ``places``, the mean number on it, and ``queries``.

    """
    model, maps, rng = general_model(town.maps, town.labelspace), town.maps, np.random.default_rng(seed)
    names = [f"{number:05d}" for number in range(len(maps))]
    sizes = {name: home.n_places for name, home in zip(names, maps, strict=True)}
    first = np.cumsum([0, *sizes.values()])[:-1]
    search = ExactSearch(np.concatenate([embed_graph(model, home) for home in maps]))
    mapped = [MappedObjects.of(home.object_positions, home.object_classes) for home in maps]
    votes = ObjectVotes(mapped, len(town.labelspace))
    found: dict[tuple[int, bool, float], list[tuple[bool, int]]] = {}
    for number, graph in enumerate(town.again):
        progress(number, len(town.again), "walks")
        for _ in range(walks):
            try:
                way = walk(graph, WalkConfig(distance_m=SCOPES_M[-1] + 5.0), rng)
            except GraphError:  # without two places that are joined
                continue
            steps = np.minimum(np.searchsorted(way.metres, SCOPES_M), way.steps - 1)
            for metres, step, z in zip(SCOPES_M, steps.tolist(), embed_walk(model, way.at(steps)), strict=True):
                if not z.any():
                    continue
                part, place = way.part(step)
                seen = nearest_first(part.object_positions, part.object_classes, part.place_positions[place])
                said = dict(zip(names, votes.scores(*seen).tolist(), strict=True))
                best = np.maximum.reduceat(search.everywhere(z, 1)[2], first)
                similar = dict(zip(names, best.tolist(), strict=True))
                for i, one in enumerate(limits):
                    for by_objects in (True, False):
                        listed = shortlist(similar, said if by_objects else {}, sizes, model.temperature, one)
                        verdict = names[number] in listed, sum(sizes[name] for name in listed)
                        found.setdefault((i, by_objects, metres), []).append(verdict)
    return [
        {
            "method": f"{limits[i].buildings} buildings" + ("" if by_objects else ", by similarity alone"),
            "scope": f"{metres:g}m",
            "listed": float(np.mean([listed for listed, _ in verdicts])),
            "places": float(np.mean([places for _, places in verdicts])),
            "queries": len(verdicts),
        }
        for (i, by_objects, metres), verdicts in sorted(
            found.items(), key=lambda item: (item[0][0], -item[0][1], item[0][2])
        )
    ]
