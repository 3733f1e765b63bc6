"""Queries to explain: by encoders on a small random graph, and by functions whose answers are known by hand."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from semloc_core.encoding import Encoder, PaperEncoder, build_encoder
from semloc_core.encoding.encoder.paper.encoder import PaperConfig
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.variants.perturbed import NODES_AT_ONCE
from semloc_core.explain.explainers.coalitions import exact_values
from semloc_core.explain.scores import ObjectScores
from semloc_core.explain.similarity import SimilarityQuery

N_CLASSES = 4


def paper_encoder(n_classes: int = N_CLASSES, seed: int = 3) -> PaperEncoder:
    """The paper's encoder with random weights, its batch norms as if they had seen data."""
    encoder = PaperEncoder(PaperConfig(), n_classes, torch.Generator().manual_seed(seed))
    generator = torch.Generator().manual_seed(seed + 1)
    for layer in encoder.layers:
        layer.norm.running_mean.uniform_(-0.5, 0.5, generator=generator)
        layer.norm.running_var.uniform_(0.3, 2.0, generator=generator)
    return encoder.eval()


def room(classes: list[int], n_classes: int = N_CLASSES) -> Batch:
    """A root place q, places a and b beside it; object i is seen from q, from a, or from both, by turns."""
    places = ["q", "a", "b"]
    undirected = [("q", "a", 1.0), ("q", "b", 2.0)]
    objects = [f"o{i}" for i in range(len(classes))]
    for i, name in enumerate(objects):
        undirected += [(name, place, 0.5 + 0.3 * i) for place in (("q",), ("a",), ("q", "a"))[i % 3]]
    near = [name for i, name in enumerate(objects) if i % 3 != 1]
    far = [name for i, name in enumerate(objects) if i % 3 == 1]
    names = ["q", "a", "b", *near, *far]
    row = {name: i for i, name in enumerate(names)}
    hop_one = 3 + len(near)
    directed = sorted(
        [(row[t], row[s], length) for s, t, length in undirected]
        + [(row[s], row[t], length) for s, t, length in undirected]
    )
    features = torch.zeros(len(names), n_classes)
    for name, c in zip(objects, classes, strict=True):
        if c >= 0:
            features[row[name], c] = 1.0
    into_root = sum(t == 0 for t, _, _ in directed)
    into_near = sum(t < hop_one for t, _, _ in directed)
    return Batch(
        features=features,
        edge_index=torch.tensor([[s for _, s, _ in directed], [t for t, _, _ in directed]]),
        edge_length=torch.tensor([length for _, _, length in directed], dtype=torch.float32),
        is_object=torch.tensor([name not in places for name in names]),
        graph=torch.zeros(len(names), dtype=torch.int64),
        n_roots=1,
        nodes_within=(1, hop_one, len(names), len(names)),
        edges_within=(into_root, into_near, len(directed)),
        node_ids=tuple(names),
        free_space=torch.linspace(1.0, 40.0, 8)[None],  # of the default bands of geodesic attention
    )


def class_names(of: Batch) -> list[str]:
    """``class_<i>`` of each object, ``?`` where it has no class."""
    return [f"class_{int(f.argmax())}" if bool(f.any()) else "?" for f in of.features]


def encoder_query(
    encoder: Encoder, classes: list[int], other: list[int], nodes_at_once: int = NODES_AT_ONCE
) -> SimilarityQuery:
    """A room of some objects against a room of others."""
    query = room(classes)
    with torch.no_grad():
        target = encoder(room(other))[0]
    return SimilarityQuery.from_encoder(encoder, query, target, class_names(query), nodes_at_once=nodes_at_once)


def node_shapley(query: SimilarityQuery) -> ObjectScores:
    """Exact Shapley values of objects, from all 2^O coalitions."""
    found = exact_values(query.of_objects, query.n_objects)
    return query.scores("node_shapley", found.values, found.standard_error, found.gap)


def any_encoder(name: str) -> Encoder:
    """An encoder by name, ready to embed a `room`."""
    return paper_encoder() if name == "paper" else build_encoder(name, None, N_CLASSES).eval()


def toy_query(of_one: Callable[[Tensor, Tensor], Tensor], features: Tensor, classes: list[str]) -> SimilarityQuery:
    """A model from elsewhere: ``of_one(features (N, C), keep (N,)) -> ()``; every node is an object."""

    def similarity(features_: Tensor | None = None, keep: Tensor | None = None) -> Tensor:
        k = len(features_) if features_ is not None else len(keep) if keep is not None else 0
        x = features_ if features_ is not None else features.expand(k, -1, -1)
        kept = keep if keep is not None else torch.ones(k, len(features), dtype=torch.bool)
        return torch.stack([of_one(a, b) for a, b in zip(x, kept, strict=True)])

    return SimilarityQuery(
        ids=tuple(f"n{i}" for i in range(len(features))),
        classes=tuple(classes),
        rows=torch.arange(len(features)),
        features=features,
        function=similarity,
    )
