"""``semloc introspect`` from a graph file to one page and its figures."""

import json
import re
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from semloc_core.cli import main
from semloc_core.sources.world import OfficeConfig, make_office, write_world


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The command's page and figures on an office of few places, after a short training."""
    folder = tmp_path_factory.mktemp("study")
    sparse = OfficeConfig(spacing_m=(1.8, 2.2), max_edge_m=4.0)
    write_world(folder / "office.json", make_office(sparse, np.random.default_rng(1)))
    words = ["semloc", "introspect", str(folder / "office.json"), "-o", str(folder / "page.html")]
    words += ["--json", str(folder / "figures.json"), "--seeds", "2", "--steps", "2", "--places", "4"]
    before, sys.argv = sys.argv, words
    try:
        main()
        code = 0
    except SystemExit as stop:
        code = int(stop.code or 0)
    finally:
        sys.argv = before
    assert code == 0
    return (folder / "page.html").read_text(encoding="utf-8"), json.loads((folder / "figures.json").read_bytes())


class Found(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.sections, self.drawings, self.sentences = [], {}, {}

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag == "section" and "id" in given:
            self.sections.append(given["id"])
        elif tag == "svg":
            self.drawings[self.sections[-1]] = given["aria-label"]


def test_the_page_has_every_figure_of_the_paper(study):
    page, _ = study
    found = Found()
    found.feed(page)
    assert {"rankings", "importance", "shift", "fidelity", "agreement", "frequency", "hypotheses"} <= set(
        found.sections
    )
    assert {"plan", "matrices"} <= set(found.sections)
    assert {"importance", "shift", "fidelity", "plan", "matrices"} <= set(found.drawings)
    assert all(found.drawings.values())  # each picture says in words what it is
    assert page.count("<summary>The figures</summary>") == len(found.sections)  # each brings its own numbers


def test_the_page_asks_for_nothing(study):
    page, _ = study
    assert not re.search(r"<script|<link|src=[\"']?http|url\(http|@import", page)


def test_the_figures_are_those_of_the_table(study):
    _, figures = study
    rows = figures["rows"]
    table = [row for row in rows if row["scope"].startswith("run ")]
    assert {row["method"] for row in table} >= {"ablation", "saliency", "integrated_gradients", "attention"}
    for line in table:
        run = int(line["scope"].split()[1])
        ranked = {
            row["rank"]: row["scope"]
            for row in rows
            if row.get("run") == run and row["method"] == line["method"] and "rank" in row
        }
        assert {str(rank): name for rank, name in ranked.items()} == {k: line[k] for k in line if k.isdigit()}
    assert {row["run"] for row in rows if "budget" in row and "run" in row} == {1, 2}
    assert any("kendall_w" in row for row in rows)


def test_each_hypothesis_has_a_verdict_with_an_interval(study):
    page, figures = study
    rows = [row for row in figures["rows"] if "hypothesis" in row]
    assert {row["hypothesis"] for row in rows} == {1, 2, 3}
    for row in rows:
        low, high, null = row["figure_low"], row["figure_high"], row["null"]
        assert low is None or (row["verdict"] == "undecided") == (low <= null <= high)
        assert low is None or low <= row["figure"] <= high or row["verdict"] == "undecided"
    assert re.search(r"\(1\) [^;]*: (supported|refuted|undecided);", page)
