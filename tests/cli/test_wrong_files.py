"""Every command, given for each of its inputs what is no such thing: one line and exit status 2, never a traceback."""

from pathlib import Path

import pytest

COMMANDS = [
    ("train", "X", "-o", "{new}"),
    ("train", "{graph}", "-o", "{new}", "--start", "X"),
    ("train", "{graph}", "-o", "{new}", "--labelspace", "X"),
    ("introspect", "X"),
    ("map", "build", "X", "-o", "{new}"),
    ("map", "build", "{graph}", "--model", "X", "-o", "{new}"),
    ("map", "build", "{graph}", "--synonyms", "X", "-o", "{new}"),
    ("map", "add", "X", "{graph}"),
    ("map", "add", "{map}", "X", "--name", "b"),
    ("map", "replace", "{map}", "X", "--name", "home"),
    ("map", "remove", "X", "home"),
    ("map", "merge", "{map}", "X"),
    ("map", "info", "X"),
    ("map", "push", "X", "milvus+http://127.0.0.1:1/a"),
    ("map", "pull", "X", "{new}"),
    ("map", "sweep", "X"),
    ("bag", "simulate", "X", "-o", "{new}"),
    ("replay", "X", "--map", "{map}"),
    ("replay", "run.mcap", "--map", "X"),
    ("explain", "X", "{graph}", "--near", "0,0"),
    ("explain", "{map}", "X", "--near", "0,0"),
    ("evaluate", "office", "X"),
    ("evaluate", "relocalise", "X"),
    ("evaluate", "online", "X"),
    ("evaluate", "candidates", "X"),
    ("evaluate", "layout", "X"),
    ("evaluate", "merge", "X"),
    ("evaluate", "trust", "X"),
    ("report", "replay", "X", "--map", "{map}", "-o", "{new}"),
    ("report", "replay", "run.mcap", "--map", "X", "-o", "{new}"),
    ("report", "study", "X", "-o", "{new}"),
    ("report", "picture", "X", "--map", "{map}", "-o", "{new}"),
]


@pytest.fixture(scope="module")
def wrong(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("wrong")
    made = {name: folder / name for name in ("folder", "empty", "empty.json", "empty.mcap", "text.txt", "zeros.map")}
    made["folder"].mkdir()
    for name, content in (("empty", ""), ("empty.json", ""), ("empty.mcap", ""), ("text.txt", "a: [1\n")):
        made[name].write_text(content)
    made["zeros.map"].write_bytes(bytes(4096))
    return made | {"missing": folder / "missing.json"}


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: " ".join(words).replace("{", "").replace("}", ""))
def test_what_is_no_input_is_one_line(semloc, write_corridor, wrong, tmp_path, words) -> None:
    graph, map_file = write_corridor(tmp_path / "home.json", ["chair", "couch"]), tmp_path / "home.map"
    if "{map}" in words:
        assert semloc("map", "build", graph, "-o", map_file).code == 0
    names = {"graph": graph, "map": map_file, "new": tmp_path / "new"}
    for kind, path in wrong.items():
        said = semloc(*(str(path) if word == "X" else word.format(**names) for word in words))
        assert said.code == 2, (kind, said.out)
        assert len(said.err.splitlines()) == 1, (kind, said.err)
        assert said.err.startswith("semloc: "), (kind, said.err)
        assert not (tmp_path / "new").exists(), kind
