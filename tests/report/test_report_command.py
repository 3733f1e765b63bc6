import pytest
from replay_cases import one_map, walk, write_results
from typer.testing import CliRunner

from semloc_core.cli import app
from semloc_core.errors import BagError, SemlocError
from semloc_core.report.kept_page import keep
from semloc_core.report.page import Page, Section


def run(*arguments) -> str:
    result = CliRunner().invoke(app, ["report", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_page_and_picture_are_written(tmp_path):
    loaded, path = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, walk())
    assert "12 answers" in run("replay", results, "--map", path, "-o", tmp_path / "r.html")
    assert (tmp_path / "r.html").read_bytes().startswith(b"<!doctype html>")
    run("picture", results, "--map", path, "-o", tmp_path / "p.png")
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


def test_a_study_goes_on_the_same_page(tmp_path):
    loaded, path = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, walk())
    study = Page("why", ["Because."], [], [Section("rankings", "Which classes", "See.")], [], [])
    keep(study, tmp_path / "study.json")
    run("replay", results, "--map", path, "--study", tmp_path / "study.json", "-o", tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert 'id="data"' in text
    assert 'id="rankings"' in text
    run("study", tmp_path / "study.json", "-o", tmp_path / "s.html")
    assert 'id="rankings"' in (tmp_path / "s.html").read_text(encoding="utf-8")


def test_truth_can_come_from_the_run(tmp_path):
    loaded, path = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, walk(), truths=tmp_path / "run.mcap")
    run("replay", results, "--map", path, "--run", tmp_path / "run.mcap", "-o", tmp_path / "r.html")
    assert "67% right" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_a_picture_of_results_without_attributions_is_refused(tmp_path):
    loaded, path = one_map(tmp_path)
    steps = walk()
    for step in steps:
        step.shares = None
    results = write_results(tmp_path / "r.mcap", loaded, steps)
    with pytest.raises(BagError, match=r"expected an answer with attributions \(got none"):
        run("picture", results, "--map", path, "-o", tmp_path / "p.png")
    assert not (tmp_path / "p.png").exists()


@pytest.mark.parametrize("missing", ["results", "map"])
def test_missing_input_is_one_line(tmp_path, missing):
    loaded, path = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, walk())
    given = {"results": results, "map": path, missing: tmp_path / "nothing.mcap"}
    with pytest.raises(SemlocError, match=r"^expected [^\n]* \(got [^\n]*\)$"):
        run("replay", given["results"], "--map", given["map"], "-o", tmp_path / "r.html")
