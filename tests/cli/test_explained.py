"""What `semloc explain` prints: which place is meant, how far it is, and every fact in its part."""

import msgspec
import pytest

from semloc_core.cli.explain import _nearest, _Point
from semloc_core.cli.explained import print_answer, print_brief, print_explanation
from semloc_core.errors import GraphError
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.wire.messages import (
    ClassAttribution,
    ClassContrast,
    Counterfactual,
    Explanation,
    Fidelity,
    Match,
    MethodAttributions,
    ObjectAttribution,
    ObjectName,
    PlaceEvidence,
    PlaceMatches,
    WhyNot,
    WithoutClass,
)

GRAPH = SceneGraph(places={"a": (0.0, 0.0, 0.0), "b": (3.0, 0.0, 2.0)}, neighbours={"a": {}, "b": {}})


def near(said: str) -> _Point:
    return _Point.of("--near", said)


def test_a_point_is_read_before_anything_else(semloc, write_corridor, tmp_path, monkeypatch) -> None:
    home = write_corridor(tmp_path / "home.json", ["chair", "couch"])
    assert semloc("map", "build", home, "-o", tmp_path / "home.map").code == 0
    words = ("explain", tmp_path / "home.map", home)

    def never(*_: object) -> None:
        raise AssertionError("the long work was begun")

    monkeypatch.setattr("semloc_core.cli.explain.read_graph_or_run", never)
    for wrong in ("--near", "--place-near"):
        said = semloc(*words, "--near", "0,0", wrong, "here")
        assert (said.code, said.err) == (2, f"semloc: expected {wrong} as X,Y or X,Y,Z in metres (got here)\n")
    said = semloc(*words, "--near", "0,0", "--place-near", "0,500")
    assert said.code == 2
    assert "within 4 m of --place-near 0,500 (got 500.0 m to p" in said.err
    assert "got both" in semloc(*words, "--near", "0,0", "--query", "p0").err
    assert "got more" in semloc(*words, "--near", "0,0", "--place-near", "0,0", "--rival", 1).err


def test_the_nearest_place_is_said_to_be_as_far_as_it_is() -> None:
    assert _nearest(GRAPH.places, near("2,1"), 4.0) == ("b", ", 1.41 m from 2,1"), "without a height, in the plane"
    assert _nearest(GRAPH.places, near("2,1,0"), 4.0) == ("a", ", 2.24 m from 2,1,0")


def test_a_point_far_from_every_place_is_refused_unless_that_is_allowed() -> None:
    with pytest.raises(
        GraphError, match=r"within 4 m of --near 30,4 \(got 27.3 m to b at \(3.00, 0.00, 2.00\); --within"
    ):
        _nearest(GRAPH.places, near("30,4"), 4.0)
    assert _nearest(GRAPH.places, near("30,4"), 28.0)[0] == "b"


def match(rank: int, place: str, similarity: float) -> Match:
    return Match(rank=rank, map="office", place=place, position=(1.0, 2.0, 3.0), similarity=similarity, probability=0.8)


def answer(status: str = "match", matches: int = 2, calibrated: bool = True) -> PlaceMatches:
    return PlaceMatches(
        schema="semloc/place_matches/1",
        stamp_ns=0,
        frame_id="map",
        seq=0,
        query_place="q",
        status=status,
        matches=[match(i + 1, f"p{i}", 0.9 - i / 10) for i in range(matches)],
        raw_matches=None,
        rivals=[],
        map=None,
        model=None,
        calibrated=calibrated,
        latency_ms=None,
    )


def method(name: str, faithful: float | None, *shares: float) -> MethodAttributions:
    names = [f"class {i}" for i in range(len(shares))]
    return MethodAttributions(
        method=name,
        classes=[ClassAttribution(n, s, abs(s), 3 + i) for i, (n, s) in enumerate(zip(names, shares, strict=True))],
        objects=[],
        fidelity=Fidelity(0.21, 0.07, faithful, 0.3) if faithful is not None else None,
        completeness_gap=None,
    )


def explanation(*methods: MethodAttributions, **more: object) -> Explanation:
    return Explanation(
        schema="semloc/explanation/1",
        stamp_ns=0,
        frame_id="map",
        seq=0,
        query_place="q",
        match_map="office",
        match_place="p0",
        similarity=0.9,
        methods=list(methods),
        **more,
    )


def test_what_and_where_come_first(capsys) -> None:
    print_answer(answer(), "asked: place q", "")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "WHAT     match: office, place p0, probability 0.800"
    assert lines[1] == "WHERE    asked: place q"
    assert [line.split()[:3] for line in lines[3:]] == [["1", "office", "p0"], ["2", "office", "p1"]]
    assert "0.9000" in lines[3]
    print_answer(answer(calibrated=False), "asked: place q", "")
    assert "(not calibrated)" in capsys.readouterr().out


