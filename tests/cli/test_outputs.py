"""A file that can't be written is refused before the work that it is to keep, which may be an hour's."""

import pytest


@pytest.mark.parametrize(
    "words",
    [
        ("train", "{graph}", "-o", "{out}"),
        ("train", "{graph}", "-o", "{fine}", "--curve", "{out}"),
        ("train", "{graph}", "-o", "{fine}", "--resume", "{out}"),
        ("train", "{graph}", "-o", "{fine}", "--json", "{out}"),
        ("introspect", "{graph}", "-o", "{out}"),
        ("introspect", "{graph}", "--keep", "{out}"),
        ("evaluate", "online", "{folder}", "--json", "{out}"),
        ("evaluate", "office", "{graph}", "--json", "{out}"),
        ("explain", "a.map", "{graph}", "--json", "{out}"),
        ("report", "replay", "a.mcap", "--map", "a.map", "-o", "{out}"),
        ("report", "picture", "a.mcap", "--map", "a.map", "-o", "{out}"),
        ("world", "office", "-o", "{out}"),
    ],
)
def test_an_output_that_is_none_is_refused_first(semloc, write_corridor, tmp_path, words) -> None:
    graph = write_corridor(tmp_path / "home.json", ["chair", "couch"])
    nowhere = tmp_path / "no" / "such" / "file"
    for out, why in ((tmp_path, "which is a folder"), (nowhere, "in a folder that exists")):
        names = {"graph": graph, "out": out, "fine": tmp_path / "fine", "folder": tmp_path}
        result = semloc(*(word.format(**names) for word in words))
        assert result.code == 2, result.out
        assert len(result.err.splitlines()) == 1, result.err
        assert str(out) in result.err
        assert why in result.err
    assert {path.name for path in tmp_path.iterdir()} == {"home.json"}, "nothing was begun"


@pytest.mark.parametrize("option", ["--json", "-o"])
def test_an_input_by_any_name_is_no_output(semloc, write_corridor, tmp_path, option) -> None:
    graph = write_corridor(tmp_path / "home.json", ["chair", "couch"])
    (tmp_path / "hard.json").hardlink_to(graph)
    (tmp_path / "soft.json").symlink_to(graph)
    before = graph.read_bytes()
    command = ("evaluate", "office", graph) if option == "--json" else ("bag", "simulate", graph)
    for name in ("home.json", "hard.json", "soft.json"):
        said = semloc(*command, option, tmp_path / name, "--force")
        assert (said.code, len(said.err.splitlines())) == (2, 1), said
        assert "to be no input" in said.err
        how = "which is read" if name == "home.json" else f"which is {graph}, which is read"
        assert said.err.endswith(f"(got {tmp_path / name}, {how})\n")
        assert graph.read_bytes() == before


def test_what_is_there_takes_force_and_the_same_kind(semloc, write_corridor, tmp_path) -> None:
    graph, run = write_corridor(tmp_path / "home.json", ["chair", "couch"]), tmp_path / "run.mcap"
    other = write_corridor(tmp_path / "other.json", ["chair"])
    assert semloc("bag", "simulate", graph, "-o", run).code == 0
    first = run.read_bytes()
    assert "--force" in semloc("bag", "simulate", graph, "--seed", "3", "-o", run).err
    assert run.read_bytes() == first
    assert semloc("bag", "simulate", graph, "--seed", "3", "-o", run, "--force").code == 0
    assert "which is a scene graph" in semloc("bag", "simulate", graph, "-o", other, "--force").err
    assert semloc("bag", "simulate", graph, "-o", tmp_path / "folder").code == 0
