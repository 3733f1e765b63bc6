"""When to trust: answers one by one are those of the online evaluation, and a failure's parts sum to its margin."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from semloc_core.cli.evaluate.commands import app
from semloc_core.config import LocaliserConfig
from semloc_core.evaluate.online.protocol import evaluate_online
from semloc_core.evaluate.trust import Study, at_truth, failures, strangers, study_trust
from semloc_core.evaluate.trust_curves import (
    condition_rows,
    reliability_points,
    status_rows,
    success_points,
    threshold_rows,
    worst,
)
from semloc_core.sources.world import World, write_world

ACCEPTED = LocaliserConfig().accept_probability

SCOPES = (0.0, 5.0)


@pytest.fixture(scope="module")
def homes(small_worlds: list[World], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The three small buildings, each its own query; the third's objects are those of the first, so few fit."""
    root = tmp_path_factory.mktemp("homes")
    for index, world in enumerate(small_worlds):
        (root / f"b{index}").mkdir()
        write_world(root / f"b{index}" / "map.json", world)
        write_world(root / f"b{index}" / "query.json", world if index < 2 else small_worlds[0])
    return root


@pytest.fixture(scope="module")
def study(homes: Path) -> Study:
    return study_trust(homes, walks=3, scopes_m=SCOPES)


def test_answers_are_those_of_the_online_evaluation(homes: Path, study: Study) -> None:
    rows = evaluate_online(homes, encoders=("rings",), walks=3, scopes_m=SCOPES, filtered=False, bound=False)
    expected = {
        row["scope"]: row["success@1"] for row in rows if row["method"] == "rings + layout" and row["home"] == "any"
    }
    assert {row["scope"]: row["right"] for row in status_rows(study) if "right" in row} == pytest.approx(expected)
    chance = {row["scope"]: row["chance"] for row in rows if row["method"] == "rings" and row["home"] == "any"}
    assert {row["scope"]: row["chance"] for row in status_rows(study) if "right" in row} == pytest.approx(chance)
    alone = success_points(study)[1]["right, by similarity alone"]
    plain = [row["success@1"] for row in rows if row["method"] == "rings" and row["home"] == "any"]
    assert [mean for mean, _, _ in alone] == pytest.approx(plain)


def test_statuses_share_out_all_answers(study: Study) -> None:
    rows = status_rows(study)
    assert [row["scope"] for row in rows] == ["0m", "5m", "foreign 0m", "foreign 5m"]
    for row in rows:
        assert sum(float(row[name] or 0) for name in ("match", "ambiguous", "unknown")) == pytest.approx(1.0)


def test_each_failure_is_named_with_what_misled_it(study: Study) -> None:
    wrong = [judged for judged in study.answers if not judged.right]
    rows = failures(study, 0.0, 5.0)
    assert len(rows) == len(wrong) > 0
    for row, judged in zip(rows, wrong, strict=True):
        assert row["building"] == f"b{judged.building}"
        assert row["strangers"] == len(strangers(study, judged))
        there = at_truth(study, judged)
        if judged.found is None or there is None:
            continue
        parts = (judged.found.explained[0] - there.explained[0]).sum() + float(row["missing"] or 0)
        margin = float(row["fit"] or 0) - float(row["fit_there"] or 0)
        assert parts + float(row["walls"] or 0) == pytest.approx(margin, abs=0.05)


def test_objects_of_a_query_that_is_the_map_are_no_strangers(study: Study) -> None:
    assert all(not strangers(study, judged) for judged in study.answers if judged.building < 2)
    assert any(strangers(study, judged) for judged in study.answers if judged.building == 2)


def test_the_worst_answer_is_laid_where_it_says(study: Study) -> None:
    laid = worst(study, 0.0, 5.0)
    assert laid is not None
    assert laid.judged.found is not None
    wrong = [judged.probability for judged in study.answers if not judged.right and judged.found is not None]
    assert laid.judged.probability == max(wrong)
    # A turn and a shift keep distances.
    here, there = (np.concatenate(list(seen.values())) for seen in (laid.seen_here, laid.seen_there))
    np.testing.assert_allclose(
        np.linalg.norm(here - here[0], axis=1), np.linalg.norm(there - there[0], axis=1), atol=1e-6
    )
    # The robot stands as far from what it sees, wherever it is put.
    np.testing.assert_allclose(
        np.linalg.norm(here - laid.judged.truth[:2], axis=1), np.linalg.norm(there - laid.answer, axis=1), atol=1e-6
    )


def test_points_of_the_diagram_lie_within_their_intervals(study: Study) -> None:
    points = reliability_points(study.answers)
    assert points
    for said, so, low, high, share in points:
        assert 0 <= low <= so <= high <= 1
        assert 0 <= said <= 1
        assert 0 < share <= 1


def test_the_command_prints_and_draws(homes: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["trust", str(homes), "--walks", "1", "--pictures", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "wrong at 5 to 10 m" in result.output
    for name in ("reliability", "success", "failure"):
        assert (tmp_path / "out" / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_thresholds_accept_less_the_higher_they_are_and_agree_with_the_status(study: Study) -> None:
    rows = [row for row in threshold_rows(study) if row["scope"] == "5m"]
    accepted = [float(row["accepted"] or 0) for row in rows]
    assert accepted == sorted(accepted, reverse=True)
    status = next(row for row in status_rows(study) if row["scope"] == "5m")
    at = next(i for i, row in enumerate(rows) if row["method"] == f"p >= {ACCEPTED:g}")
    assert accepted[at] == status["match"]
    assert rows[at]["foreign_accepted"] == next(r for r in status_rows(study) if r["scope"] == "foreign 5m")["match"]


def test_conditions_share_out_all_answers(study: Study) -> None:
    rows = condition_rows(study, 0.0, 5.0)
    for kind in ("objects", "strangers", "b"):
        assert sum(int(r["queries"] or 0) for r in rows if str(r["scope"]).startswith(kind)) == len(study.answers)