def test_nothing_found_is_said_with_its_reason(capsys) -> None:
    print_answer(answer("unknown", 0), "asked: place q", "no object in reach")
    assert capsys.readouterr().out == "WHAT     unknown: no object in reach\nWHERE    asked: place q\n"


def test_why_lists_every_explainer_the_most_faithful_first_with_all_facts(capsys) -> None:
    print_explanation(explanation(method("saliency", 0.1, 0.7, -0.3), method("class_shapley", 0.3, 0.6, 0.4)))
    out = capsys.readouterr().out
    assert out.startswith(
        "WHY      class 0 60%, class 1 40%: so says class_shapley, the most faithful of 2 explainers\n"
    )
    rows = {line[9:16]: line.split()[2:] for line in out.splitlines() if line[9:14] == "class"}
    assert rows["class 0"] == ["3", "60.0%", "70.0%"]
    assert rows["class 1"] == ["4", "40.0%", "-30.0%"]
    for fact in (
        "0.300  ",
        "0.100",
        "2 of 2 put class 0 first",
        "saliency: no sign",
        "class_shapley: exact for classes",
    ):
        assert fact in out, fact
    assert "WHAT IF  without the 30% of the objects that class_shapley puts first" in out
    assert "changes by 0.210" in out
    assert "with them alone, by 0.070" in out


def test_many_classes_are_cut_to_the_largest_and_that_is_said(capsys) -> None:
    print_explanation(explanation(method("attention", 0.1, *[0.1] * 10)))
    out = capsys.readouterr().out
    assert "of 10 classes the 8 largest" in out
    assert "class 7" in out
    assert "class 8 " not in out
    assert "only explainer asked" in out
    assert "put class 0 first" not in out, "one alone agrees with nobody"


def test_why_not_and_what_if_keep_what_is_known(capsys) -> None:
    print_explanation(
        explanation(
            method("layout", None, 1.0),
            why_not=WhyNot("office", "p9", 0.4, 7, [ClassContrast("chair", 0.25), ClassContrast("couch", -0.125)]),
            counterfactual=Counterfactual([ObjectName("o1", "chair")], "office", "p5", 0.5),
        )
    )
    out = capsys.readouterr().out
    assert "WHY NOT  office, place p0: number 7, behind office, place p9\n" in out
    assert "similarity 0.9000 here, 0.4000 there" in out
    assert "+0.2500  chair: for this place" in out
    assert "-0.1250  couch: for the top match" in out
    assert "WHAT IF  without chair o1\n" in out
    assert "the top match by similarity alone is office, place p5 (0.5000)" in out


LONG_ID = str(ord("p") << 56 | 86)


def evidence(place: str, chair: float, as_: str | None, missed: float, walls: float = 0.0) -> PlaceEvidence:
    return PlaceEvidence(
        map="office",
        place=place,
        score=chair + missed + walls,
        objects=[ObjectAttribution("o1", "chair", chair, as_)],
        missed=[ObjectAttribution("m1", "sofa", missed)] if missed else [],
        walls=walls,
    )


def layout(**scores: float) -> MethodAttributions:
    total = sum(abs(score) for score in scores.values())
    said = [ClassAttribution(name, score, abs(score) / total, 2) for name, score in scores.items()]
    return MethodAttributions("layout", said, [], None, 0.0)


def test_why_not_is_asked_of_what_decides_object_by_object(capsys) -> None:
    asked = explanation(
        method("layout", None, 1.0),
        position=(20.0, 10.0, 1.0),
        probability=0.0312,
        why_not=WhyNot(
            "office",
            LONG_ID,
            0.4,
            7,
            [ClassContrast("chair", 0.25)],
            evidence=[evidence("p0", 0.0, None, -1.5, -0.75), evidence(LONG_ID, 4.25, str(ord("O") << 56 | 3), 0.0)],
        ),
    )
    answered = explanation(layout(chair=4.25), method("attention", None, 0.7, 0.3), without=[])
    print_brief(answer(), "asked: place q", "", answered, asked)
    said = capsys.readouterr().out.splitlines()
    assert said[3:6] == [
        "BECAUSE  4.2 nats (layout, which decided): chair +4.2; attention: class 0 70%, class 1 30%",
        "UNLESS   no removal that was tried changes it",
        "WHY NOT  office, place p0 at (20.00, 10.00, 1.00), 20.7 m from the answer, probability 0.031: -2.2 nats, "
        "against 4.2 of office, place p86",
    ], "because and unless are of the answer, not of the place asked for"
    differing = ["saw chair o1: +0.0 at p0, +4.2 at p86 (as O3)", "did not see sofa m1, mapped at p0: -1.5"]
    differing.append("walked where the map has no room: -0.8 at p0, +0.0 at p86")
    assert [line.strip() for line in said[6:]] == [
        *differing,
        "and what differs by less, or is lost in rounding, +0.1 together",
    ], "-4.2 - 1.5 - 0.8 + 0.1 is -2.2 - 4.2"
    print_explanation(asked)
    out = capsys.readouterr().out
    assert all(line in out for line in differing)
    assert "by the answer's order it is number 7" in out, "the long form has the similarity too"
    assert "+0.2500  chair: for this place" in out


