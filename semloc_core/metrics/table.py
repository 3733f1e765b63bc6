"""Rows on screen and rows as JSON: both come from the same rows, so that neither can say what the other does not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
from rich.console import Console
from rich.table import Table

from semloc_core.metrics.rows import Row

KEYS = ("method", "scope")
STD, LOW, HIGH = "_std", "_low", "_high"


def document(command: str, seed: int, inputs: Sequence[str], rows: Sequence[Row]) -> bytes:
    """The contract's JSON: ``{"command", "seed", "inputs", "rows"}``, indented; a figure that is NaN becomes null."""
    plain = [{name: _finite(value) for name, value in row.items()} for row in rows]
    content = {"command": command, "seed": seed, "inputs": list(inputs), "rows": plain}
    return msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n"


def columns(rows: Sequence[Row]) -> list[str]:
    """Names of the columns: of all rows, in the order met, without what is shown in another's cell."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    shown = set(names)
    parts = {f"{name}{suffix}" for name in names for suffix in (STD, LOW, HIGH)} & shown
    return [name for name in names if name not in parts]


def cell(row: Row, name: str) -> str:
    """A figure with its deviation (``±``) or its interval (``[low, high]``) where the row has one."""
    text = _text(row.get(name))
    if f"{name}{STD}" in row:
        text += f" ± {_text(row[name + STD])}"
    if f"{name}{LOW}" in row and f"{name}{HIGH}" in row:
        text += f" [{_text(row[name + LOW])}, {_text(row[name + HIGH])}]"
    return text


def print_table(rows: Sequence[Row], *, title: str, console: Console) -> None:
    """Print rows; figures that do not fit the console's width go into a further table with the same first columns.

    Args:
        rows: flat rows.
        title: heading.
        console: where to.

    """
    names = columns(rows)
    keys = [name for name in names if name in KEYS or _is_text(rows, name)]
    figures = [name for name in names if name not in keys]
    width = {name: max(len(name), *(len(cell(row, name)) for row in rows)) + 3 for name in names}
    room = console.width - 1 - sum(width[name] for name in keys)
    blocks: list[list[str]] = [[]]
    used = 0
    for name in figures:
        if blocks[-1] and used + width[name] > room:
            blocks.append([])
            used = 0
        blocks[-1].append(name)
        used += width[name]
    for number, block in enumerate(blocks):
        table = Table(title=title if number == 0 else None)
        for name in keys:
            table.add_column(name, no_wrap=True)
        for name in block:
            table.add_column(name, justify="right", no_wrap=True)
        for row in rows:
            table.add_row(*(cell(row, name) for name in (*keys, *block)))
        if names:  # a figure that a narrow screen cuts off is a wrong figure
            table.width = 1 + sum(width[name] for name in (*keys, *block))
        console.print(table, crop=False)


def _is_text(rows: Sequence[Row], name: str) -> bool:
    return any(isinstance(row.get(name), str) for row in rows)


def _text(value: str | int | float | None) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return "–" if math.isnan(value) else f"{value:.3f}"
    return str(value)


def _finite(value: str | int | float | None) -> str | int | float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value
