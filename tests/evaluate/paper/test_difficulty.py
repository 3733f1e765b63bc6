"""The generated office is as hard for bag of words as the paper's."""

import pytest

from semloc_core.evaluate.paper.difficulty import PAPER, evaluate_difficulty


def test_bag_of_words_scores_on_generated_offices_what_it_scores_in_the_paper() -> None:
    """One office differs from the next by 0.04 (deviation), so the mean of six is held to 0.04."""
    calls: list[tuple[int, int]] = []
    rows = evaluate_difficulty(
        world_seeds=range(6), split_seeds=(0,), progress=lambda done, total, words: calls.append((done, total))
    )
    assert [row["scope"] for row in rows] == [*(f"world {seed}" for seed in range(6)), "all", "paper, test"]
    mean = rows[-2]
    assert mean["pr_auc"] == pytest.approx(sum(float(row["pr_auc"] or 0) for row in rows[:6]) / 6)
    for figure in ("pr_auc", "f1"):
        assert abs(float(mean[figure] or 0) - float(PAPER[figure] or 0)) < 0.04, figure
    assert calls[-1] == (6, 6)
