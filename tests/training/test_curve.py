from pathlib import Path

import pytest

from semloc_core.errors import TrainingError
from semloc_core.training.curve import plot_curve

HISTORY = [{"step": float(s), "train_loss": 1 / s, "val_loss": 2 / s, "val_pr_auc": 1 - 1 / s} for s in (1, 2, 3)]


def test_the_curve_is_drawn(tmp_path: Path):
    plot_curve(HISTORY, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("history", "name"), [([], "curve.png"), (HISTORY, "no/curve.png"), (HISTORY, "curve.nonsense")]
)
def test_what_can_not_be_drawn_is_one_line(tmp_path: Path, history, name):
    with pytest.raises(TrainingError, match="expected"):
        plot_curve(history, tmp_path / name)
