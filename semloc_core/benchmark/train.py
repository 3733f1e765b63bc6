"""Embedding for a map and training steps, beside PyG's layers with the same weights on the same graph."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import torch
from torch import Tensor

from semloc_core.benchmark.case import BenchCase
from semloc_core.benchmark.explain import Peer
from semloc_core.benchmark.timing import Contender, by_turns
from semloc_core.encoding import Batch, PaperEncoder, extract_all
from semloc_core.errors import ConfigError
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.training import infonce

ROOTS = 256


def bench_train(case: BenchCase, repeats: int = 10, progress: Progress = no_progress) -> list[Row]:
    """Time embedding of a whole building, and training steps on it.

    Args:
        case: the office, about 1,300 places.
        repeats: how often each is timed.
        progress: told of every repeat.

    Returns:
        Rows; those of embedding are for one place and have ``per_second``, those of training for one step: forward
        pass of two variants, InfoNCE over 256 places, backward pass, Adam.

    Raises:
        ConfigError: the peers do not compute the same embeddings.

    """
    ours = deepcopy(case.model.encoder)  # its weights change
    assert isinstance(ours, PaperEncoder)
    batch = extract_all(case.arrays, ours.n_classes, ours.extraction)
    peer = Peer(ours, torch.from_numpy(case.embeddings[0]))
    with torch.inference_mode():
        apart = float((ours(batch) - peer_embeddings(peer, batch)).abs().max())
    if apart > 1e-5:
        raise ConfigError(f"expected peers with the same embeddings (got {apart:.2g} apart)")

    def embed(work: Callable[[], Tensor]) -> Callable[[], object]:
        def run() -> object:
            with torch.inference_mode():
                return work()

        return run

    n = batch.n_roots
    places = f"embedding, building of {n:,} places, each"
    step = f"training step, building of {n:,} places"
    rows = by_turns(
        [
            Contender(places, "semloc", embed(lambda: ours(batch)), n),
            Contender(places, "PyG", embed(lambda: peer_embeddings(peer, batch)), n),
        ],
        repeats,
        progress,
    )
    ours.train()
    rows += by_turns(
        [
            Contender(step, "semloc", _step(ours.parameters, ours, batch)),
            Contender(step, "PyG", _step(peer.parameters, lambda each: peer_embeddings(peer, each), batch)),
        ],
        repeats,
        progress,
    )
    for row in rows:
        row["per_second"] = 1e3 / float(row["p50_ms"] or 1.0)
    return rows


def peer_embeddings(peer: Peer, batch: Batch) -> Tensor:
    """(B, D) embeddings of a batch's roots by PyG's layers."""
    return peer.embeddings(batch.features, batch.edge_index, batch.n_roots)


def _step(parameters: Callable[[], object], forward: Callable[[Batch], Tensor], batch: Batch) -> Callable[[], object]:
    """A training step: two variants of the building (one with a tenth of its objects' features gone), InfoNCE, Adam."""
    optimiser = torch.optim.Adam(parameters(), lr=1e-4)  # type: ignore[arg-type]  # of either kind of module
    generator = torch.Generator().manual_seed(0)
    keep = (torch.rand(batch.n_nodes, 1, generator=generator) > 0.1).float()
    other = replace(batch, features=batch.features * keep)
    chosen = torch.randperm(batch.n_roots, generator=generator)[:ROOTS]

    def run() -> object:
        optimiser.zero_grad()
        positive = torch.eye(len(chosen), dtype=torch.bool)
        loss = infonce(forward(batch)[chosen], forward(other)[chosen], positive)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        return loss

    return run
