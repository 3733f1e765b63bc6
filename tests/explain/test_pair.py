"""Any pair explained: counterfactuals that hold when replayed, contrasts that add up, requests that can't be met."""

import numpy as np
import pytest
import torch
from small_building import building_update, make_map, make_model

from semloc_core import wire
from semloc_core.config import MATCH_RADIUS_M, LocaliserConfig
from semloc_core.errors import GraphError
from semloc_core.explain.explainers.by_name import EXPLAINERS
from semloc_core.explain.pair import answer_query, explain_pair
from semloc_core.localiser import Localiser
from semloc_core.wire.messages import ExplainRequest

BY_SIMILARITY = LocaliserConfig(rerank="none")
"""A counterfactual is of the search by similarity alone."""


@pytest.fixture(scope="module", params=["paper", "rings", "bag_of_words"])
def town(request, tmp_path_factory):
    """Two buildings that share place ids."""
    folder = tmp_path_factory.mktemp(request.param)
    model = make_model(request.param)
    return make_map(folder / "town.map", model, home=building_update(seed=0), work=building_update(seed=1, length=25))


def ask(query=None, building=None, place=None, methods=None):
    return ExplainRequest(
        schema="semloc/explain_request/1", stamp_ns=7, frame_id="", seq=3,
        query_place=query, map=building, place=place, methods=methods,
    )  # fmt: skip


def answer_request(localiser, request):
    return answer_query(localiser.ask(request.query_place), request)


@pytest.fixture
def robot(town):
    localiser = Localiser(town)
    localiser.update(building_update(seed=0, query="p9"))
    return localiser


def test_every_method_answers_and_the_message_goes_over_the_wire(robot):
    answer = answer_request(robot, ask(place="p12", building="work"))
    assert answer.error is None
    assert (answer.match_map, answer.match_place, answer.query_place, answer.seq) == ("work", "p12", "p9", 3)
    said = [method.method for method in answer.methods]
    assert len(said) == len(EXPLAINERS) + 1
    assert set(said) - {"closed_form", "layout"} <= set(EXPLAINERS)
    assert wire.decode(wire.encode(answer), wire.Explanation).match_place == "p12"
    assert wire.encode(answer) == wire.encode(answer_request(robot, ask(place="p12", building="work")))


def test_null_means_the_last_query_and_its_top_match(robot):
    answer = answer_request(robot, ask(methods=["saliency"]))
    top = robot.locate().matches.matches[0]
    assert (answer.match_map, answer.match_place) == (top.map, top.place)
    assert answer.similarity == pytest.approx(top.similarity, abs=1e-5)
    assert answer.why_not is None
    assert [method.method for method in answer.methods] == ["saliency"]
    best_of_work = answer_request(robot, ask(building="work", methods=["saliency"]))
    assert best_of_work.match_map == "work"


def test_the_top_match_is_the_published_one_not_the_most_similar(town):
    """Some query's answer differs from the search's; there the published place is explained, and contrasted with."""
    differ = 0
    for place in [f"p{i}" for i in range(0, 24, 2)]:
        robot = Localiser(town)
        matches = robot.update(building_update(seed=0, query=place, length=24)).matches
        published = matches.matches[0]
        answer = answer_request(robot, ask(methods=["saliency"]))
        assert (answer.match_map, answer.match_place) == (published.map, published.place)
        assert answer.why_not is None
        raw = matches.raw_matches[0]
        if (raw.map, raw.place) == (published.map, published.place):
            continue
        differ += 1
        why = answer_request(robot, ask(building=raw.map, place=raw.place, methods=["saliency"])).why_not
        assert (why.map, why.place) == (published.map, published.place)
        listed = [(match.map, match.place) for match in matches.matches]
        if (raw.map, raw.place) in listed:
            assert why.rank == listed.index((raw.map, raw.place)) + 1
        else:
            assert why.rank == len(listed) + 1  # nothing is more similar than it
    assert differ > 0


