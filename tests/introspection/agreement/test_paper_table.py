"""The paper's Table IV as it is printed, and what it says of itself."""

import pytest

from semloc_core.introspection.agreement.paper_table import COUNTS, RANKINGS, is_ranking, main, paper_rows


def test_only_the_second_row_of_ablation_is_no_ranking():
    broken = [(m, run + 1) for m, texts in RANKINGS.items() for run, text in enumerate(texts) if not is_ranking(text)]
    assert broken == [("ablation", 2)]
    assert sum(COUNTS.values()) == 110


def test_what_the_table_says_of_itself():
    rows = {(row["method"], row["scope"]): row for row in paper_rows()}
    assert rows["ablation", "all runs"]["runs"] == 2
    assert rows["attention", "all runs"]["kendall_w"] == pytest.approx(1)
    # By hand: ranks of attention's importance against counts, Σ d² = 58.
    assert rows["attention", "all runs"]["frequency"] == pytest.approx(1 - 6 * 58 / 210)
    assert rows["integrated_gradients", "all runs"]["frequency"] > 0
    assert [rows["all explainers", f"run {r}"]["by_chance"] for r in (1, 2, 3)] == [0.25] * 3


def test_it_can_be_printed(capsys):
    main()
    assert "attention" in capsys.readouterr().out
