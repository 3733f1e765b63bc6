"""What is printed as done is done: a command that fails after half of its work undoes it, and says nothing of it."""

import pytest


@pytest.fixture
def map_file(semloc, write_corridor, tmp_path):
    graph = write_corridor(tmp_path / "a.json", ["chair", "couch", "bed"])
    assert semloc("map", "build", graph, "-o", tmp_path / "a.map").code == 0
    return tmp_path / "a.map"


def test_a_removal_that_fails_is_not_said_to_be_made(semloc, map_file) -> None:
    failed = semloc("map", "remove", map_file, "a", "nosuch")
    assert (failed.code, failed.out) == (2, "")
    assert semloc("map", "remove", map_file, "a").out == "a: removed\n"


def test_an_addition_that_fails_is_not_said_to_be_made(semloc, map_file, write_corridor, tmp_path) -> None:
    good = write_corridor(tmp_path / "b.json", ["chair", "tv"])
    failed = semloc("map", "add", map_file, good, tmp_path / "nosuch.json")
    assert (failed.code, failed.out) == (2, "")
    assert semloc("map", "add", map_file, good).out == "b: 2 places added\n"


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--place", "nosuch"), "expected a place id"),
        (("--place", "nosuch", "--map-name", "a"), "nosuch"),
        (("--map-name", "hq_9"), "hq_9"),
        (("--place", "{place}"), "--map-name"),
        (("--place", "{other}", "--map-name", "copy", "--rival", "1"), "expected one of --place"),
        (("--rival", "99"), "--rival"),
        (("--place-near", "900,900"), "of --place-near"),
        (("--methods", "gradient"), "expected explainers among"),
    ],
)
def test_a_question_that_has_no_answer_is_refused_before_anything_is_printed(
    semloc, map_file, tmp_path, words, why
) -> None:
    from semloc_core.map_database import load

    assert semloc("map", "add", map_file, tmp_path / "a.json", "--name", "copy").code == 0
    places = load(map_file).place_ids
    named = [word.format(place=places[0], other=places[2]) for word in words]
    refused = semloc("explain", map_file, tmp_path / "a.json", "--query", places[0], *named)
    assert (refused.code, refused.out) == (2, "")
    assert refused.err.count("\n") == 1
    assert why in refused.err
