"""The pipeline as users of the library call it: every odd input is an answer, never an exception or a guess."""

import dataclasses
import random

import msgspec
import numpy as np
import pytest
from small_building import SPACE, building_update, delta, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.encoding.model import embed_graph
from semloc_core.errors import GraphError, MessageError, SemlocError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.changes.stream import Outcome
from semloc_core.localiser import Localiser
from semloc_core.map_database import MapDatabase, load
from semloc_core.sources.world import KINDS, draw_pair
from semloc_core.wire import codec as wire


@pytest.fixture(scope="module", params=["paper", "rings", "bag_of_words"])
def world(request, tmp_path_factory):
    """A map of one building, for encoders with and without attention."""
    path = tmp_path_factory.mktemp(request.param) / "home.map"
    return make_map(path, make_model(request.param), home=building_update())


def ask(world, update, **config):
    return Localiser(world, LocaliserConfig(**config)).update(update)


def test_a_place_of_the_map_finds_itself(world):
    result = ask(world, building_update(query="p12"))
    assert result.outcome is Outcome.APPLIED
    best = result.matches.matches[0]
    assert best.similarity == pytest.approx(1.0, abs=1e-5)
    assert best.map == "home"
    top = [m.place for m in result.matches.matches if m.similarity > best.similarity - 1e-6]
    assert "p12" in top or world.model.encoder.name == "bag_of_words"


def test_the_message_says_what_answered(world):
    matches = ask(world, building_update(), top_n=7, rerank="none").matches
    assert (matches.seq, matches.stamp_ns, matches.query_place) == (0, 1_000_000_000, "p5")
    assert [m.rank for m in matches.matches] == list(range(1, 8))
    assert matches.map == wire.MapInfo(name="home", hash=world.hash, places=30)
    assert matches.model == wire.ModelInfo(name=world.model.encoder.name, hash=world.model.hash)
    assert matches.latency_ms is None
    similarities = [m.similarity for m in matches.matches]
    assert similarities == sorted(similarities, reverse=True)
    assert all(0 <= m.probability <= 1 for m in matches.matches)
    assert wire.decode(wire.encode(matches), wire.PlaceMatches).matches[0].place == matches.matches[0].place


def test_attributions_name_the_classes_around_the_place(world):
    result = ask(world, building_update())
    why = result.attributions
    assert why is not None
    assert sum(c.share for c in why.classes) == pytest.approx(1)
    assert all(c.share >= 0 for c in why.classes)
    assert sum(c.instances for c in why.classes) == len(why.objects)
    by_class = {c.class_: c.score for c in why.classes}
    for name, score in by_class.items():
        assert score == pytest.approx(sum(o.score for o in why.objects if o.class_ == name), abs=1e-6)
    if world.model.encoder.name == "paper":
        assert why.method == "attention"
        assert sum(o.score for o in why.objects) + why.unattributed == pytest.approx(1, abs=1e-5)
    else:
        assert why.method == "closed_form"
        assert abs(why.completeness_gap) < 1e-5
    wire.encode(why)


def test_no_graph_yet_and_none_after_a_gap(world):
    localiser = Localiser(world)
    assert localiser.update(delta(3)).matches.status == "no_graph"
    localiser.update(building_update())
    assert localiser.update(delta(5, query="p1")).matches.status == "no_graph"
    assert localiser.update(building_update(seq=9)).matches.status != "no_graph"


def test_a_repeated_update_has_no_answer(world):
    localiser = Localiser(world)
    localiser.update(building_update(seq=4))
    again = localiser.update(delta(4, query="p1"))
    assert again.outcome is Outcome.REPEATED
    assert again.matches is None


@pytest.mark.parametrize(
    ("update", "reason"),
    [
        (building_update(query=None), "no query place"),
        (building_update(length=1, objects=0, query="p0"), "the query place is isolated"),
        (building_update(length=1, objects=3, query="p0"), "the query place is isolated"),
        (building_update(objects=0), "no object in reach of the query place"),
    ],
)
def test_nothing_to_say_is_an_answer(world, update, reason):
    result = ask(world, update)
    assert result.matches.status == "unknown"
    assert result.matches.matches == []
    assert result.attributions is None
    assert result.located.query.reason == reason
    with pytest.raises(SemlocError, match="expected an answer with a match"):
        Localiser(world).explain(result.located)