def test_a_question_is_of_the_filters_answer_and_no_observation_of_its(town):
    robot, unasked = (Localiser(town, LocaliserConfig(filter="bayes")) for _ in range(2))
    for seq, place in enumerate(["p4", "p5", "p6"]):
        matches = [r.update(building_update(seed=0, query=place, seq=seq)).matches for r in (robot, unasked)]
        assert matches[0] == matches[1]
        top = matches[0].matches[0]
        for query in (None, place):
            answer = answer_request(robot, ask(query=query, methods=["saliency"]))
            assert (answer.match_map, answer.match_place) == (top.map, top.place)
        answer_request(robot, ask(query="p12", methods=["saliency"]))


def test_a_counterfactual_holds_when_its_objects_are_really_gone(town):
    """The update is sent again without the objects named: the most similar place must be the one named."""
    checked = 0
    for place in ("p3", "p9", "p14", "p20"):
        update = building_update(seed=0, query=place)
        localiser = Localiser(town)
        published = localiser.update(update).matches
        found = answer_request(localiser, ask(methods=["saliency"])).counterfactual
        if not found.removed:
            assert (found.map, found.place, found.similarity) == (None, None, None)
            continue
        checked += 1
        gone = {item.id for item in found.removed}
        rest = wire.SceneGraphUpdate(
            schema=update.schema, stamp_ns=0, frame_id="", seq=0, full=True, places=update.places,
            objects=[o for o in update.objects if o.id not in gone],
            edges=[e for e in update.edges if not gone & set(e)], query_place=place,
        )  # fmt: skip
        before = (published.raw_matches or published.matches)[0]
        again = Localiser(town, BY_SIMILARITY).update(rest).matches.matches[0]
        assert again.similarity == pytest.approx(found.similarity, abs=1e-5)
        if found.place != again.place:  # another place of the same similarity
            tied = town.embeddings[town.row(found.map, found.place)] @ town.embeddings[town.row(again.map, again.place)]
            assert tied == pytest.approx(1, abs=1e-4)
        old, new = town.row(before.map, before.place), town.row(found.map, found.place)
        far = np.linalg.norm(town.positions[old] - town.positions[new]) > MATCH_RADIUS_M
        assert far or town.building_index[old] != town.building_index[new]
    assert checked > 0


def test_a_contrast_adds_up_to_the_difference(robot, town):
    answer = answer_request(robot, ask(place="p20", building="home", methods=["class_shapley"]))
    why = answer.why_not
    query = robot.locate().query
    z = query.encoded.embedding[0].numpy()
    row, top = town.row("home", "p20"), town.row(why.map, why.place)
    direction = town.embeddings[row] - town.embeddings[top]
    encoder = town.model.encoder
    with torch.no_grad():
        empty = encoder(query.batch, keep=~query.batch.is_object)[0].numpy()
    assert sum(c.score for c in why.classes) == pytest.approx(float(direction @ z - direction @ empty), abs=1e-5)
    better = int((town.embeddings @ z > answer.similarity + 1e-6).sum())
    assert 1 <= better < why.rank + 1
    assert why.similarity >= answer.similarity
    magnitudes = [abs(c.score) for c in why.classes]
    assert magnitudes == sorted(magnitudes, reverse=True)


@pytest.mark.parametrize(
    ("request_", "line"),
    [
        (ask(query="nowhere"), "expected a query to explain"),
        (ask(place="p99"), "expected a place id that one building of the map has"),
        (ask(place="p3"), "home, work"),
        (ask(place="p3", building="garage"), "expected one of the map's buildings"),
        (ask(methods=["tea_leaves"]), "expected explainers among"),
    ],
)
def test_what_can_not_be_answered_says_why_in_one_line(robot, request_, line):
    answer = answer_request(robot, request_)
    assert line in answer.error
    assert "\n" not in answer.error
    assert answer.methods == []
    wire.encode(answer)


def test_no_graph(town):
    answer = answer_request(Localiser(town), ask())
    assert "expected a query to explain" in answer.error


def test_a_query_that_was_not_embedded_is_refused(town):
    localiser = Localiser(town)
    localiser.update(building_update(query=None))
    with pytest.raises(GraphError, match="no query place"):
        explain_pair(localiser.locate(), 0)
