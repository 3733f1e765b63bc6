# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Why the node says what it says: attributions, the explain service, requests, and a process that dies."""

import time

import building
from conftest import wait_for

from semloc_core import wire
from semloc_core.map_database import load


def updates(**options):
    return [step.update for step in building.steps(building.corridor(), **options)]


def test_explain_answers_by_every_explainer(localiser, client):
    from semloc_core.explain import EXPLAINERS

    localiser()
    side = client().connect()
    answer = side.call("explain")
    assert not answer.success
    assert "expected a query" in answer.message
    side.send(updates()[0])
    side.wait_matches(1)
    answer = side.call("explain")
    assert answer.success, answer.message
    explanation = wire.decode(answer.message, wire.Explanation)
    assert [said.method for said in explanation.methods][-1] == "layout"
    assert len(explanation.methods) == len(EXPLAINERS) + 1
    asked = updates()[0]
    assert (explanation.query_place, explanation.stamp_ns) == (asked.query_place, asked.stamp_ns)
    top = side.matches[-1].matches[0]
    assert (explanation.match_map, explanation.match_place) == (top.map, top.place)


def test_any_pair_can_be_asked_about(localiser, client, assets):
    localiser()
    side = client().connect()
    run = updates()
    side.send(run[0])
    side.wait_matches(1)
    place = load(assets / "home.map").place_ids[3]
    query = run[0].places[0].id
    side.request("not a request")
    side.request(
        wire.ExplainRequest(
            "semloc/explain_request/1", 5, "", 42, query_place=query, map="home", place=place, methods=["attention"]
        )
    )
    side.request(wire.ExplainRequest("semloc/explain_request/1", 5, "", 43, place="nowhere"))
    found = wait_for(lambda: len(m := side.messages("explanations", wire.Explanation)) == 2 and m, "two answers")
    assert [e.seq for e in found] == [42, 43]
    assert (found[0].query_place, found[0].match_place, len(found[0].methods)) == (query, place, 1)
    assert "nowhere" in found[1].error


def test_a_slow_explainer_holds_up_no_match_and_attention_answers(localiser, client, assets):
    node = localiser(
        map=str(assets / "attention.map"), explainer="shapley_sampling", explain_deadline_s=0.01, explain_rate_hz=1000.0
    )
    side = client().connect()
    for count, update in enumerate(updates()[:4], 1):
        side.send(update)
        side.wait_matches(count)
        wait_for(lambda count=count: len(side.attributions) == count, "attributions")
    assert {a.method for a in side.attributions} == {"attention"}
    assert node._session.explaining.counts.late == 4


def test_the_explaining_process_may_die(localiser, client):
    node = localiser(explain_rate_hz=1000.0)
    side = client().connect()
    run = updates()
    side.send(run[0])
    wait_for(lambda: len(side.attributions) == 1)
    wait_for(lambda: node._session.explaining._ready, "the process")
    node._session.explaining._process.kill()
    time.sleep(0.3)
    side.send(run[1])
    wait_for(lambda: len(side.attributions) == 2, "attributions without the process")


def test_the_test_that_decided_is_taken_apart_where_it_is_asked_for(localiser, client):
    localiser(explainer="layout", explain_rate_hz=1000.0)
    side = client().connect()
    side.send(updates()[0])
    top = side.wait_matches(1)[-1].matches[0]
    wait_for(lambda: len(side.attributions) == 1, "attributions")
    (said,) = side.attributions
    assert (said.method, said.match_map, said.match_place) == ("layout", top.map, top.place)
    assert said.objects
    assert sum(of.score for of in said.classes) > 0
    assert abs(said.completeness_gap) < 1e-5
