"""How often the robot's building is among the few that it answers from, on generated buildings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from semloc_core.encoding import embed_graph, general_model
from semloc_core.errors import GraphError
from semloc_core.evaluate.fit_confidence import draw_buildings
from semloc_core.evaluate.online.fragments import embed_walk
from semloc_core.fleet import Nearest, ShortlistConfig, shortlist
from semloc_core.map_database import ExactSearch
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.sources import KINDS, WalkConfig, walk

SCOPES_M = (0.0, 5.0, 10.0, 20.0, 40.0)
LIMITS = tuple(
    ShortlistConfig(nearest=nearest, buildings=buildings) for nearest in (400, 1600, 6400) for buildings in (16, 32, 64)
)


def evaluate_shortlist(
    kind: str,
    buildings: int,
    limits: Sequence[ShortlistConfig] = LIMITS,
    walks: int = 2,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Row]:
    """Ask along walks through second runs of generated buildings; each query by itself, no list before it.

    Args:
        kind: of building, `semloc_core.sources.world.KINDS`.
        buildings: how many, all in one map, searched exactly.
        limits: of the lists compared.
        walks: through each building.
        seed: of all that is drawn.
        progress: told of every building.

    Returns:
        A row for each of ``limits`` and metres walked (``scope``): ``listed``, the share of queries whose building is
        on the list, ``places``, the mean number on it, and ``queries``.

    """
    rng = np.random.default_rng(seed)
    progress(0, buildings, "drawing")
    kinds = {str(name): one for name, one in KINDS.items()}
    maps, again, space = draw_buildings(kinds[kind], buildings, rng)
    model = general_model(maps, space)
    names = [f"{number:05d}" for number in range(buildings)]
    sizes = {name: home.n_places for name, home in zip(names, maps, strict=True)}
    of = np.repeat(np.arange(buildings), [home.n_places for home in maps])
    search = ExactSearch(np.concatenate([embed_graph(model, home) for home in maps]))
    found: dict[tuple[int, float], list[tuple[bool, int]]] = {}
    for number, graph in enumerate(again):
        progress(number, buildings, kind)
        for _ in range(walks):
            try:
                way = walk(graph, WalkConfig(distance_m=SCOPES_M[-1] + 5.0), rng)
            except GraphError:  # without two places that are joined
                continue
            steps = np.minimum(np.searchsorted(way.metres, SCOPES_M), way.steps - 1)
            for metres, z in zip(SCOPES_M, embed_walk(model, way.at(steps)), strict=True):
                if not z.any():
                    continue
                rows, similarities = search.search(z, max(one.nearest for one in limits))
                for i, one in enumerate(limits):
                    some = rows[: one.nearest]
                    nearest = Nearest(
                        tuple(names[b] for b in of[some].tolist()), ("",) * len(some), similarities[: one.nearest]
                    )
                    listed = shortlist(nearest, sizes, model.temperature, one)
                    verdict = names[number] in listed, sum(sizes[name] for name in listed)
                    found.setdefault((i, metres), []).append(verdict)
    return [
        {
            "method": f"{limits[i].buildings} buildings, by {limits[i].nearest} places",
            "scope": f"{metres:g}m",
            "listed": float(np.mean([listed for listed, _ in verdicts])),
            "places": float(np.mean([places for _, places in verdicts])),
            "queries": len(verdicts),
        }
        for (i, metres), verdicts in sorted(found.items())
    ]
