"""The ablation of verification: every variant is asked the same, and the parts do something."""

from pathlib import Path

import numpy as np
import pytest

from semloc_core.evaluate.online.layout_ablation import VARIANTS, evaluate_layout
from semloc_core.sources.world import KINDS, draw_pair, write_world


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("homes")
    rng = np.random.default_rng(11)
    for name in "ab":
        (folder / name).mkdir()
        for part, world in zip(("map", "query"), draw_pair(KINDS["home"], rng), strict=True):
            write_world(folder / name / f"{part}.json", world)
    return folder


def test_each_variant_has_a_row_a_distance_and_the_whole_is_good(root: Path) -> None:
    calls: list[tuple[int, int]] = []
    rows = evaluate_layout(root, walks=2, scopes_m=(0.0, 10.0), progress=lambda d, n, _: calls.append((d, n)))
    assert {(row["method"], row["scope"]) for row in rows} == {(n, s) for n in VARIANTS for s in ("0m", "10m")}
    assert len({row["queries"] for row in rows}) == 1
    found = {row["method"]: float(row["success@1"] or 0) for row in rows if row["scope"] == "10m"}
    assert found["layout"] > 0.7
    assert len(set(found.values()) | {float(r["success@1"] or 0) for r in rows if r["scope"] == "0m"}) > 1
    assert calls[0] == (0, len(VARIANTS))
    assert calls[-1] == (len(VARIANTS), len(VARIANTS))
