"""Figure: how time and memory grow."""

from __future__ import annotations

import io
from collections.abc import Sequence

from semloc_core.metrics import Row


def growth_picture(rows: Sequence[Row]) -> bytes:
    """PNG of `semloc_core.benchmark.growth`: a column for each thing that grows, time above memory."""
    from matplotlib.figure import Figure

    scopes = list(dict.fromkeys(str(row["scope"]) for row in rows))
    figure = Figure(figsize=(3.2 * len(scopes), 5.0), layout="constrained")
    axes = figure.subplots(2, len(scopes), squeeze=False, sharex="col")
    for column, scope in enumerate(scopes):
        found = [row for row in rows if row["scope"] == scope]
        sizes = [float(row["size"] or 0) for row in found]
        for axis, name, label in (
            (axes[0, column], "cpu_ms", "CPU time of an update, ms"),
            (axes[1, column], "memory_mib", "memory besides the map, MiB"),
        ):
            axis.plot(sizes, [float(row[name] or 0) for row in found], marker="o", color="#1f6f8b")
            axis.set_xscale("log")
            axis.set_ylim(bottom=0)
            axis.grid(visible=True, alpha=0.3)
            if column == 0:
                axis.set_ylabel(label)
        axes[1, column].set_xlabel(scope)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()
