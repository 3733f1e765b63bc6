"""Long rows as small tables: every figure in its line and column, and none from nowhere."""

import io

from rich.console import Console

from semloc_core.cli.shared.screen import print_pivot
from semloc_core.metrics.pivot import Pivot, online_pivots
from semloc_core.metrics.rows import Row


def row(method: str, scope: str, filter_: str = "none", home: str = "any", **figures: float | None) -> Row:
    return {"method": method, "filter": filter_, "home": home, "scope": scope, "queries": 4, **figures}


ROWS: list[Row] = [
    row("rings", "0m", **{"success@1": 0.1, "success@1_low": 0.0, "success@1_high": 0.2, "success@5": 0.9}),
    row("rings", "10m", **{"success@1": 0.2}),
    row("rings", "0m", "bayes", **{"success@1": 0.3}),
    row("rings", "10m", home="known", **{"success@1": 0.4}),
    row("rings + layout", "10m", **{"success@1": 0.5, "ece": 0.05}),
    row("rings", "foreign 10m", foreign_accepted=0.6, wrong_accepted=float("nan")),
    row("rings", "foreign 20m", foreign_accepted=0.7, wrong_accepted=0.8),
    row("rings", "kidnapped", metres_until_right=1.5, metres_until_right_p90=float("inf"), recovered=0.9),
    row("agreeing places", "10m", **{"success@1": 0.95, "agreeing": 12.0}),
]


def test_each_figure_has_a_table_of_methods_by_metres_walked() -> None:
    found = {pivot.title.split(":")[0]: pivot for pivot in online_pivots(ROWS)}
    assert found["success@1, every building searched"].columns == ["0 m", "10 m"]
    assert found["success@1, every building searched"].lines == {
        "rings": {"0 m": 0.1, "10 m": 0.2},
        "rings, filter": {"0 m": 0.3},
        "rings + layout": {"10 m": 0.5},
        "agreeing places": {"10 m": 0.95},
    }
    assert found["success@1, building known"].lines == {"rings": {"10 m": 0.4}}
    assert found["calibration error, every building searched"].lines == {"rings + layout": {"10 m": 0.05}}
    assert found["foreign accepted"].lines == {"rings": {"10 m": 0.6, "20 m": 0.7}}
    assert found["wrong accepted"].lines == {"rings": {"20 m": 0.8}}, "NaN is no figure"
    assert found["carried away"].lines == {"rings": {"median": 1.5, "90 %": float("inf"), "recovered": 0.9}}


def test_tables_without_figures_are_left_out() -> None:
    assert [pivot.title for pivot in online_pivots(ROWS[:1])] == ["success@1, every building searched"]
    assert online_pivots([]) == []


def test_a_pivot_is_printed_whole_with_empty_cells_where_there_is_no_figure() -> None:
    pivot = Pivot("success@1")
    for method, metres, figure in (("a method of a long name", "0 m", 0.25), ("b", "10 m", 1.0)):
        pivot.put(method, metres, figure)
    console = Console(file=io.StringIO(), width=20)
    print_pivot(pivot, console)
    assert isinstance(console.file, io.StringIO)
    lines = [line.rstrip() for line in console.file.getvalue().splitlines()]
    assert lines[-2:] == ["a method of a long name  0.250", "b                               1.000"]


def test_columns_go_by_the_metres_also_where_the_first_method_has_no_figure_at_the_start() -> None:
    rows = [
        {"method": method, "scope": scope, "home": "any", "success@1": 0.5}
        for method, scope in (("a", "20m"), ("b", "0m"), ("b", "5m"), ("b", "20m"))
    ]
    assert online_pivots(rows)[0].columns == ["0 m", "5 m", "20 m"]
