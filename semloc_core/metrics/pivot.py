"""Long rows as small tables: a line a method, a column for the metres walked, or for the size of the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from semloc_core.metrics.rows import Row
from semloc_core.text import short_repr

FOREIGN, KIDNAPPED = "foreign ", "kidnapped"


@short_repr
@dataclass(frozen=True)
class Pivot:
    """One figure of many rows.

    Args:
        title: what the figure is.
        columns: headings, in order.
        lines: method -> column -> figure; a figure that a method has none of is not there.

    """

    title: str
    columns: list[str] = field(default_factory=list)
    lines: dict[str, dict[str, float]] = field(default_factory=dict)

    def put(self, method: str, column: str, figure: object) -> None:
        """Keep a figure; None and NaN are none."""
        if isinstance(figure, int | float) and not math.isnan(figure):
            if column not in self.columns:
                self.columns.append(column)
            self.lines.setdefault(method, {})[column] = float(figure)


def online_pivots(rows: Sequence[Row]) -> list[Pivot]:
    """The rows of `evaluate.online.protocol.evaluate_online` as small tables, those without figures left out.

    Their columns are the metres walked, save of the last, on kidnapped robots.
    """
    any_home = Pivot("success@1, every building searched")
    known = Pivot("success@1, building known")
    error = Pivot("calibration error, every building searched")
    paired = {
        "gain": Pivot("success@1 above the peer's, on the same walks"),
        "gain_low": Pivot("lower end of its 95 % interval"),
        "gain_high": Pivot("upper end of its 95 % interval"),
        "cpu_ms": Pivot("CPU time an answer (ms), median"),
    }
    posed = {
        "position_error_m": Pivot("position error (m) of right answers, median"),
        "position_error_m_p90": Pivot("position error (m) of right answers, 90 %"),
        "heading_error_deg": Pivot("heading error (degrees) of right answers, median"),
        "heading_error_deg_p90": Pivot("heading error (degrees) of right answers, 90 %"),
        "nees": Pivot("NEES of right answers, a degree of freedom: x, y, heading"),
        "coverage": Pivot("right answers whose 95 % region holds the truth"),
    }
    foreign = Pivot("foreign accepted: answers in a building that is not searched, 90 % of the right ones kept")
    wrong = Pivot("wrong accepted: wrong answers in a building that is searched, 90 % of the right ones kept")
    agreeing = Pivot("places that agree with all seen so far, median")
    kidnapped = Pivot("carried away: metres until right again")
    for row in rows:
        method, scope = str(row["method"]), str(row["scope"])
        method += ", filter" if row.get("filter") == "bayes" else ""
        if scope == KIDNAPPED:
            for column, name in (
                ("median", "metres_until_right"),
                ("90 %", "metres_until_right_p90"),
                ("recovered", "recovered"),
            ):
                kidnapped.put(method, column, row.get(name))
            continue
        metres = scope.removeprefix(FOREIGN).removesuffix("m") + " m"
        (any_home if row.get("home") == "any" else known).put(method, metres, row.get("success@1"))
        error.put(method, metres, row.get("ece"))
        for name, pivot in (*paired.items(), *posed.items()):
            pivot.put(method, metres, row.get(name))
        foreign.put(method, metres, row.get("foreign_accepted"))
        wrong.put(method, metres, row.get("wrong_accepted"))
        agreeing.put(method, metres, row.get("agreeing"))
    found = (any_home, known, *paired.values(), error, *posed.values(), foreign, wrong, agreeing, kidnapped)
    for pivot in found[:-1]:  # a scope may have no figure of the first method
        pivot.columns.sort(key=lambda column: float(column.removesuffix(" m")))
    return [pivot for pivot in found if pivot.lines]


def update_pivots(rows: Sequence[Row]) -> list[Pivot]:
    """The rows of `benchmark.bench_update` as small tables, whose columns are the buildings of the map."""
    found = {
        "cpu_ms": Pivot("CPU time of an update (ms), median"),
        "cpu_p99_ms": Pivot("CPU time of an update (ms), 99 %"),
        "p50_ms": Pivot("by the clock (ms), median"),
        "p99_ms": Pivot("by the clock (ms), 99 %"),
        "ratio": Pivot("CPU time, median, over that of the whole update"),
        "per_s": Pivot("answers a second of the core's time"),
        "open_s": Pivot("the map is opened in (s)"),
    }
    for row in rows:
        for name, pivot in found.items():
            whose = "map" if name == "open_s" else str(row["method"])
            pivot.put(whose, f"{row['buildings']:,}", row.get(name))
    return [pivot for pivot in found.values() if pivot.lines]


def shortlist_pivots(rows: Sequence[Row]) -> list[Pivot]:
    """The rows of `evaluate.evaluate_shortlist` as small tables, whose columns are the metres walked."""
    found = {"listed": Pivot("the robot's building is on the list"), "places": Pivot("places on the list, mean")}
    for row in rows:
        for name, pivot in found.items():
            pivot.put(str(row["method"]), str(row["scope"]).removesuffix("m") + " m", row[name])
    return [pivot for pivot in found.values() if pivot.lines]
