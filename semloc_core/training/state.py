"""A training state on disk: written whole or not at all, read without running any code in it."""

from __future__ import annotations

import hashlib
import io
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch import Tensor

from semloc_core.errors import TrainingError
from semloc_core.files import write_whole
from semloc_core.graph import GraphArrays, Labelspace
from semloc_core.training.config import TrainConfig

FORMAT = 1


class Progress(msgspec.Struct, frozen=True):
    """What a training has come to, but for the tensors.

    Args:
        step: steps done.
        best_step: the step of the best look at the validation split.
        best_value: its PR-AUC; -inf before the first.
        stale: looks since then.
        history: one row a look.

    """

    step: int = 0
    best_step: int = 0
    best_value: float = -1.0
    stale: int = 0
    history: list[dict[str, float]] = []


class TrainingState(msgspec.Struct, frozen=True):
    """Everything that the next step depends on.

    Args:
        progress: counters and history.
        encoder: weights and buffers now.
        optimiser: Adam's state.
        best: weights and buffers at the best look.

    """

    progress: Progress
    encoder: dict[str, Tensor]
    optimiser: dict[str, Any]
    best: dict[str, Tensor]


def fingerprint(graphs: Sequence[GraphArrays], labelspace: Labelspace, config: TrainConfig) -> str:
    """sha256 (hex) of all that decides a training's course; a time budget does not."""
    digest = hashlib.sha256()
    settings = msgspec.structs.replace(config, max_seconds=None)
    digest.update(msgspec.json.encode(settings, order="deterministic"))
    mobility = [labelspace.mobility_of(c) for c in labelspace.classes]
    digest.update(msgspec.json.encode([labelspace.hash, mobility, labelspace.default_mobility]))
    for graph in graphs:
        digest.update(msgspec.json.encode([graph.name, graph.place_ids, graph.object_ids]))
        for array in (v for v in vars(graph).values() if isinstance(v, np.ndarray)):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def save_state(path: Path, state: TrainingState, inputs: str) -> None:
    """Write a state beside the old one, then put it in its place; a kill at any moment leaves one of them.

    Args:
        path: the state file.
        state: what to keep.
        inputs: `fingerprint` of what is trained on.

    Raises:
        TrainingError: the file can't be written.

    """
    content = {
        "format": FORMAT,
        "inputs": inputs,
        "progress": msgspec.json.encode(state.progress).decode(),
        "encoder": state.encoder,
        "optimiser": state.optimiser,
        "best": state.best,
    }
    # Into memory first: torch reports a full disk as an error of its own, after what it wrote.
    packed = io.BytesIO()
    torch.save(content, packed)
    try:
        write_whole(path, packed.getvalue())
    except OSError as error:
        raise TrainingError(
            f"expected a training state that can be written (got {path}: {error.strerror or error})"
        ) from error


def load_state(path: Path, inputs: str) -> TrainingState:
    """Read a state.

    Raises:
        TrainingError: no such file, not a training state, or one of other graphs or options.

    """
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise TrainingError(f"expected a training state of format {FORMAT} (got {path})")
        state = TrainingState(
            progress=msgspec.json.decode(content["progress"], type=Progress),
            encoder=content["encoder"],
            optimiser=content["optimiser"],
            best=content["best"],
        )
    except (OSError, RuntimeError, EOFError, KeyError, ValueError, pickle.UnpicklingError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise TrainingError(f"expected a training state (got {path}: {reason})") from error
    if content["inputs"] != inputs:
        raise TrainingError(
            f"expected a training state of the same graphs, labelspace and options (got {path}, of others)"
        )
    return state
