"""The loss curve: what training went through, as a picture."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from semloc_core.errors import TrainingError
from semloc_core.files import write_whole


def plot_curve(history: Sequence[dict[str, float]], path: Path) -> None:
    """Draw training loss, validation loss and validation PR-AUC over the steps.

    Args:
        history: rows with ``step``, ``train_loss``, ``val_loss`` and ``val_pr_auc``, as `TrainResult.history` has.
        path: the picture; its suffix says the format (``.png``, ``.svg``, ``.pdf``).

    Raises:
        TrainingError: no history, or the picture can't be written.

    """
    if not history:
        raise TrainingError("expected at least one row of training history to plot (got none)")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    FigureCanvasAgg(figure)
    steps = [row["step"] for row in history]
    losses = figure.add_subplot()
    scores = losses.twinx()
    lines = [
        *losses.plot(steps, [row["train_loss"] for row in history], color="#0072b2", label="training loss"),
        *losses.plot(steps, [row["val_loss"] for row in history], color="#d55e00", ls="--", label="validation loss"),
        *scores.plot(steps, [row["val_pr_auc"] for row in history], color="#009e73", ls=":", label="validation PR-AUC"),
    ]
    losses.set(xlabel="step", ylabel="loss")
    scores.set(ylabel="PR-AUC", ylim=(0, 1))
    losses.legend(handles=lines, loc="center right")
    drawn = io.BytesIO()
    try:
        figure.savefig(drawn, format=path.suffix[1:] or None)
        write_whole(path, drawn.getvalue())
    except (OSError, ValueError) as error:
        raise TrainingError(f"expected a picture that can be written (got {path}: {error})") from error
