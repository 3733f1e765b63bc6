"""The test by layout taken apart: exactly what was added up, and what is missing speaks against a class."""

import msgspec
import pytest
from small_building import building_update, make_map, make_model

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import ConfigError, SemlocError
from semloc_core.explain.explainers.by_name import EXPLAINERS
from semloc_core.explain.pair import explain_pair
from semloc_core.localiser import Localiser


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    homes = {"home": building_update(), "other": building_update(seed=1)}
    return make_map(folder / "two.map", make_model("rings"), **homes)


def update_without(class_):
    """The robot at home, which sees nothing of one class."""
    whole = building_update()
    gone = {item.id for item in whole.objects if item.class_ == class_}
    return wire.SceneGraphUpdate(
        **{name: getattr(whole, name) for name in whole.__struct_fields__ if name not in ("objects", "edges")},
        objects=[item for item in whole.objects if item.id not in gone],
        edges=[edge for edge in whole.edges if not gone & set(edge)],
    )


def localised(loaded, update, **options):
    localiser = Localiser(loaded, LocaliserConfig(explainer="layout", explain_rate_hz=1000, **options))
    return localiser, localiser.update(update)


def test_the_parts_are_the_score(loaded):
    _, result = localised(loaded, building_update())
    said, evidence = result.attributions, result.located.evidence
    assert said.method == "layout"
    assert (said.match_map, said.match_place) == (result.matches.matches[0].map, result.matches.matches[0].place)
    assert sum(of.score for of in said.classes) + said.unattributed == pytest.approx(evidence.score, abs=1e-5)
    assert said.completeness_gap == pytest.approx(0.0, abs=1e-5)
    assert sum(of.share for of in said.classes) == pytest.approx(1.0)
    assert [of.share for of in said.classes] == sorted((of.share for of in said.classes), reverse=True)
    assert [of.score for of in said.objects] == sorted((of.score for of in said.objects), reverse=True)
    assert all(of.score >= 0 for of in said.objects)
    assert sum(of.instances for of in said.classes) == len(said.objects)
    assert said.fidelity is None


def test_what_should_have_been_seen_and_was_not_speaks_against(loaded):
    without = localised(loaded, update_without("chair"))[1].attributions
    (said,) = (of for of in without.classes if of.class_ == "chair")
    assert said.score < 0
    assert said.instances == 0
    assert "chair" not in {of.class_ for of in without.objects}


def test_any_place_of_the_map_can_be_taken_apart_beside_the_winner(loaded):
    localiser, result = localised(loaded, building_update())
    located = localiser.ask()
    whole = explain_pair(located, located.best_row)
    assert len(whole.methods) == len(EXPLAINERS) + 1
    assert whole.methods[-1].method == "layout"
    assert whole.why_not is None
    only = explain_pair(located, located.best_row, methods=["layout"])
    assert only.methods[0].classes == result.attributions.classes
    tested = {loaded.row(match.map, match.place) for match in result.matches.matches}
    for other in ((located.best_row + 7) % loaded.n_places, *(set(range(loaded.n_places)) - tested)):
        asked = explain_pair(located, other, methods=["layout"])
        this, top = asked.why_not.evidence
        assert (this.map, this.place) == (asked.match_map, asked.match_place)
        assert (top.map, top.place) == (result.matches.matches[0].map, result.matches.matches[0].place)
        for one in (this, top):
            parts = [of.score for of in (*one.objects, *one.missed)]
            assert sum(parts) + one.walls == pytest.approx(one.score, abs=1e-5)
            assert all(of.score < 0 for of in one.missed)
        assert this.score <= top.score + 1e-6, "no place fits better than the winner"
        assert this.objects == asked.methods[0].objects


def test_a_seen_object_is_joined_to_the_mapped_one_that_explains_it(loaded):
    said = localised(loaded, building_update())[1].evidence
    assert said.match_map == "home"
    at = {item.id: (item.class_, item.position) for item in building_update().objects}
    assert len(said.objects) >= 8
    assert all(at[of.mapped] == at[of.id] for of in said.objects), "the same building, seen as it was mapped"
    strange = wire.Object(id="strange", class_="chair", position=(5.0, -9.0, 0.0))
    update = building_update()
    with_it = msgspec.structs.replace(
        update, objects=[*update.objects, strange], edges=[*update.edges, ("p5", "strange")]
    )
    (of,) = (of for of in localised(loaded, with_it)[1].evidence.objects if of.id == "strange")
    assert of.mapped is None
    assert of.score < 0.7