def seen(scores: list[float]) -> list[ObjectAttribution]:
    return [ObjectAttribution(f"o{i}", "chair", score) for i, score in enumerate(scores)]


def test_what_is_not_named_of_a_difference_is_summed(capsys) -> None:
    here, there = [0.0, 0.31, 0.17, 0.0, 0.04, 0.0], [7.26, 6.0, 5.55, 4.44, 3.33, 0.02]
    both = [PlaceEvidence("office", name, sum(of), seen(of), [], 0.0) for name, of in (("p0", here), ("p1", there))]
    asked = explanation(method("layout", None, 1.0), why_not=WhyNot("office", "p1", 0.4, 7, [], evidence=both))
    print_brief(answer(), "asked: place q", "", explanation(layout(chair=1.0)), asked)
    said = [line.strip() for line in capsys.readouterr().out.split("WHY NOT  ")[1].splitlines()]
    assert said[0] == "office, place p0: 0.5 nats, against 26.6 of office, place p1"
    assert said[1] == "saw chair o0: +0.0 at p0, +7.3 at p1"
    # 0.5 - 26.6 = -26.1; named are -7.3, -5.7, -5.3 (+0.2 against +5.5) and -4.4
    assert said[5:] == ["and 1 smaller difference, -3.4 together (--long)"]


def test_an_object_missed_at_both_places_is_one_line_and_none_where_it_costs_the_same(capsys) -> None:
    def missing(place: str, bed: float, sink: float) -> PlaceEvidence:
        missed = [ObjectAttribution("m1", "bed", bed), ObjectAttribution("m2", "sink", sink)]
        return PlaceEvidence("office", place, bed + sink, [], missed, 0.0)

    both = [missing("p0", -1.5, -0.4), missing("p1", -0.5, -0.4)]
    asked = explanation(method("layout", None, 1.0), why_not=WhyNot("office", "p1", 0.4, 7, [], evidence=both))
    print_explanation(asked)
    lines = [line.strip() for line in capsys.readouterr().out.splitlines() if "did not see" in line]
    assert lines == ["did not see bed m1, mapped near both: -1.5 at p0, -0.5 at p1"]


def test_in_short_an_explanation_is_five_lines(capsys) -> None:
    asked = explanation(
        method("attention", 0.1, 0.7, 0.3),
        layout(chair=3.25),
        without=[WithoutClass("chair", "office", "p1", 0.4, False, "ambiguous")],
    )
    print_brief(answer(), "asked: place q", "", asked)
    assert capsys.readouterr().out.splitlines() == [
        "WHAT     match: office, place p0 at (1.00, 2.00, 3.00)",
        "WHERE    asked: place q",
        "SURE     probability 0.800 (that this place is right); no rival elsewhere",
        "BECAUSE  3.2 nats (layout, which decided): chair +3.2; attention: class 0 70%, class 1 30%",
        "UNLESS   had it seen no chair: ambiguous, no longer a match, office, place p1, probability 0.400",
    ]
    print_brief(answer("unknown", 0), "asked: place q", "no object in reach", None)
    assert capsys.readouterr().out == "WHAT     unknown: no object in reach\nWHERE    asked: place q\n"


def test_the_place_asked_for_may_be_the_answer(capsys) -> None:
    asked = explanation(layout(chair=3.25))
    print_brief(answer(), "asked: place q", "", asked, asked)
    assert capsys.readouterr().out.splitlines()[-1] == "WHY NOT  it is the answer"


def test_rivals_are_numbered_and_have_their_positions(capsys) -> None:
    rivals = [match(1, "p7", 0.5), match(2, "p8", 0.4)]
    print_brief(msgspec.structs.replace(answer("ambiguous"), rivals=rivals), "asked: place q", "", None)
    assert capsys.readouterr().out.splitlines()[2] == (
        "SURE     probability 0.800 (that this place is right); rivals: 1. office, place p7 at (1.00, 2.00, 3.00) "
        "(0.800); 2. office, place p8 at (1.00, 2.00, 3.00) (0.800)"
    )


