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
