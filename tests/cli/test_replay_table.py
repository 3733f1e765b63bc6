"""The closing table of a replay: every figure once, at a glance."""

import io
from collections import Counter

from rich.console import Console

from semloc_core.cli.replay_table import print_summary
from semloc_core.replay.recorded import ReplaySummary


def row(scope: str, queries: int, right: float, precision: float | None = 0.9) -> dict[str, object]:
    figures = {
        "answered": 1.0,
        "success@1": right,
        "success@5": 0.8,
        "success@10": 1.0,
        "chance": 0.2,
        "accepted": 0.5,
    }
    return {"method": "rings", "scope": scope, "queries": queries, **figures, "precision": precision, "error_m": None}


def printed(summary: ReplaySummary, width: int = 80) -> list[str]:
    console = Console(file=io.StringIO(), width=width)
    print_summary("run.mcap against a.map", summary, console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def summary(**more: object) -> ReplaySummary:
    statuses = Counter(match=30, ambiguous=10)
    fixed = {"updates": 41, "statuses": statuses, "p50_ms": 12.34, "p99_ms": 56.7, "listed": 40, "calibrated": 40}
    return ReplaySummary(**{**fixed, **more})


def test_one_table_has_success_by_metres_status_calibration_and_latency() -> None:
    lines = printed(summary(rows=[row("0m", 15, 0.25, None), row("40m", 25, 0.75), row("all", 40, 0.5)]))
    assert [line.split() for line in lines[1:5]] == [
        ["metres", "walked", "0–5", "40–", "all"],
        ["answers", "15", "25", "40"],
        ["success@1", "0.250", "0.750", "0.500"],
        ["success@5", "0.800", "0.800", "0.800"],
    ]
    assert next(line for line in lines if line.startswith("by chance")).split() == [
        "by",
        "chance",
        "@1",
        *["0.200"] * 3,
    ]
    assert next(line for line in lines if line.startswith("right of accepted")).split()[3:] == ["0.900", "0.900"]
    assert "status             30 match (75%), 10 ambiguous (25%), of 41 updates" in lines
    assert "latency            12.3 ms median, 56.7 ms 99th percentile" in lines
    assert "probability        calibrated: the chance that the place is right" in lines
    assert not any(mark in line for line in lines for mark in "┃│…"), "no frame, nothing cut off"


def test_what_the_probabilities_are_worth_is_said() -> None:
    assert any("not calibrated" in line for line in printed(summary(calibrated=0)))
    assert any("calibrated in 7 of 40 answers" in line for line in printed(summary(calibrated=7)))
    assert any("no answer lists a place" in line for line in printed(summary(listed=0, calibrated=0)))


def test_one_answer_of_many_is_not_none_of_them_and_the_others_are_not_all() -> None:
    statuses = Counter(match=240, ambiguous=1)
    assert "status             240 match (>99%), 1 ambiguous (<1%), of 241 updates" in printed(
        summary(statuses=statuses, updates=241)
    )


def test_without_a_ground_truth_the_rest_is_still_said() -> None:
    lines = printed(summary())
    assert [line.split()[0] for line in lines] == ["run.mcap", "status", "probability", "latency"]


def test_a_narrow_screen_cuts_no_figure() -> None:
    rows = [row(f"{start}m", 1, 0.125) for start in (0, 5, 10, 20, 40)] + [row("all", 5, 0.125)]
    assert sum(line.count("0.125") for line in printed(summary(rows=rows), width=30)) == 6