def test_only_what_was_not_seen_is_missed(loaded):
    whole, without = (localised(loaded, update)[1].evidence for update in (building_update(), update_without("chair")))
    chairs = {item.id for item in building_update().objects if item.class_ == "chair"}
    assert not {of.class_ for of in whole.missed} & {"chair", "plant", "painting"}
    assert {of.class_ for of in without.missed} >= {"chair"}
    assert {of.id for of in without.missed if of.class_ == "chair"} <= chairs


def test_the_evidence_comes_with_every_tested_answer_whatever_explains_the_embedding(loaded):
    localiser = Localiser(loaded, LocaliserConfig(explainer="attention", explain_rate_hz=0))
    result = localiser.update(building_update())
    assert result.attributions is None
    assert result.evidence.method == "layout"
    assert result.evidence == localised(loaded, building_update())[1].attributions
    untested = Localiser(loaded, LocaliserConfig(rerank="none", explain_rate_hz=0))
    answer = untested.update(building_update())
    assert answer.evidence is None
    with pytest.raises(ConfigError, match="put to the test"):
        explain_pair(answer.located, answer.located.best_row, methods=["layout"])


def test_without_the_test_there_is_nothing_to_take_apart(loaded):
    localiser = Localiser(loaded, LocaliserConfig(explainer="layout", rerank="none", explain_rate_hz=0))
    located = localiser.update(building_update()).located
    with pytest.raises(SemlocError, match="put to the test by layout"):
        localiser.explain(located)
    busy = Localiser(loaded, LocaliserConfig(explainer="layout", rerank="none", explain_rate_hz=1000))
    assert busy.update(building_update()).attributions is None  # and no error


def test_the_order_of_a_message_has_no_say(loaded):
    update = building_update()
    turned = wire.SceneGraphUpdate(
        **{name: getattr(update, name) for name in update.__struct_fields__ if name not in ("objects", "places")},
        objects=update.objects[::-1],
        places=update.places[::-1],
    )
    texts = [wire.encode(localised(loaded, one)[1].attributions) for one in (update, turned)]
    assert texts[0] == texts[1]


def test_without_a_class_the_whole_question_is_asked_again(loaded):
    localiser, result = localised(loaded, building_update())
    located = localiser.ask()
    without = explain_pair(located, located.best_row).without
    assert [of.class_ for of in without] == [of.class_ for of in result.attributions.classes]
    for found in without:
        asked = localised(loaded, update_without(found.class_))[1].matches.matches[0]
        assert (found.map, found.place) == (asked.map, asked.place)
        assert found.probability == pytest.approx(asked.probability, abs=1e-6)
        assert found.same == (asked.map == "home" and abs(asked.position[0] - 5.0) <= 4.0)
    assert explain_pair(located, (located.best_row + 7) % loaded.n_places).without is None


def test_where_nothing_would_be_left_there_is_no_answer(loaded):
    one = building_update()
    chairs = {item.id for item in one.objects if item.class_ == "chair"}
    only = wire.SceneGraphUpdate(
        **{name: getattr(one, name) for name in one.__struct_fields__ if name not in ("objects", "edges")},
        objects=[item for item in one.objects if item.id in chairs],
        edges=[edge for edge in one.edges if set(edge) <= chairs | {place.id for place in one.places}],
    )
    localiser, _ = localised(loaded, only)
    located = localiser.ask()
    (said,) = explain_pair(located, located.best_row).without
    assert said == wire.WithoutClass("chair", None, None, 0.0, False, "unknown")


def test_without_a_class_the_status_is_what_the_answer_would_say(loaded):
    said = set()
    for accept in (0.5, 0.9, 0.9995):
        localiser, _ = localised(loaded, building_update(), accept_probability=accept)
        located = localiser.ask()
        for found in explain_pair(located, located.best_row, methods=["layout"], accept_probability=accept).without:
            asked = localised(loaded, update_without(found.class_), accept_probability=accept)[1].matches
            assert found.status == asked.status
            said.add(found.status)
    assert said == {"match", "ambiguous"}


def test_any_place_has_the_probability_that_the_answer_would_list(loaded):
    localiser, result = localised(loaded, building_update())
    located = localiser.ask()
    _, longer = localised(loaded, building_update(), top_n=100)
    listed = {(of.map, of.place): of for of in longer.matches.matches}
    assert len(listed) > len(result.matches.matches)
    for (map_, place), of in listed.items():
        asked = explain_pair(located, loaded.row(map_, place), methods=["layout"])
        assert asked.probability == pytest.approx(of.probability, abs=1e-3)
        assert asked.position == of.position
    untested = Localiser(loaded, LocaliserConfig(rerank="none", explain_rate_hz=0)).update(building_update()).located
    rows = {loaded.row(of.map, of.place) for of in untested.matches.matches}
    other = min(set(range(loaded.n_places)) - rows)
    assert explain_pair(untested, other, methods=["attention"]).probability is None
