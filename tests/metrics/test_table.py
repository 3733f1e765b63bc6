"""Rows on screen and as JSON."""

import io
import json

from rich.console import Console

from semloc_core.metrics.rows import Row
from semloc_core.metrics.table import cell, columns, document, print_table

ROWS: list[Row] = [
    {
        "method": "paper",
        "loss": "infonce",
        "scope": "test",
        "pr_auc": 0.71849,
        "pr_auc_std": 0.02,
        "queries": 130,
    },
    {
        "method": "rings",
        "loss": None,
        "scope": "all",
        "success@1": 0.9,
        "success@1_low": 0.8,
        "success@1_high": 1.0,
    },
    {"method": "rings", "loss": None, "scope": "empty", "pr_auc": float("nan")},
]


def printed(rows: list[Row], width: int) -> str:
    console = Console(file=io.StringIO(), width=width)
    print_table(rows, title="Table II", console=console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_the_document_is_the_contracts() -> None:
    text = document("evaluate office", 3, ["office.json"], ROWS)
    content = json.loads(text)
    assert list(content) == ["command", "seed", "inputs", "rows"]
    assert (content["command"], content["seed"], content["inputs"]) == ("evaluate office", 3, ["office.json"])
    assert content["rows"][0] == ROWS[0]
    assert content["rows"][2]["pr_auc"] is None  # JSON has no NaN
    assert text.endswith(b"\n")


def test_deviation_and_interval_stand_in_the_figures_cell() -> None:
    assert cell(ROWS[0], "pr_auc") == "0.718 ± 0.020"
    assert cell(ROWS[1], "success@1") == "0.900 [0.800, 1.000]"
    assert cell(ROWS[0], "queries") == "130"
    assert cell(ROWS[1], "loss") == cell(ROWS[2], "pr_auc") == cell(ROWS[2], "queries") == "–"
    assert columns(ROWS) == ["method", "loss", "scope", "pr_auc", "queries", "success@1"]


def test_a_narrow_screen_gets_every_figure_in_further_tables() -> None:
    wide, narrow = printed(ROWS, 160), printed(ROWS, 60)
    assert wide.count("method") == 1
    assert narrow.count("method") > 1
    assert all(len(line) <= 60 for line in narrow.splitlines())
    for text in ("Table II", "0.718 ± 0.020", "0.900 [0.800, 1.000]", "130"):
        assert text in wide
        assert text in narrow


def test_a_figure_wider_than_the_screen_is_not_cut_off() -> None:
    """`0.900 [0.800, 1.0…` is another figure."""
    text = printed(ROWS, 30)
    assert "0.900 [0.800, 1.000]" in text
    assert "…" not in text


def test_no_rows_print_an_empty_table() -> None:
    assert "Table II" in printed([], 80) or printed([], 80).strip() == ""
