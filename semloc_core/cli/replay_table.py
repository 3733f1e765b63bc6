"""What ``semloc replay`` prints at the end: how right, by metres walked; what was answered; how long it took."""

from __future__ import annotations

from rich.console import Console

from semloc_core.cli.shared.screen import many, plain_table, print_whole
from semloc_core.replay import FROM_METRES, ReplaySummary
from semloc_core.text import percent

MEASURES = {
    "queries": "answers",
    "success@1": "success@1",
    "success@5": "success@5",
    "success@10": "success@10",
    "chance": "by chance @1",
    "accepted": "accepted (match)",
    "precision": "right of accepted",
    "wrong_storey": "wrong storey (match)",
    "error_m": "place: distance off (m), median",
    "position_error_m": "pose: position error (m), median",
    "position_error_m_p90": "pose: position error (m), 90 %",
    "heading_error_deg": "pose: heading error (°), median",
    "heading_error_deg_p90": "pose: heading error (°), 90 %",
    "nees": "pose: NEES",
    "coverage": "pose: 95 % region holds truth",
}
"""Figure of a row -> what it is called on screen, in this order."""
ERRORS = "the mapped place that is named, and where the robot is said to stand: errors of right answers"
_STARTS = [f"{start:g}m" for start in FROM_METRES]


def print_summary(title: str, summary: ReplaySummary, console: Console) -> None:
    """Print a replay's summary as one table: a line a measure, a column for every stretch of the way.

    Args:
        title: which run, against which map.
        summary: of the replay.
        console: where to.

    """
    console.print(title, markup=False)
    if summary.rows:
        table = plain_table()
        table.add_column("metres walked")
        for row in summary.rows:
            table.add_column(_stretch(str(row["scope"])), justify="right")
        for figure, name in MEASURES.items():
            table.add_row(name, *(_cell(row.get(figure)) for row in summary.rows))
        print_whole(table, console)
    answers = sum(summary.statuses.values())
    counts = summary.statuses.most_common()
    statuses = ", ".join(f"{count} {name} ({percent(count / answers)})" for name, count in counts)
    if summary.rows:
        console.print(f"{'place, pose':18s} {ERRORS}", markup=False)
    for name, text in (
        ("status", f"{statuses or 'no answer'}, of {many(summary.updates, 'update')}"),
        ("probability", _calibrated(summary)),
        ("latency", f"{summary.p50_ms:.1f} ms median, {summary.p99_ms:.1f} ms 99th percentile"),
    ):
        console.print(f"{name:18s} {text}", markup=False)


def _stretch(scope: str) -> str:
    """``5–10`` of a bracket that begins at ``5m``, ``40–`` of the last."""
    if scope not in _STARTS:
        return scope
    after = _STARTS.index(scope) + 1
    return f"{scope[:-1]}–{_STARTS[after][:-1] if after < len(_STARTS) else ''}"


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def _calibrated(summary: ReplaySummary) -> str:
    meaning = "the chance that the place is right"
    if summary.calibrated == summary.listed:
        return f"calibrated: {meaning}" if summary.listed else "none: no answer lists a place"
    if not summary.calibrated:
        return f"not calibrated: it ranks answers, but is not {meaning}"
    return f"calibrated in {summary.calibrated} of {summary.listed} answers: {meaning}"
