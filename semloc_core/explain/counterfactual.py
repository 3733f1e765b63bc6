"""Counterfactuals: without which objects another place would be the top match, and why it is not that place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import PerturbedEncoder
from semloc_core.explain.explainers.shapley import class_values
from semloc_core.explain.similarity import SimilarityQuery
from semloc_core.map_database import LoadedMap
from semloc_core.wire import ClassContrast, Counterfactual, ObjectName, WhyNot

Bools = NDArray[np.bool_]


def counterfactual(
    loaded: LoadedMap, perturbed: PerturbedEncoder, class_names: Sequence[str], z: NDArray[np.float32]
) -> Counterfactual:
    """Find few objects whose removal makes another place the top match.

    The top match is the search's, by similarity, before any verification by layout. Another place is one in another
    building, on another storey or farther than the matching radius from the top match: a neighbour of it would be the
    same answer.
    Tried in one batch, against all places of the map: every single object, and all objects of each class together;
    only where none of these does it, in a second batch, ever more objects in order of what their own removal costs
    the top match. The fewest win, then the widest margin over the old top match.

    Args:
        loaded: the map.
        perturbed: embeds the query place without some of its objects.
        class_names: N names of the query's nodes; those of places are not read.
        z: (D,) the query's embedding.

    Returns:
        The removal; an empty one where none that was tried changes the answer.

    """
    batch = perturbed.batch
    objects = np.flatnonzero(batch.is_object.numpy())
    names = [class_names[i] for i in objects.tolist()]
    top = int(loaded.search(z, 1)[0][0])
    one_by_one: Bools = np.eye(len(objects), dtype=np.bool_)
    by_class: Bools = np.array([[own == name for own in names] for name in sorted(set(names))], dtype=np.bool_)
    removed = np.concatenate([one_by_one, by_class.reshape(-1, len(objects))])
    found, loss = _try(loaded, perturbed, objects, removed, top)
    if found is None and len(objects) > 2:
        order = np.argsort(-loss[: len(objects)], kind="stable")
        rank = np.argsort(order, kind="stable")
        removed = rank < np.arange(2, len(objects))[:, None]
        found, _ = _try(loaded, perturbed, objects, removed, top)
    if found is None:
        return Counterfactual(removed=[], map=None, place=None, similarity=None)
    variant, row, similarity = found
    return Counterfactual(
        removed=[ObjectName(id=batch.node_ids[i], class_=class_names[i]) for i in objects[removed[variant]].tolist()],
        map=loaded.buildings[int(loaded.building_index[row])],
        place=loaded.place_ids[row],
        similarity=similarity,
    )


def _try(
    loaded: LoadedMap, perturbed: PerturbedEncoder, objects: NDArray[np.int64], removed: Bools, top: int
) -> tuple[tuple[int, int, float] | None, NDArray[np.float64]]:
    """The best of some removals (variant, its top row, its similarity), or None; and what each costs the top match."""
    if len(removed) == 0:
        return None, np.zeros(0)
    keep = torch.ones(len(removed), perturbed.batch.n_nodes, dtype=torch.bool)
    keep[:, torch.from_numpy(objects)] = torch.from_numpy(~removed)
    embeddings = perturbed.embed(keep=keep).detach().cpu().numpy()
    rows, similarity = (x[:, 0] for x in loaded.search(embeddings, 1))
    of_top = (embeddings.astype(np.float64) * loaded.embeddings[top]).sum(axis=1)
    of_top = of_top.astype(np.float32).astype(np.float64)  # as a search rounds
    apart = np.linalg.norm(loaded.positions[rows] - loaded.positions[top], axis=1) > MATCH_RADIUS_M
    apart |= loaded.storey_index[rows] != loaded.storey_index[top]
    apart &= embeddings.any(axis=1)  # where nothing is left to say, there is no answer at all
    margin = similarity.astype(np.float64) - of_top
    candidates = np.flatnonzero(apart)
    if len(candidates) == 0:
        return None, -of_top
    best = min(candidates.tolist(), key=lambda k: (int(removed[k].sum()), -float(margin[k]), k))
    return (best, int(rows[best]), float(similarity[best])), -of_top


def why_not(
    loaded: LoadedMap,
    perturbed: PerturbedEncoder,
    class_names: Sequence[str],
    z: NDArray[np.float32],
    row: int,
    listed: Sequence[int],
    rng: np.random.Generator,
) -> WhyNot | None:
    """Which classes speak for the top match and which for the place asked for, as far as similarity goes.

    Shapley values of the classes in the game whose value is s(query, place) - s(query, top): the difference of two
    similarities is linear in the embedding, so every coalition is encoded once.

    Args:
        loaded: the map.
        perturbed: embeds the query place without some of its objects.
        class_names: N names of the query's nodes; those of places are not read.
        z: (D,) the query's embedding.
        row: the place asked for.
        listed: rows of the answer, best first: the first is the top match.
        rng: for more classes than can be computed exactly.

    Returns:
        None where the place asked for is the top match.

    """
    everywhere = loaded.index.everywhere(z, 1)[2]
    top = listed[0]
    if top == row:
        return None
    direction = torch.from_numpy(loaded.embeddings[row] - loaded.embeddings[top])
    query = SimilarityQuery.from_perturbed(perturbed, direction, class_names)
    ahead = {*listed, *np.flatnonzero(everywhere > everywhere[row]).tolist()}
    names, _ = query.class_players
    values = class_values(query, rng).values.tolist()
    order = sorted(range(len(names)), key=lambda i: (-abs(values[i]), names[i]))
    return WhyNot(
        map=loaded.buildings[int(loaded.building_index[top])],
        place=loaded.place_ids[top],
        similarity=float(everywhere[top]),
        rank=listed.index(row) + 1 if row in listed else 1 + len(ahead),
        classes=[ClassContrast(class_=names[i], score=values[i]) for i in order],
    )
