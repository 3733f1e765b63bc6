"""Batches by hand: a plain breadth-first extraction, kept apart from the library's own so that it can check it."""

from __future__ import annotations

import numpy as np
import torch

from semloc_core.encoding.place_graph import Batch


def ego_batch(
    classes: dict[str, int],
    edges: list[tuple[str, str]],
    roots: list[str],
    hops: int,
    n_classes: int,
    whole: bool = False,
) -> Batch:
    """Ego graphs of ``roots``; ``classes`` maps objects to class (-1 unknown), undirected ``edges`` name the places.

    With ``whole`` the roots share one graph.
    """
    neighbours: dict[str, list[str]] = {name: [] for name in classes}
    for a, b in edges:
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    for root in roots:
        neighbours.setdefault(root, [])

    nodes: list[tuple[int, int, str]] = []  # hop, graph, name
    for g, group in enumerate([roots] if whole else [[root] for root in roots]):
        hop = dict.fromkeys(group, 0)
        frontier = list(group)
        for h in range(1, hops + 1):
            frontier = [n for f in frontier for n in neighbours[f] if n not in hop and hop.setdefault(n, h) == h]
        nodes += [(h, g, name) for name, h in hop.items()]
    nodes.sort(key=lambda node: node[0])  # stable: roots stay in order
    row = {(g, name): i for i, (_, g, name) in enumerate(nodes)}
    directed = [
        (row[g, source], i, h) for i, (h, g, name) in enumerate(nodes) if h < hops for source in neighbours[name]
    ]
    hop_of_target = np.array([h for _, _, h in directed], dtype=int)
    features = torch.zeros(len(nodes), n_classes)
    for i, (_, _, name) in enumerate(nodes):
        if classes.get(name, -1) >= 0:
            features[i, classes[name]] = 1.0
    return Batch(
        features=features,
        edge_index=torch.tensor([[s, t] for s, t, _ in directed], dtype=torch.int64).reshape(-1, 2).T.contiguous(),
        edge_length=torch.ones(len(directed)),
        is_object=torch.tensor([name in classes for _, _, name in nodes]),
        graph=torch.tensor([g for _, g, _ in nodes]),
        n_roots=len(roots),
        nodes_within=tuple(sum(node[0] <= h for node in nodes) for h in range(hops + 1)),
        edges_within=tuple(int((hop_of_target <= h).sum()) for h in range(hops)),
        node_ids=tuple(name for _, _, name in nodes),
    )


def star_batch(stars: list[list[tuple[str, int, float]]], n_classes: int) -> Batch:
    """One star a root: its objects as (name, class, distance in metres)."""
    rows = [(g, *entry) for g, star in enumerate(stars) for entry in star]
    b = len(stars)
    features = torch.zeros(b + len(rows), n_classes)
    for i, (_, _, class_, _) in enumerate(rows):
        if class_ >= 0:
            features[b + i, class_] = 1.0
    return Batch(
        features=features,
        edge_index=torch.tensor([[b + i, row[0]] for i, row in enumerate(rows)]).reshape(-1, 2).T.long(),
        edge_length=torch.tensor([row[3] for row in rows], dtype=torch.float32),
        is_object=torch.arange(b + len(rows)) >= b,
        graph=torch.tensor([*range(b), *(row[0] for row in rows)]),
        n_roots=b,
        nodes_within=(b, b + len(rows)),
        edges_within=(len(rows),),
        node_ids=(*(f"place{g}" for g in range(b)), *(row[1] for row in rows)),
    )


def random_world(
    seed: int, places: int = 25, objects: int = 12, n_classes: int = 4
) -> tuple[dict[str, int], list[tuple[str, str]], list[str]]:
    """Classes, edges and place names of a random graph with a few isolated places."""
    rng = np.random.default_rng(seed)
    names = [f"p{i}" for i in range(places)]
    linked = names[:-2]
    edges = [(linked[i], linked[int(rng.integers(max(0, i - 4), i))]) for i in range(1, len(linked))]
    edges += [
        (linked[i], linked[i + 3]) for i in range(0, len(linked) - 3, 5) if (linked[i + 3], linked[i]) not in edges
    ]
    classes = {f"o{i}": int(rng.integers(n_classes)) for i in range(objects)}
    for o in classes:
        edges += [(linked[int(p)], o) for p in rng.choice(len(linked), size=3, replace=False)]
    return classes, edges, names