def test_an_empty_full_update_is_unknown_not_an_error(world):
    assert ask(world, building_update(length=0, objects=0, query=None)).matches.status == "unknown"


def test_classes_the_model_never_saw_are_counted_and_otherwise_ignored(world):
    update = building_update()
    strange = [*update.objects, wire.Object(id="x", class_="zeppelin", position=(5.0, 0.0, 0.0))]
    localiser = Localiser(world)
    with_it = localiser.update(msgspec.structs.replace(update, objects=strange, edges=[*update.edges, ("p5", "x")]))
    assert localiser.live.unknown_classes == {"zeppelin": 1}
    assert with_it.matches == ask(world, update).matches
    assert "zeppelin" not in {c.class_ for c in with_it.attributions.classes}


def test_only_unknown_classes_is_nothing_to_say(world):
    update = building_update()
    strange = [msgspec.structs.replace(o, class_="zeppelin") for o in update.objects]
    assert ask(world, msgspec.structs.replace(update, objects=strange)).matches.status == "unknown"


def test_order_of_nodes_and_edges_does_not_matter(world):
    update, rng = building_update(), random.Random(0)
    shuffled = msgspec.structs.replace(
        update,
        places=rng.sample(update.places, len(update.places)),
        objects=rng.sample(update.objects, len(update.objects)),
        edges=[rng.choice([e, e[::-1]]) for e in rng.sample(update.edges, len(update.edges))],
    )
    a, b = ask(world, update), ask(world, shuffled)
    assert wire.encode(a.matches) == wire.encode(b.matches)
    assert wire.encode(a.attributions) == wire.encode(b.attributions)


def test_deltas_lead_to_the_same_answer_as_one_full_update(world):
    whole = building_update()
    first = msgspec.structs.replace(
        whole,
        places=whole.places[:15], objects=[], query_place="p3",
        edges=[(f"p{i}", f"p{i + 1}") for i in range(14)],
    )  # fmt: skip
    localiser = Localiser(world)
    localiser.update(first)
    localiser.update(delta(1, places=whole.places[15:], edges=[(f"p{i}", f"p{i + 1}") for i in range(14, 29)]))
    last = localiser.update(
        delta(2, objects=whole.objects, edges=[e for e in whole.edges if e[1].startswith("o")], query="p5")
    )
    expected = ask(world, whole)
    assert last.matches.matches == expected.matches.matches


def test_a_rejected_update_loses_nothing(world):
    localiser = Localiser(world)
    before = localiser.update(building_update()).matches
    with pytest.raises(GraphError):
        localiser.update(delta(1, edges=[("p1", "nowhere")], query="p9"))
    with pytest.raises(MessageError):
        localiser.update(b'{"schema": "semloc/scene_graph_update/1", "stamp_ns": 1')
    assert localiser.locate().matches == before
    assert localiser.update(delta(1, query="p9")).outcome is Outcome.APPLIED


def test_an_update_above_the_size_limit_is_refused(world):
    with pytest.raises(MessageError, match="1024"):
        ask(world, wire.encode(building_update()), max_update_bytes=1024)


def test_an_answer_does_not_change_with_later_updates(world):
    localiser = Localiser(world)
    located = localiser.update(building_update()).located
    before = wire.encode(localiser.explain(located))
    localiser.update(delta(1, removed_nodes=[f"o{k}" for k in range(20)], query="p9"))
    assert wire.encode(localiser.explain(located)) == before


def test_explanations_come_at_their_rate_of_message_time(world):
    localiser = Localiser(world, LocaliserConfig(explain_rate_hz=1.0))
    localiser.update(building_update())
    given = [
        localiser.update(delta(s, stamp_ns=1_000_000_000 + s * 250_000_000, query="p5")).attributions is not None
        for s in range(1, 10)
    ]
    assert given == [False, False, False, True, False, False, False, True, False]
    # A bag that loops: stamps go back, and explanations go on.
    assert localiser.update(building_update()).attributions is not None
    assert ask(world, building_update(), explain_rate_hz=0.0).attributions is None


