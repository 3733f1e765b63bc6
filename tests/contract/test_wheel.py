"""A wheel has all that the package has, and what it ships is read from it, away from the clone."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from small_building import building_update, delta

from semloc_core import wire

ROOT = Path(__file__).parents[2]
TOOLS = ("scipy", "sklearn", "matplotlib", "PIL", "spark_dsg", "faiss", "pymilvus")
"""What the extras bring."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built of a copy, so that nothing is left in the clone."""
    pytest.importorskip("setuptools.build_meta")
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    shutil.copytree(ROOT / "semloc_core", source / "semloc_core", ignore=shutil.ignore_patterns("__pycache__"))
    build = f"from setuptools import build_meta; build_meta.build_wheel({str(folder)!r})"
    done = subprocess.run([sys.executable, "-c", build], cwd=source, capture_output=True, text=True, check=False)
    if "invalid pyproject.toml config" in done.stderr + done.stdout:
        pytest.skip("setuptools is older than what builds the package")
    assert done.returncode == 0, done.stderr
    (found,) = folder.glob("*.whl")
    return found


def test_a_wheel_has_every_file_of_the_package(wheel) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    there = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "semloc_core").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert there - inside == set()
    assert any(name.endswith("labelspaces/coco.yaml") for name in inside)
    assert zipfile.ZipFile(wheel).read("semloc_core/cli/demo_files/demo.map") == (ROOT / "models/demo.map").read_bytes()


def test_it_runs_away_from_the_clone(wheel, tmp_path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    away = {**os.environ, "PYTHONPATH": str(tmp_path / "site"), "OMP_NUM_THREADS": "1"}
    reads = (
        "import semloc_core, semloc_core.cli.demo as demo\n"
        "from semloc_core.graph.labels.label_sets import label_sets\n"
        "assert len(label_sets()['coco']) == 80\n"
        "assert len(semloc_core.load_map(demo.FILES / 'demo.map').buildings) == 2\n"
        "assert len(list(semloc_core.read_run(demo.FILES / 'demo_run.mcap'))) == 172\n"
        "print(semloc_core.__file__)"
    )
    for words in (("-c", reads), ("-m", "semloc_core", "demo", "--help")):
        found = subprocess.run([sys.executable, *words], cwd=tmp_path, env=away, capture_output=True, text=True)
        assert found.returncode == 0, found.stderr
        assert words[0] == "-m" or found.stdout.startswith(str(tmp_path)), found.stdout


def without(packages, words, folder, path):
    """Run a command where packages are not installed."""
    program = (
        "import sys\n"
        "class Absent:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name.split('.')[0] in {tuple(packages)!r}:\n"
        "            raise ModuleNotFoundError(f'No module named {name}', name=name)\n"
        "sys.meta_path.insert(0, Absent())\n"
        f"sys.argv = ['semloc', *{[*map(str, words)]!r}]\n"
        "from semloc_core.__main__ import command\n"
        "command()\n"
    )
    away = {**os.environ, "PYTHONPATH": str(path), "OMP_NUM_THREADS": "1"}
    return subprocess.run([sys.executable, "-c", program], cwd=folder, env=away, capture_output=True, text=True)


def test_the_demo_a_map_and_a_replay_need_no_extra(wheel, tmp_path) -> None:
    """From an empty folder, by the wheel."""
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    graph, run = building_update(query=None), tmp_path / "run.jsonl"
    run.write_bytes(b"\n".join(wire.encode(update) for update in (graph, *(delta(i, query=f"p{i}") for i in (3, 4)))))
    (tmp_path / "empty").mkdir()
    for words in (
        ("map", "build", run, "-o", "run.map"),
        ("map", "info", "run.map"),
        ("replay", run, "--map", "run.map", "-o", "results.mcap", "--synonyms", "auto"),
        ("report", "replay", "results.mcap", "--map", "run.map", "--run", run, "-o", "page.html"),
        ("demo",),
    ):
        done = without(TOOLS, words, tmp_path / "empty", tmp_path / "site")
        assert done.returncode == 0, (words, done.stderr)
    assert (tmp_path / "empty/semloc_demo/report.html").stat().st_size > 100_000


@pytest.mark.parametrize(("package", "words"), [("typer", ()), ("scipy", ("world", "office", "-o", "office.json"))])
def test_a_package_that_is_not_installed_is_named_in_a_line(tmp_path, package, words) -> None:
    """As where semloc was installed without the extra that a command needs."""
    done = without([package], words, tmp_path, ROOT)
    assert done.returncode == 2, done.stderr
    assert done.stderr == (
        f"semloc: expected the package {package!r} (got none: pip install 'semloc[tools]' has all that commands need)\n"
    )