def test_the_parts_of_because_add_up_as_they_are_printed(capsys) -> None:
    scores = {"chair": 10.06, "sofa": 6.06, "bed": 5.06, "sink": -4.06, "oven": 0.74, "vase": 0.02}
    attended = method("attention", None, 0.333, 0.333, 0.112, 0.111, 0.111)
    print_brief(answer(), "asked: place q", "", explanation(layout(**scores), attended))
    said = capsys.readouterr().out.splitlines()[3]
    # 10.1 + 6.1 + 5.1 - 4.1 is 17.2, and 17.88 is printed as 17.9
    assert said == (
        "BECAUSE  17.9 nats (layout, which decided): chair +10.1, sofa +6.1, bed +5.1, sink -4.1, the rest +0.7; "
        "attention: class 0 33%, class 1 33%, class 2 11%, class 3 11%, the rest 12%"
    )
    walls = msgspec.structs.replace(layout(chair=3.17, sofa=2.13), walls=-1.34)
    print_brief(answer(), "asked: place q", "", explanation(walls))
    assert capsys.readouterr().out.splitlines()[3] == (
        "BECAUSE  4.0 nats (layout, which decided): chair +3.2, sofa +2.1, walked where the map has no room -1.3"
    )


def test_what_a_class_holds_up_is_said_with_its_status(capsys) -> None:
    without = [
        WithoutClass("chair", "office", "p0", 0.81, True, "match"),
        WithoutClass("bed", "office", "p0", 0.62, True, "ambiguous"),
        WithoutClass("sink", "office", "p0", 0.801, True, "ambiguous"),
        WithoutClass("tv", None, None, 0.0, False, "unknown"),
    ]
    print_brief(answer(), "asked: place q", "", explanation(layout(chair=1.0), without=without))
    assert capsys.readouterr().out.splitlines()[4] == (
        "UNLESS   had it seen no chair: still a match, the same place, probability 0.810; "
        "had it seen no bed: ambiguous, no longer a match, the same place, probability 0.620; "
        "had it seen no sink: ambiguous, no longer a match, the same place, probability 0.801; "
        "had it seen no tv: unknown, nothing to go by"
    )
    still = [WithoutClass(name, "office", "p0", p, True, "match") for name, p in (("bed", 0.799), ("tv", 0.801))]
    print_brief(answer(), "asked: place q", "", explanation(layout(chair=1.0), without=still))
    assert capsys.readouterr().out.splitlines()[4] == (
        "UNLESS   no single class: without any one of 2 it is still a match, the same place, probability 0.799 to 0.801"
    )


def test_classes_that_change_nothing_share_a_line(capsys) -> None:
    without = [
        WithoutClass("chair", "office", "p0", 0.798, True, "match"),
        WithoutClass("bed", "office", "p7", 0.798, False, "match"),
        WithoutClass("couch", "office", "p0", 0.8, True, "match"),
        WithoutClass("sink", "office", "p0", 0.7, True),
    ]
    asked = explanation(method("layout", None, 1.0), without=without)
    print_explanation(asked, answer())
    said = [line[9:] for line in capsys.readouterr().out.splitlines() if "had it seen" in line]
    assert said == [
        "had it seen no bed: still a match, office, place p7, probability 0.798",
        "had it seen no sink: the same place, probability 0.700",
        "had it seen no chair, or no couch: still a match, the same place, probability 0.798 to 0.800",
    ]


def test_many_removed_classes_are_cut_to_the_most_and_that_is_said(capsys) -> None:
    removed = [ObjectName(f"o{i}{j}", f"class {i}") for i in range(9) for j in range(9 - i)]
    print_explanation(explanation(method("layout", None, 1.0), counterfactual=Counterfactual(removed, "b", "p5", 0.5)))
    first = capsys.readouterr().out.split("WHAT IF  ")[1].splitlines()[0]
    assert first.startswith("without 9 × class 0, 8 × class 1, ")
    assert first.endswith(", 4 × class 5 and 3 more")


def test_no_figure_is_cut_off_on_a_narrow_screen(capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    print_answer(answer(), "asked: place q", "")
    print_explanation(explanation(*(method(f"explainer_{i}", 0.5, 0.123, 0.877) for i in range(6))))
    out = capsys.readouterr().out
    assert "…" not in out
    assert out.count("12.3%") == 6
    assert "(1.00, 2.00, 3.00)      0.9000        0.800" in out


def test_two_places_of_one_id_are_told_apart_by_their_buildings(capsys) -> None:
    twins = [evidence("p0", 0.0, None, 0.0), evidence("p0", 4.25, None, 0.0)]
    twins[1] = PlaceEvidence("hall", "p0", 4.25, twins[1].objects, [], 0.0)
    asked = explanation(method("layout", None, 1.0), why_not=WhyNot("hall", "p0", 0.4, 7, [], evidence=twins))
    print_brief(answer(), "asked: place q", "", explanation(layout(chair=1.0)), asked)
    assert "saw chair o1: +0.0 at p0 of office, +4.2 at p0 of hall" in capsys.readouterr().out