def test_a_sure_answer_is_a_match_and_an_unsure_one_names_its_rivals(tmp_path):
    """Two equal homes can't be told apart: the answer must say so and name the other one."""
    model = make_model("rings")
    world = make_map(tmp_path / "two.map", model, a=building_update(), b=building_update())
    unsure = ask(world, building_update()).matches
    assert unsure.status == "ambiguous"
    assert [r.place for r in unsure.rivals][:1] == ["p5"]
    assert {unsure.matches[0].map, unsure.rivals[0].map} == {"a", "b"}
    sure = make_map(tmp_path / "one.map", dataclasses.replace(model, temperature=0.01), a=building_update())
    for rerank in ("none", "layout"):
        answer = ask(sure, building_update(), rerank=rerank).matches
        assert answer.status == "match"
        assert answer.rivals == []


def test_what_was_tested_by_layout_is_ranked_by_probability_and_the_search_is_published_beside_it(world):
    plain = ask(world, building_update(query="p12"), rerank="none").matches
    tested = ask(world, building_update(query="p12")).matches
    assert (plain.calibrated, tested.calibrated) == (False, True)
    assert plain.raw_matches is None
    assert tested.raw_matches == plain.matches
    best = tested.matches[0]
    assert abs(best.position[0] - 12) <= 4
    probabilities = [m.probability for m in tested.matches]
    assert probabilities == sorted(probabilities, reverse=True)
    assert best.probability > 0.9
    assert wire.decode(wire.encode(tested), wire.PlaceMatches).matches[0].place == best.place


def test_a_building_that_the_map_does_not_have_is_told_from_one_that_it_has(tmp_path):
    """Two homes, one in the map; each is seen again by a detector and asked at places all over it."""
    rng = np.random.default_rng(3)
    (mapped, again), (_, foreign) = draw_pair(KINDS["home"], rng), draw_pair(KINDS["home"], rng)
    arrays = GraphArrays.from_scene_graph(mapped.graph, mapped.labelspace, "home")
    model = make_model("rings", space=mapped.labelspace)
    with MapDatabase.create(tmp_path / "home.map", model) as database:
        rows = arrays.place_ids, arrays.place_positions, embed_graph(model, arrays)
        database.add_building("home", mapped.graph, *rows)
    world = load(tmp_path / "home.map")

    def statuses(graph):
        localiser = Localiser(world, LocaliserConfig(explain_rate_hz=0.0))
        localiser.apply(graph.to_update(seq=0, stamp_ns=0, frame_id="odom"))
        return [localiser.locate(place).matches.status for place in sorted(graph.places)[::10]]

    at_home, abroad = statuses(again.graph), statuses(foreign.graph)
    assert at_home.count("match") > 0.8 * len(at_home)
    assert abroad.count("match") < 0.2 * len(abroad)
    assert abroad.count("unknown") > 0.5 * len(abroad)


def test_where_nothing_fits_the_answer_is_unknown_whatever_the_similarity(world):
    """The one couch stands on another floor of the map than of the robot's graph, straight above the place."""
    place = {"id": "p0", "position": (0.0, 0.0, 0.0)}
    beside = {"id": "p1", "position": (1.0, 0.0, 0.0)}
    couch = wire.Object(id="o0", class_="couch", position=(0.0, 0.0, 30.0))
    update = delta(0, places=[wire.Place(**place), wire.Place(**beside)], objects=[couch])
    update = msgspec.structs.replace(update, full=True, query_place="p0", edges=[("p0", "p1"), ("p0", "o0")])
    answer = ask(world, update).matches
    assert answer.status == "unknown"
    assert {m.probability for m in answer.matches} == {0.0}
    assert answer.rivals == []
    assert ask(world, update, rerank="none").matches.matches == answer.raw_matches


def test_only_what_was_fitted_is_called_calibrated(world):
    for config, calibrated in (({}, True), ({"rerank": "none"}, False), ({"filter": "bayes"}, True)):
        assert ask(world, building_update(), **config).matches.calibrated == calibrated


def test_a_map_without_scene_graphs_is_searched_all_the_same(world):
    bare = dataclasses.replace(world, stored=())
    answer = ask(bare, building_update()).matches
    assert not answer.calibrated
    assert answer.raw_matches is None
    assert answer.matches == ask(world, building_update(), rerank="none").matches.matches


def test_the_labelspace_of_the_map_is_what_counts(world):
    assert world.model.labelspace == SPACE
