"""Names are a person's words: what looks like a screen's markup or an emoji is printed as it is."""

import io

import pytest
from rich.console import Console

from semloc_core.cli.shared import common
from semloc_core.cli.shared.common import progress, show

NAMES = ("[/hq]", "[hq]", ":smile: x", "[red]floor[/red] 2")


@pytest.mark.parametrize("name", NAMES)
def test_a_building_of_any_name_is_built_changed_and_told_of(semloc, write_corridor, tmp_path, name) -> None:
    graph, map_file = write_corridor(tmp_path / "a.json", ["chair", "couch", "bed"]), tmp_path / "[hq] :smile:.map"
    built = semloc("map", "build", graph, "--name", name, "-o", map_file)
    assert built.code == 0, built.err
    assert built.out == f"{map_file}: 3 places in 1 building\n"
    told = semloc("map", "info", map_file, "--long")
    assert told.out.startswith("[hq] :smile:: 1 building, 3 places, 3 objects of 3 classes\n")
    assert f"\n{name}  " in told.out
    assert f"objects     {name}: " in told.out
    asked = semloc("explain", map_file, graph, "--near", "0,0", "--long", "--methods", "class_shapley")
    assert asked.code == 0, asked.err
    assert asked.out.count(f"{name}") >= 2, asked.out
    replaced = semloc("map", "replace", map_file, graph, "--name", name)
    assert replaced.out == f"{name}: 3 places replaced\n"
    assert semloc("map", "remove", map_file, name).out == f"{name}: removed\n"


@pytest.mark.parametrize("name", NAMES)
def test_tables_and_bars_print_it_too(capsys, monkeypatch, name) -> None:
    show("x", 0, [], [{"method": name, "scope": "all", name: 0.5}], None, title=name)
    assert capsys.readouterr().out.count(name) == 3
    screen = io.StringIO()
    to_screen = {"stderr": False, "file": screen, "force_terminal": True, "width": 99}
    monkeypatch.setattr(common, "Console", lambda **words: Console(**{**words, **to_screen}))
    with progress(name) as bar:
        bar(1, 2, name)
    assert name in screen.getvalue()
