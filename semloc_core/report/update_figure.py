"""Figure: what an update costs by how many buildings the map has."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from semloc_core.metrics import Row
from semloc_core.report.colours import styles
from semloc_core.report.drawing import bare, figure, to_png


def update_picture(rows: Sequence[Row]) -> bytes:
    """PNG of `benchmark.bench_update`: CPU time of one update against buildings, both on logarithmic axes.

    Rows of steps, whose methods begin with a dot, and of several robots are left out.
    """
    curves: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        own = str(row["method"])
        if own.startswith("·") or row.get("per_s") is not None:
            continue
        for name, time in ((own, "cpu_ms"), (f"{own}, 99 %", "cpu_p99_ms")):
            curves.setdefault(name, []).append((float(row["buildings"] or 0), float(row[time] or 0)))
    look = styles(list(curves))
    with figure(4.4) as drawn:
        axes = drawn.add_subplot()
        bare(axes)
        for name, points in curves.items():
            sizes, times = zip(*sorted(points), strict=True)
            axes.plot(sizes, times, ls=look[name].line, marker=look[name].marker, color=look[name].colour, label=name)
        axes.set_xscale("log")
        axes.set_yscale("log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(10, (1.0,) if axis is axes.xaxis else (1.0, 2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:,g}"))
            axis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("buildings in the map")
        axes.set_ylabel("CPU time of an update, ms")
        axes.legend(loc="upper left")
    return to_png(drawn)
