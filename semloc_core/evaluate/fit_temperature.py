"""Fits the general encoder's temperature on generated buildings: ``python -m semloc_core.evaluate.fit_temperature``.

No real building is read. Homes and offices are drawn, each mapped once and seen again by a detector; every place of the
second runs is asked in the maps of all buildings of its kind. The temperature is that of which the probabilities of the
best places are the most honest (`semloc_core.training.honest_temperature`), as training fits an encoder's own.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import embed_graph, general_model, similarity_matrix
from semloc_core.evaluate.relocalise import Arena
from semloc_core.graph import Floats, GraphArrays, load_labelspace
from semloc_core.sources import KINDS, draw_pair
from semloc_core.training import honest_temperature

BUILDINGS = (("home", KINDS["home"], 12), ("office", KINDS["office"], 6))
"""Kinds of buildings, and how many: homes are smaller."""
PLACES = 40
"""Places of each building that are asked about, spread evenly."""

Bools = NDArray[np.bool_]


def asked(arenas: Sequence[Arena]) -> tuple[Floats, Bools, Bools]:
    """Similarities (Q, M) of queries to the places of their arena's maps, which lie near the best, and which are right.

    Args:
        arenas: buildings of one kind each; those of fewer places than the most have similarities of -inf for the rest.

    """
    each = [_asked(arena) for arena in arenas]
    most = max(similarity.shape[1] for similarity, _, _ in each)

    def wide(array: NDArray[np.generic], value: float) -> NDArray[np.generic]:
        return np.pad(array, ((0, 0), (0, most - array.shape[1])), constant_values=value)

    similarity = np.concatenate([wide(found, -np.inf) for found, _, _ in each]).astype(np.float64)
    near = np.concatenate([wide(found, False) for _, found, _ in each]).astype(np.bool_)
    return similarity, near, np.concatenate([right for _, _, right in each])


def _asked(arena: Arena) -> tuple[Floats, Bools, Bools]:
    model = general_model(arena.maps, arena.labelspace)
    database = np.concatenate([embed_graph(model, graph) for graph in arena.maps])
    similarity, near, right = [], [], []
    for building, query in enumerate(arena.queries):
        rows = np.unique(np.linspace(0, query.n_places - 1, min(query.n_places, PLACES)).round().astype(np.int64))
        found = similarity_matrix(embed_graph(model, query)[rows], database)
        best = found.argmax(axis=1)
        away = np.linalg.norm(arena.positions[best][:, None] - arena.positions, axis=2)
        near.append((away <= MATCH_RADIUS_M) & (arena.building[best][:, None] == arena.building))
        right.append(arena.right(best[:, None], building, query.place_positions[rows], MATCH_RADIUS_M)[:, 0])
        similarity.append(found)
    return np.concatenate(similarity).astype(np.float64), np.concatenate(near), np.concatenate(right)


def arenas(seed: int) -> Iterator[Arena]:
    """The buildings of each kind, as the classes of COCO."""
    space = load_labelspace("coco")
    for _, kind, count in BUILDINGS:
        pairs = [draw_pair(kind, np.random.default_rng([seed, number])) for number in range(count)]
        maps, queries = (
            tuple(GraphArrays.from_scene_graph(pair[side].graph, space, str(n)) for n, pair in enumerate(pairs))
            for side in (0, 1)
        )
        yield Arena(space, maps, queries)


def main() -> None:
    """Print the temperature of each kind, and that of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="of the buildings")
    seed = parser.parse_args().seed
    drawn = list(arenas(seed))
    for name, some in (*((of[0], [arena]) for of, arena in zip(BUILDINGS, drawn, strict=True)), ("all", drawn)):
        similarity, near, right = asked(some)
        fitted = honest_temperature(similarity, near, right)
        print(f"{name}: {len(right)} queries, {right.mean():.3f} right, temperature {fitted:.2g}")  # noqa: T201


if __name__ == "__main__":
    main()
