"""What `docs/python.md` promises of `from semloc_core import …`: programs run, the names are there."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from small_building import building_update, delta, make_map, make_model

import semloc_core
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.sources import write_run
from semloc_core.sources.hydra import write_hydra

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
PROGRAMS = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
SAID = [r"match|ambiguous", r'"why_not"', r"\('building', 'run'\)", r"expected|Object"]


class Step:
    position, heading = (5.0, 0.0, 0.0), 0.0

    def __init__(self, update):
        self.update = update


@pytest.fixture
def files(tmp_path, monkeypatch, small_worlds):
    """What the programs are given, in the folder where they run."""
    monkeypatch.chdir(tmp_path)
    make_map(tmp_path / "building.map", make_model("rings"), building=building_update())
    write_run("run.mcap", [Step(building_update()), Step(delta(1, query="p9"))])
    write_hydra("building.json", small_worlds[0].graph, small_worlds[0].labelspace)


@pytest.mark.parametrize(("program", "said"), list(zip(PROGRAMS, SAID, strict=True)))
def test_the_programs_run(files, capsys, program, said):
    assert "from semloc_core." not in program, "only what is public is shown"
    exec(program, {"my_graphs": [SceneGraph.from_update(building_update())]})
    assert re.search(said, capsys.readouterr().out)


def test_the_page_names_what_there_is():
    shown = set(re.findall(r"`(\w+)`", PAGE[: PAGE.index("Each of the four")])) - {"semloc_core"}
    assert shown == set(semloc_core.__all__)


def test_a_type_checker_sees_the_names(tmp_path):
    """They come when they are asked for; that must not make them ``Any``."""
    (tmp_path / "use.py").write_text(
        "from semloc_core import Localiser, load_map, read_run\n"
        "reveal_type(load_map)\nreveal_type(read_run)\nLocaliser(3)\n"
    )
    words = [sys.executable, "-m", "mypy", "--config-file=", "--strict", "--follow-imports=silent"]
    found = {**os.environ, "MYPYPATH": str(ROOT)}
    done = subprocess.run([*words, "use.py"], cwd=tmp_path, env=found, capture_output=True, text=True, check=False)
    assert "LoadedMap" in done.stdout
    assert "Iterator" in done.stdout
    assert 'Argument 1 to "Localiser" has incompatible type "int"' in done.stdout
