"""Which updates are let in: a robot that misses one must not localise in a graph that never was."""

import msgspec
import pytest

from semloc_core.errors import GraphError
from semloc_core.graph.changes.stream import Outcome, UpdateStream
from semloc_core.wire import Place, SceneGraphUpdate


def update(seq: int, full: bool = False, place: str | None = None, edge: tuple[str, str] | None = None):
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=seq,
        frame_id="odom",
        seq=seq,
        full=full,
        places=[Place(id=place, position=(0.0, 0.0, 0.0))] if place else [],
        objects=[],
        edges=[edge] if edge else [],
        query_place=None,
    )


def outcomes(*updates: SceneGraphUpdate) -> tuple[UpdateStream, list[Outcome]]:
    stream = UpdateStream()
    return stream, [stream.apply(u)[0] for u in updates]


def test_a_delta_before_any_full_update_waits():
    stream, seen = outcomes(update(3, place="a"))
    assert seen == [Outcome.WAITING]
    assert stream.graph is None


def test_consecutive_deltas_are_applied():
    stream, seen = outcomes(update(7, full=True, place="a"), update(8, place="b"), update(9, place="c"))
    assert seen == [Outcome.APPLIED] * 3
    assert stream.graph is not None
    assert set(stream.graph.places) == {"a", "b", "c"}


@pytest.mark.parametrize("seq", [5, 4, 0])
def test_a_repeated_or_older_delta_is_dropped_and_counted(seq):
    stream, seen = outcomes(update(5, full=True, place="a"), update(seq, place="b"), update(6, place="c"))
    assert seen == [Outcome.APPLIED, Outcome.REPEATED, Outcome.APPLIED]
    assert stream.graph is not None
    assert set(stream.graph.places) == {"a", "c"}
    assert stream.counts["repeated"] == 1


def test_after_a_gap_there_is_no_graph_until_the_next_full_update():
    stream, seen = outcomes(
        update(0, full=True, place="a"), update(2, place="b"), update(3, place="c"), update(4, full=True, place="d")
    )
    assert seen == [Outcome.APPLIED, Outcome.GAP, Outcome.WAITING, Outcome.APPLIED]
    assert stream.graph is not None
    assert set(stream.graph.places) == {"d"}
    assert stream.counts == {"applied": 2, "gap": 1, "waiting": 1}


def test_a_full_update_restarts_the_count_even_backwards():
    stream, seen = outcomes(update(100, full=True, place="a"), update(0, full=True, place="b"), update(1, place="c"))
    assert seen == [Outcome.APPLIED] * 3
    assert stream.graph is not None
    assert set(stream.graph.places) == {"b", "c"}


def test_a_rejected_update_changes_nothing_and_its_number_was_not_seen():
    stream, _ = outcomes(update(0, full=True, place="a"))
    with pytest.raises(GraphError):
        stream.apply(update(1, place="b", edge=("b", "nowhere")))
    assert stream.graph is not None
    assert set(stream.graph.places) == {"a"}
    assert stream.counts["rejected"] == 1
    assert stream.apply(update(1, place="b"))[0] is Outcome.APPLIED


def test_a_rejected_full_update_keeps_the_graph_before_it():
    stream, _ = outcomes(update(0, full=True, place="a"))
    with pytest.raises(GraphError):
        stream.apply(update(1, full=True, place="b", edge=("b", "nowhere")))
    assert stream.graph is not None
    assert set(stream.graph.places) == {"a"}


def graph(seq: int, *places: tuple[str, float], full: bool = True) -> SceneGraphUpdate:
    at = [Place(id=id_, position=(x, 0.0, 0.0)) for id_, x in places]
    return msgspec.structs.replace(update(seq, full=full), places=at)


KNOWN = (("a", 0.0), ("b", 5.0), ("c", 10.0), ("d", 15.0))


@pytest.mark.parametrize(
    ("after", "anew"),
    [
        (KNOWN, False),
        ((*KNOWN, ("e", 20.0)), False),
        (KNOWN[:2], False),
        (KNOWN[:1], True),
        ((("x", 0.0), ("y", 5.0)), True),
        (tuple((id_, x + 0.9) for id_, x in KNOWN), False),
        (tuple((id_, x + 1.1) for id_, x in KNOWN), True),
        ((), True),
    ],
)
def test_a_graph_of_which_less_than_half_stayed_began_anew(after, anew):
    stream, _ = outcomes(graph(0, *KNOWN), graph(0, *after))
    assert stream.anew == anew
    stream.apply(graph(1, ("z", 30.0), full=False))
    assert not stream.anew


@pytest.mark.parametrize(("after", "anew"), [(KNOWN, False), ((("x", 0.0),), True)])
def test_after_a_gap_the_graph_before_it_counts(after, anew):
    stream, seen = outcomes(graph(0, *KNOWN), graph(5, full=False), graph(6, full=False), graph(9, *after))
    assert seen == [Outcome.APPLIED, Outcome.GAP, Outcome.WAITING, Outcome.APPLIED]
    assert stream.anew == anew


def test_the_first_graph_of_all_is_no_other_one():
    assert not outcomes(graph(0, *KNOWN))[0].anew
