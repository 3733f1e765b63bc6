import numpy as np
import pytest
from svg_marks import Marks

from semloc_core.report.colours import OTHER, ClassLooks
from semloc_core.report.replay.time_figures import (
    bracket,
    confidence_figure,
    latency_figure,
    shares_figure,
    status_figure,
    success_figure,
)

LOOKS = ClassLooks(["chair"], ["chair"])


def test_each_status_has_its_lane_and_each_stretch_its_bar():
    marks = Marks(status_figure([("match", 0, 2), ("unknown", 2, 3), ("match", 3, 5)], [(0, 1)]))
    assert {"match", "ambiguous", "unknown", "no_graph", "(truly right)"} <= set(marks.labels)
    assert (marks.count("lane-match"), marks.count("lane-unknown"), marks.count("lane-truly right")) == (2, 1, 1)
    assert marks.count("lane-ambiguous") == 0


def test_without_truth_no_lane_says_what_is_right():
    assert "(truly right)" not in Marks(status_figure([("match", 0, 2)])).labels


def test_confidence_names_both_lines_and_breaks_where_there_was_no_match():
    values = [0.5, np.nan, 0.6, 0.7]
    marks = Marks(confidence_figure([0, 1, 2, 3], values, values))
    assert {"cosine similarity", "probability", "time (s)"} <= set(marks.labels)
    path = next(e for e in marks.groups["similarity"].iter() if e.tag == "path")
    assert path.attrib["d"].count("M") >= 1
    assert marks.count("similarity") == marks.count("probability") == 1


def test_all_answers_without_a_match_can_be_drawn():
    assert Marks(confidence_figure([0.0, 1.0], [np.nan] * 2, [np.nan] * 2)).count("similarity") <= 1


def test_shares_stack_up_to_one_and_are_named():
    marks = Marks(shares_figure([0, 1, 2], {"chair": [0.5, 0.2, 0.1], OTHER: [0.5, 0.8, 0.9]}, LOOKS))
    assert {"chair", OTHER} <= set(marks.labels)
    assert marks.count("share-0") >= 1
    assert marks.count("share-1") >= 1


def test_shares_are_not_drawn_on_over_a_silence():
    from semloc_core.report.replay.time_figures import _held

    times, index = _held(np.array([0.0, 1.0, 2.0, 60.0]))
    assert times.tolist() == [0.0, 1.0, 2.0, 3.0, 60.0, 61.0]
    assert index.tolist() == [0, 1, 2, -1, 3, -1]


def test_one_attribution_alone_can_be_drawn():
    assert Marks(shares_figure([3.0], {"chair": [1.0]}, LOOKS)).count("share-0") >= 1


def test_success_has_a_bar_for_each_figure_of_each_row():
    rows = [
        {"method": "m", "scope": "0m", "success@1": 0.1, "success@5": 0.2, "success@10": 0.3},
        {"method": "m", "scope": "all", "success@1": 0.1, "success@5": 0.2, "success@10": 0.3},
    ]
    marks = Marks(success_figure(rows))
    assert {"success@1", "success@5", "success@10", "0–5 m", "all"} <= set(marks.labels)


@pytest.mark.parametrize(("scope", "said"), [("0m", "0–5 m"), ("20m", "20–40 m"), ("40m", "40+ m"), ("all", "all")])
def test_scopes_are_said_as_a_person_reads_them(scope, said):
    assert bracket(scope) == said


def test_latency_has_a_point_an_answer():
    assert Marks(latency_figure([0, 1, 2], [1.0, 10.0, 3.0])).count("latency") == 3
