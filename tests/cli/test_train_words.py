"""What `semloc train` says of itself, in words."""

import math
from typing import get_args, get_type_hints

import pytest

from semloc_core.cli.train import WHY_ENDED, _kept
from semloc_core.errors import ConfigError
from semloc_core.training.config import train_config
from semloc_core.training.loop import TrainResult


def result(stopped: str, *looks: float) -> TrainResult:
    history = [{"step": 20.0 * (i + 1), "val_pr_auc": value} for i, value in enumerate(looks)]
    return TrainResult(None, history, [], 20, stopped)  # type: ignore[arg-type]  # no model is needed to talk of it


def test_which_weights_are_kept_how_good_they_are_and_why_there_are_no_later_ones() -> None:
    said = _kept(result("patience", 0.9, 0.8))
    assert said == (
        "kept the weights of step 20 of 40, the best on places held out for validation: PR-AUC 0.900; "
        "it stopped early, having got no better for long"
    )
    assert "nan" not in _kept(result("steps", math.nan))


def test_every_reason_to_end_has_its_words() -> None:
    reasons = get_args(get_type_hints(TrainResult)["stopped"])
    assert set(WHY_ENDED) | {"nothing to train"} == set(reasons)


def test_an_encoder_without_weights_kept_none(semloc, write_corridor, tmp_path) -> None:
    graph = write_corridor(tmp_path / "home.json", ["chair", "couch"] * 8)
    said = semloc("train", graph, "--encoder", "histogram", "-o", tmp_path / "a.model")
    assert said.code == 0, said.err
    assert "histogram has nothing to train\n" in said.out
    assert "step" not in said.out


def test_an_option_that_does_not_exist_is_answered_with_those_that_do() -> None:
    with pytest.raises(ConfigError, match=r"expected an option among .*validate_steps.* \(got 'val_every'\)"):
        train_config("paper", val_every=1)
