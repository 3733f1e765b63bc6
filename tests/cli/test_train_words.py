"""What `semloc train` says of itself, in words."""

import math
from typing import get_args, get_type_hints

import pytest
from small_building import SPACE, building_update

from semloc_core.cli.train import WHY_ENDED, _kept, gains
from semloc_core.errors import ConfigError
from semloc_core.graph import GraphArrays, SceneGraph
from semloc_core.training import train
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


def test_what_training_brought_is_said_and_when_it_brought_nothing() -> None:
    def rows(whole: float, fragment: float) -> list[dict[str, object]]:
        before = {"whole": 0.5, "fragment": 0.25}
        after = {"whole": whole, "fragment": fragment}
        return [
            {"method": name, "scope": scope, "success@1": value}
            for name, of in (("trained", after), ("general", before))
            for scope, value in of.items()
        ]

    assert gains(rows(0.75, 0.25), "general", general=True) == [
        "whole: success@1 0.500 by the general encoder, 0.750 trained (+0.250)",
        "fragment: success@1 0.250 by the general encoder, 0.250 trained (+0.000)",
    ]
    assert gains(rows(0.5, 0.2), "general", general=True)[2:] == [
        "training brought nothing here: the general encoder does as well"
    ]
    assert gains(rows(0.5, 0.2), "general", general=False)[2:] == [
        "training brought nothing here: the start does as well"
    ]


def test_it_tells_how_far_it_is_before_the_first_step() -> None:
    graph = SceneGraph()
    graph.apply(building_update())
    told: list[tuple[int, int]] = []
    arrays = [GraphArrays.from_scene_graph(graph, SPACE, "home")]
    config = train_config("geodesic_attention", steps=1)
    train(
        arrays,
        SPACE,
        config,
        progress=lambda report: told.append((-report.step, 0)),
        preparing=lambda *n: told.append(n),
    )
    views = [n for n in told if n[0] >= 0]
    assert views[0] == (0, views[-1][1])
    assert views[-1][0] == views[-1][1] > 0
    assert told[len(views) :] == [(-1, 0)], "first all views, then the step"
