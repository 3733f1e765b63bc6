"""What a reader of a page has before its first command: the files that it is about."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
from doc_blocks import ROOT, fences

from semloc_core.sources import KINDS, draw_pair

CELL_M = 0.1
CLEAR_M = 0.6
"""What is painted free around every place of a home."""


def prepare(page: str, folder: Path) -> None:
    """Make the files that a page takes to be there, in the folder where its commands run."""
    if page == "without_hydra.md":
        _nav2_map(folder)
    elif page == "inputs.md":
        _run_without_ros(folder)


def _nav2_map(folder: Path) -> None:
    """``home.yaml`` with its picture, and ``objects.csv``: a generated home as nav2 and a list have it."""
    graph = draw_pair(KINDS["home"], np.random.default_rng(0))[0].graph
    at = np.array(list(graph.places.values()))[:, :2]
    low = at.min(axis=0) - 1.0
    wide, high = np.ceil((at.max(axis=0) + 1.0 - low) / CELL_M).astype(int)
    x, y = np.meshgrid((np.arange(wide) + 0.5) * CELL_M + low[0], (np.arange(high) + 0.5) * CELL_M + low[1])
    free = np.zeros((high, wide), dtype=bool)
    for place in at:
        free |= np.hypot(x - place[0], y - place[1]) < CLEAR_M
    cells = np.where(free[::-1], 254, 0).astype(np.uint8)
    (folder / "home.pgm").write_bytes(f"P5\n{wide} {high}\n255\n".encode() + cells.tobytes())
    words = f"image: home.pgm\nresolution: {CELL_M}\norigin: [{low[0]}, {low[1]}, 0.0]\nnegate: 0\n"
    (folder / "home.yaml").write_text(words + "occupied_thresh: 0.65\nfree_thresh: 0.196\n")
    with (folder / "objects.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("class", "x", "y", "z"))
        rows.writerows((one.class_, *(round(v, 2) for v in one.position)) for one in graph.objects.values())


def _run_without_ros(folder: Path) -> None:
    """``run.jsonl``, by the program on the page."""
    program = next(text for _, kind, text, _ in fences(ROOT / "docs" / "inputs.md") if kind == "python")
    before = Path.cwd()
    os.chdir(folder)
    try:
        exec(program, {})
    finally:
        os.chdir(before)
