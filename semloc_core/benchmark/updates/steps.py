"""One update: from JSON to matches and attributions in JSON, step by step, on maps of several sizes.

Beside it PyG's forward pass of the same encoder, with the same weights, on the same ego graphs: what a pipeline
built on it would spend before it has looked anything up.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from semloc_core import wire
from semloc_core.benchmark.case import BenchCase
from semloc_core.benchmark.explain import Peer
from semloc_core.benchmark.timing import Times, clocked, is_full, timed_row
from semloc_core.config import LocaliserConfig
from semloc_core.encoding import PaperEncoder
from semloc_core.explain import SimilarityQuery, explain
from semloc_core.localiser import Localiser
from semloc_core.metrics import Progress, Row, no_progress

MAP_SIZES = (1_500, 100_000, 1_000_000)
STEPS = ("decode", "apply", "extract", "embed", "search and rank", "attribute", "test of the attribution", "encode")


def bench_steps(
    case: BenchCase, sizes: Sequence[int] = MAP_SIZES, rounds: int = 1, progress: Progress = no_progress
) -> list[Row]:
    """Time updates.

    Args:
        case: what is timed.
        sizes: of the maps, places.
        rounds: how often the run is walked, the first time untimed besides.
        progress: told of every map.

    Returns:
        For each map: the whole update with an explanation each time, the same without the test of the attribution
        (fidelity), its steps, and PyG's forward pass; ``ratio`` is the row's own CPU time over the whole update's.

    """
    rows: list[Row] = []
    for number, size in enumerate(sizes):
        progress(number, len(sizes), f"updates, map of {size} places")
        rows += _one_map(case, size, rounds)
    return rows


def _one_map(case: BenchCase, size: int, rounds: int) -> list[Row]:
    localiser = Localiser(case.map_of(size), LocaliserConfig(explain_rate_hz=1000.0, max_update_bytes=2**28))
    encoder = case.model.encoder
    assert isinstance(encoder, PaperEncoder)
    peer = Peer(encoder, torch.from_numpy(case.embeddings[0]))
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in ("all", "pyg", *STEPS)}
    for round_ in range(rounds + 1):
        for text in case.updates:
            took = _one_update(localiser, peer, text)
            if round_ and took is not None and not is_full(text):
                for name, pair in took.items():
                    seconds[name].append(pair)
    scope = f"update, map of {size:,} places"
    times = {name: np.array(pairs) for name, pairs in seconds.items()}
    whole = float(np.median(times["all"][:, 1]))
    lean = times["all"] - times["test of the attribution"]
    return [
        timed_row(scope, "semloc", times["all"], whole),
        timed_row(scope, "semloc, attribution untested", lean, whole),
        *(timed_row(scope, f"· {name}", times[name], whole) for name in STEPS),
        timed_row(scope, "PyG's forward pass alone", times["pyg"], whole),
    ]


def _one_update(localiser: Localiser, peer: Peer, text: bytes) -> Times | None:
    """Seconds (clock, own) of each step of one update; None where it has no answer to explain."""
    took: Times = {}

    def watched(owner: object, method: str, name: str) -> None:
        """Clock a step where it is done; `locate` does it once."""
        work = getattr(type(owner), method).__get__(owner)
        setattr(owner, method, lambda *given: clocked(took, name, lambda: work(*given)))

    update = clocked(took, "decode", lambda: wire.decode_update(text, localiser.config.max_update_bytes))
    clocked(took, "apply", lambda: localiser.apply(update))
    watched(localiser.map.queries, "encode", "embed")
    if localiser.live.surroundings is not None:
        watched(localiser.live.surroundings, "batch", "extract")
    located = clocked(took, "locate", localiser.locate)
    query = located.query
    if located.best_row is None or query.batch is None:
        return None
    attributions = clocked(took, "explain", lambda: localiser.explain(located))
    clocked(took, "encode", lambda: (wire.encode(located.matches), wire.encode(attributions)))

    model, batch = localiser.map.model, query.batch
    with torch.inference_mode():
        clocked(took, "pyg", lambda: peer(batch.features, batch.edge_index))
    # A part of `explain`, once more and apart.
    target = torch.from_numpy(localiser.map.embeddings[located.best_row])

    def attribute() -> object:
        question = SimilarityQuery.from_encoder(
            model.encoder, batch, target, query.class_names, query.encoded, queries=localiser.map.queries
        )
        return explain(question, "attention", np.random.default_rng(0))

    clocked(took, "attribute", attribute)
    seconds = {name: np.array(of) for name, of in took.items()}
    for name, rest in (
        ("search and rank", seconds["locate"] - seconds["extract"] - seconds["embed"]),
        ("test of the attribution", seconds["explain"] - seconds["attribute"]),
        ("all", np.sum([seconds[part] for part in ("decode", "apply", "locate", "explain", "encode")], axis=0)),
    ):
        took[name] = (float(rest[0]), float(rest[1]))
    del took["locate"], took["explain"]
    return took
