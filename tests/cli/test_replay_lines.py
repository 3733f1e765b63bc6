"""An answer a second, and the wrong ones marked as soon as that is known."""

import msgspec

from semloc_core.cli.replay_lines import Lines
from semloc_core.encoding import Query
from semloc_core.matching import Located
from semloc_core.replay import Answer
from semloc_core.sources.bag.cdr import StampedPoint
from semloc_core.wire import Match, PlaceMatches


def answer(second: float, status: str = "match", listed: bool = True) -> Answer:
    match = Match(rank=1, map="office", place="p1", position=(1.0, 2.0, 3.0), similarity=0.5, probability=0.95)
    matches = PlaceMatches(
        schema="semloc/place_matches/1",
        stamp_ns=round(second * 1e9),
        frame_id="map",
        seq=0,
        query_place="q",
        status=status,
        matches=[match] if listed else [],
        raw_matches=None,
        rivals=[],
        map=None,
        model=None,
        calibrated=True,
        latency_ms=None,
    )
    return Answer(matches, None, None)


def truth(frame: str = "office") -> StampedPoint:
    return StampedPoint(stamp_ns=0, frame_id=frame, position=(9.0, 2.0, 3.0))


SAID = "{:7.1f} s  match      office (1.0, 2.0, 3.0) p=0.95 s=0.500"


def test_wrong_answers_are_marked_and_right_ones_are_not() -> None:
    shown: list[str] = []
    lines = Lines(shown.append)
    cases = [
        (answer(0), truth(), True, ""),
        (answer(1), truth(), False, "  WRONG: truly (9.0, 2.0, 3.0)"),
        (answer(2), truth("twin"), False, "  WRONG: truly twin (9.0, 2.0, 3.0)"),
        (answer(3, "ambiguous"), truth(), False, "  wrong: truly (9.0, 2.0, 3.0)"),
        (answer(4), truth("foreign"), None, "  (truly in foreign, no building of this map)"),
        (answer(5), None, None, ""),
        (answer(6, "unknown", listed=False), truth(), False, ""),
    ]
    for one, where, right, _ in cases:
        lines.answer(one)
        lines.scored(one.matches, where, right)
    marks = [line[len(SAID.format(0)) :] for line in shown[:6]]
    assert marks == [mark for *_, mark in cases[:6]]
    assert shown[1] == SAID.format(1) + cases[1][3]
    assert shown[6] == "    6.0 s  unknown"


def test_an_answer_without_a_place_says_why() -> None:
    shown: list[str] = []
    lines = Lines(shown.append)
    nothing = answer(0, "unknown", listed=False)
    query = Query(0, 0, "q", reason="no object within 3 hops")
    lines.answer(Answer(nothing.matches, None, None, Located(query, nothing.matches, None)))
    lines.finish()
    assert shown == ["    0.0 s  unknown    no object within 3 hops"]


def test_an_answer_a_second_is_shown_in_order_whenever_the_truth_comes() -> None:
    shown: list[str] = []
    lines = Lines(shown.append)
    answers = [answer(second / 2) for second in range(8)]
    for one in answers[:4]:
        lines.answer(one)
    assert shown == [], "the truth of both may still come"
    for one in answers[:4]:
        lines.scored(one.matches, truth(), one is not answers[2])
    assert shown == [SAID.format(0), SAID.format(1) + "  WRONG: truly (9.0, 2.0, 3.0)"]
    lines.answer(answers[4])
    lines.finish()
    assert shown[2:] == [SAID.format(2)]


def test_a_run_without_a_truth_is_shown_all_the_same_while_it_goes_on() -> None:
    shown: list[str] = []
    lines = Lines(shown.append)
    for second in range(6):
        lines.answer(answer(second))
    assert shown == [SAID.format(second) for second in range(3)]
    late = msgspec.structs.replace(answer(9).matches, seq=7)
    lines.scored(late, None, None)
    lines.finish()
    assert shown == [SAID.format(second) for second in range(6)]
