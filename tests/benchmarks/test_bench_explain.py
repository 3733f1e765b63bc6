"""The benchmark of explainers: all contenders run and agree on what they explain."""

import pytest
import torch

from semloc_core.benchmark.explain import bench_explain, make_case
from semloc_core.encoding.variants.copies import PaperCopies
from semloc_core.encoding.variants.removals import PaperRemovals
from semloc_core.explain.explainers.coalitions import all_coalitions


def test_the_case_is_the_one_described():
    case = make_case()
    assert (case.batch.n_nodes, case.query.n_objects, len(case.query.class_players[0])) == (60, 30, 6)


def test_all_contenders_agree_and_have_their_row():
    """Whoever is the faster is for the benchmark to say, not for a test; but all must have explained the same."""
    rows = {(row["scope"], row["method"]): row for row in bench_explain(1, slow=False)}
    gradients, shapley = sorted({scope for scope, _ in rows}, reverse=True)
    assert {method for scope, method in rows if scope == gradients} == {"semloc", "pyg"}
    assert {method for scope, method in rows if scope == shapley} == {"semloc, exact", "captum, 25 samples"}
    for row in rows.values():
        ours = next(r for (scope, method), r in rows.items() if scope == row["scope"] and method.startswith("semloc"))
        assert row["ratio"] == pytest.approx(row["cpu_ms"] / ours["cpu_ms"])
        assert row["ratio"] > 0
        assert 0 < row["p50_ms"] <= row["p99_ms"]


def test_the_fast_paths_are_taken():
    """A lost fast path would cost most of what the benchmark shows."""
    case = make_case()
    assert PaperCopies.fits(case.encoder, case.batch)
    classes = torch.from_numpy(all_coalitions(6)[:, case.query.class_players[1]])
    keep = torch.ones(64, case.batch.n_nodes, dtype=torch.bool)
    keep[:, case.query.rows] = classes
    table = PaperRemovals(case.encoder, case.batch, PaperCopies(case.encoder, case.batch)).table(keep)
    assert table is not None
    assert len(table.own) < 64 * case.batch.n_nodes / 2
