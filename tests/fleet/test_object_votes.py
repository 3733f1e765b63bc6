"""Buildings voted for by the objects seen: where they lie as mapped, whatever frame, and whatever is not seen."""

import numpy as np
import pytest

from semloc_core.errors import MapError
from semloc_core.fleet.narrowing import ShortlistConfig, shortlist
from semloc_core.fleet.object_votes import (
    FOUND,
    MOST_MAPPED,
    KnownObjects,
    MappedObjects,
    ObjectVotes,
    nearest_first,
)

CLASSES = 5


def drawn(seed: int, number: int = 20) -> MappedObjects:
    rng = np.random.default_rng(seed)
    return MappedObjects.of(rng.uniform(0, 12, (number, 3)) * (1, 1, 0.1), rng.integers(0, CLASSES, number))


def test_a_building_is_found_from_any_frame_and_in_part() -> None:
    maps = [drawn(seed) for seed in range(40)]
    votes = ObjectVotes(maps, CLASSES)
    for number, mapped in enumerate(maps):
        turn = np.exp(1j * number)
        flat = (mapped.positions[:, 0] + 1j * mapped.positions[:, 1]) * turn + (30 - 5j)
        seen = np.column_stack([flat.real, flat.imag, mapped.positions[:, 2] + 2.0])[:12]
        scores = votes.scores(seen, mapped.classes[:12])
        assert scores.argmax() == number


def test_what_was_not_seen_speaks_against_nothing_but_chance_favours_the_large() -> None:
    """A building with as much again elsewhere has what the other has, and has it by chance rather."""
    mapped, other = drawn(1), drawn(2)
    more = MappedObjects.of(
        np.concatenate([mapped.positions, other.positions + 100]), np.concatenate([mapped.classes, other.classes])
    )
    votes = ObjectVotes([mapped, more, *(drawn(seed) for seed in range(3, 30))], CLASSES)
    scores = votes.scores(mapped.positions.astype(np.float64)[:14], mapped.classes[:14])
    assert scores[0] > scores[1] > scores[2:].max()


def test_a_pair_weighs_by_how_few_have_it() -> None:
    at = np.array([[0.0, 0, 0], [3.0, 0, 0]])
    has, far = MappedObjects.of(at, np.array([0, 1])), MappedObjects.of(at * 2, np.array([0, 1]))
    votes = ObjectVotes([has, far, far, far], CLASSES)
    scores = votes.scores(at, np.array([0, 1]))
    assert scores[0] - scores[1] == pytest.approx(np.log1p(FOUND / ((1 - FOUND) / 4)))  # one of four has such a pair
    assert scores[1] == scores[2] > 0  # their classes are there
    off = votes.scores(at * (1 + 0.5 / 3), np.array([1, 0]))  # half a metre off, and named the other way round
    assert off[0] == pytest.approx(scores[0])


def test_nothing_seen_nothing_mapped() -> None:
    nothing = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    assert ObjectVotes([drawn(0)], CLASSES).scores(*nothing).tolist() == [0.0]
    assert ObjectVotes([MappedObjects.of(*nothing)], CLASSES).scores(np.zeros((2, 3)), np.array([0, 1])).tolist() == [0]
    assert ObjectVotes([], CLASSES).scores(*nothing).tolist() == []
    unknown = ObjectVotes([drawn(0)], CLASSES).scores(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([-1, -1]))
    assert unknown.tolist() == [0.0]


def test_objects_are_packed_and_read_back() -> None:
    mapped = drawn(7)
    again = MappedObjects.unpack(mapped.pack(), CLASSES)
    assert np.array_equal(again.positions, mapped.positions)
    assert np.array_equal(again.classes, mapped.classes)
    assert len(MappedObjects.of(np.zeros((MOST_MAPPED + 5, 3)), np.zeros(MOST_MAPPED + 5, np.int64)).classes) == 1024
    assert MappedObjects.unpack(b"", CLASSES).classes.shape == (0,)


@pytest.mark.parametrize("harm", [lambda data: data[:-1], lambda data: data * 60, lambda data: b"\xff" * len(data)])
def test_what_is_no_objects_is_refused(harm) -> None:
    with pytest.raises(MapError, match="objects"):
        MappedObjects.unpack(harm(drawn(7).pack()), CLASSES)


def test_a_class_that_the_map_lacks_is_refused() -> None:
    data = MappedObjects.of(np.zeros((1, 3)), np.array([CLASSES])).pack()
    with pytest.raises(MapError, match="of the map's classes"):
        MappedObjects.unpack(data, CLASSES)


def test_nearest_come_first() -> None:
    positions, classes = nearest_first(np.array([[5.0, 0, 9], [1, 0, 0], [0, 2, 0]]), np.array([0, 1, 2]), (0, 0, 0))
    assert classes.tolist() == [1, 2, 0]
    assert positions[0].tolist() == [1, 0, 0]


def test_only_what_changed_is_read_again() -> None:
    asked: list[list[str]] = []

    def read(names):
        asked.append(list(names))
        return {name: drawn(ord(name[0])) for name in names if name != "old"}

    known = KnownObjects()
    names, votes = known.votes([("a", "1"), ("b", "1"), ("old", "1")], CLASSES, read)
    assert names == ("a", "b")
    assert known.votes([("a", "1"), ("b", "1"), ("old", "1")], CLASSES, read)[1] is votes
    assert known.votes([("a", "2"), ("b", "1")], CLASSES, read)[0] == ("a", "b")
    assert asked == [["a", "b", "old"], ["a"]]
    assert known.votes([("c", "1")], CLASSES, lambda names: None) is None  # one is gone: the map is looked at again


def test_buildings_whose_objects_are_not_said_take_turns() -> None:
    sizes = dict.fromkeys("abcdef", 10)
    similar = {"a": 0.2, "b": 0.1, "e": 0.9, "f": 0.8}
    votes = {"a": 1.0, "b": 5.0, "c": 3.0, "d": 0.0}
    config = ShortlistConfig(buildings=6)
    assert shortlist(similar, votes, sizes, 1e9, config) == ("b", "e", "c", "f", "a", "d")
    assert shortlist(similar, {}, sizes, 0.1, config) == ("e", "f", "a", "b")
    assert shortlist(similar, votes, sizes, 1e9, config, believed=("d", "gone"))[0] == "d"
    assert shortlist(similar, votes, sizes, 1e9, ShortlistConfig(buildings=6, places=25)) == ("b", "e")
    assert shortlist({"a": 0.9, "b": 0.1}, {"a": 0.0, "b": 0.1}, sizes, 0.05, config) == ("a", "b")
