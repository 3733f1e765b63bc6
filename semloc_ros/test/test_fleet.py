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
"""The node on a map that a real server keeps: as on the file, without the server, and with it again."""

import itertools
import time

import building
import msgspec
import pytest
from conftest import wait_for
from diagnostic_msgs.msg import DiagnosticStatus
from map_server import Line, MapServer
from rclpy.lifecycle import TransitionCallbackReturn

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.encoding import embed_graph
from semloc_core.graph import GraphArrays
from semloc_core.localiser import Localiser
from semloc_core.map_database import load

NAMES = itertools.count()
SOON = {"server_timeout_s": 1.0, "server_poll_s": 0.1}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    pytest.importorskip("milvus_lite")
    running = MapServer(tmp_path_factory.mktemp("milvus"))
    yield running
    running.stop()


@pytest.fixture
def name():
    return f"map_{next(NAMES)}"


@pytest.fixture
def line(server):
    between = Line(server.port)
    yield between
    between.stop()


def address(port, name):
    return f"milvus+http://127.0.0.1:{port}/{name}"


def updates(**options):
    return [step.update for step in building.steps(building.corridor(), **options)]


def published(answer):
    """The same as a subscriber has it: the wire rounds."""
    return wire.decode(wire.encode(answer), wire.PlaceMatches)


def plain(answer):
    """An answer without its latency."""
    return wire.encode(msgspec.structs.replace(answer, latency_ms=None))


def state(node):
    return node._state_machine.current_state[1]


def test_answers_are_those_on_the_file(localiser, client, assets, server, name):
    server.keep(name, assets / "home.map")
    localiser(map=address(server.port, name), frame_id="home", explain_rate_hz=1000.0)
    side = client().connect()
    run = updates()[:15]
    core = Localiser(load(assets / "home.map"), LocaliserConfig(frame_id="home", explain_rate_hz=1000.0))
    for i, update in enumerate(run, 1):
        side.send(update)
        answer, expected = side.wait_matches(i)[-1], core.update(wire.encode(update))
        same = msgspec.structs.replace(expected.matches.map, name=name)  # a server's map has a name of its own
        assert plain(answer) == wire.encode(msgspec.structs.replace(expected.matches, map=same))
    wait_for(lambda: side.attributions and side.attributions[-1].seq == run[-1].seq, "attributions of the last answer")
    diagnosis = wait_for(lambda: side.diagnostics("map server"), "diagnostics")
    assert diagnosis.level == DiagnosticStatus.OK
    assert name in diagnosis.message
    assert "40 places" in side.diagnostics("map").message
    marked = wait_for(lambda: side.seen["/localiser/map_markers"], "the map to be drawn")
    wait_for(lambda: any(m.ns == "places of home" for m in marked[-1].markers), "the buildings to be drawn")
    assert side.call("explain").success


def test_other_names_are_those_of_the_servers_map(localiser, client, assets, server, name):
    server.keep(name, assets / "home.map")
    others = {"couch": "settee", "painting": "picture", "shelf": "shelving"}
    localiser(map=address(server.port, name), synonyms="auto")
    side = client().connect()
    core = Localiser(load(assets / "home.map"))
    for i, update in enumerate(updates()[:3], 1):
        things = [
            msgspec.structs.replace(thing, class_=others.get(thing.class_, thing.class_)) for thing in update.objects
        ]
        side.send(msgspec.structs.replace(update, objects=things))
        assert side.wait_matches(i)[-1].matches == published(core.update(wire.encode(update)).matches).matches


def test_a_node_that_starts_before_its_server_waits_and_says_so(localiser, client, assets, server, name, capfd):
    server.keep(name, assets / "home.map")
    line = Line(server.port, up=False)
    node = localiser(map=address(line.port, name), **SOON)
    assert state(node) == "active"
    assert "no map yet" in capfd.readouterr().err
    side = client().connect()
    run = updates()
    for i, update in enumerate(run[:3], 1):
        side.send(update)
        answer = side.wait_matches(i)[-1]
        assert (answer.status, answer.matches, answer.map, answer.model) == ("no_graph", [], None, None)
    diagnosis = wait_for(lambda: side.diagnostics("map server"), "diagnostics")
    assert diagnosis.level == DiagnosticStatus.ERROR
    assert "no map for" in diagnosis.message
    assert side.diagnostics("map").level == DiagnosticStatus.ERROR
    assert "no map: " in side.diagnostics("localisation").message
    line.restore()
    # Nothing is sent meanwhile: the node tries by itself.
    wait_for(lambda: side.diagnostics("map server").level == DiagnosticStatus.OK, "the server to be found")
    side.send(run[3])
    answer = side.wait_matches(4)[-1]
    core = Localiser(load(assets / "home.map"))
    expected = [published(core.update(wire.encode(update)).matches) for update in run[:4]][-1]
    assert answer.matches == expected.matches
    assert answer.map.places == 40
    line.stop()


@pytest.mark.parametrize("how", ["cut", "silent"])
def test_a_lost_line_costs_answers_not_the_graph(localiser, client, assets, server, line, name, how):
    server.keep(name, assets / "home.map")
    localiser(map=address(line.port, name), **SOON)
    side = client().connect()
    run = updates()
    core = Localiser(load(assets / "home.map"))
    expected = [published(core.update(wire.encode(update)).matches) for update in run]
    for i in range(3):
        side.send(run[i])
        assert side.wait_matches(i + 1)[-1].matches == expected[i].matches
    if how == "cut":
        line.cut()
    else:
        line.silent = True
    sent = 3
    while side.matches[-1].status != "no_graph":  # a moment's answers may still go by what was asked just before
        assert sent < 20
        time.sleep(0.1)
        side.send(run[sent])
        sent += 1
        assert side.wait_matches(sent)[-1].seq == run[sent - 1].seq
    lost = side.matches[-1]
    assert (lost.matches, lost.rivals, lost.raw_matches) == ([], [], None)
    diagnosis = wait_for(lambda: side.diagnostics("map server").level == DiagnosticStatus.ERROR, "diagnostics")
    assert diagnosis
    started = time.monotonic()
    for _ in range(5):
        side.send(run[sent])
        sent += 1
        answer = side.wait_matches(sent)[-1]
        assert (answer.status, answer.seq) == ("no_graph", run[sent - 1].seq)
    assert time.monotonic() - started < 10.0, "answers waited for the server again and again"
    if how == "cut":
        line.restore()
    line.silent = False
    wait_for(lambda: side.diagnostics("map server").level == DiagnosticStatus.OK, "the server to be found again")
    side.send(run[sent])
    sent += 1
    assert side.wait_matches(sent)[-1].matches == expected[sent - 1].matches


def test_maps_are_swapped_between_file_and_server(localiser, client, assets, server, name):
    server.keep(name, assets / "home.map")
    there = address(server.port, name)
    node = localiser(**SOON)
    side = client().connect()
    run = updates()
    core = Localiser(load(assets / "home.map"))
    expected = [published(core.update(wire.encode(update)).matches) for update in run]
    side.send(run[0])
    assert side.wait_matches(1)[-1].map.name == "home"
    for i, (map_, called) in enumerate([(there, name), (str(assets / "home.map"), "home"), (there, name)], 1):
        assert side.set(map=map_)[0].successful
        side.send(run[i])
        answer = side.wait_matches(i + 1)[-1]
        assert answer.map.name == called
        assert answer.matches == expected[i].matches
    assert side.set(top_n=3)[0].successful  # on the same line
    reloaded = side.call("reload_map")
    assert reloaded.success
    assert name in reloaded.message
    for bad in ("milvus+http://127.0.0.1:1/nowhere", address(server.port, "unheard_of"), "milvus+ftp://x/y"):
        refused = side.set(map=bad)[0]
        assert not refused.successful
        assert "expected" in refused.reason
    assert node.get_parameter("map").value == there
    side.send(run[4])
    assert side.wait_matches(5)[-1].matches == expected[4].matches[:3]
    assert node.trigger_deactivate() == node.trigger_cleanup() == TransitionCallbackReturn.SUCCESS


@pytest.mark.parametrize("kept", ["file", "server"])
def test_only_the_buildings_of_a_site_are_asked(localiser, client, assets, server, name, kept):
    if kept == "server":
        server.keep(name, assets / "both.map")
    map_ = address(server.port, name) if kept == "server" else str(assets / "both.map")
    localiser(map=map_, buildings=["oth*"], **SOON)
    side = client().connect()
    run = updates()
    side.send(run[0])
    answer = side.wait_matches(1)[-1]
    assert {match.map for match in answer.matches} == {"other"}
    assert answer.map.places == 80
    assert not side.set(buildings=["attic*"])[0].successful
    for i, (patterns, wanted) in enumerate([(["home"], {"home"}), ([""], {"home", "other"})], 1):
        assert side.set(buildings=patterns)[0].successful
        side.send(run[i])
        found = side.wait_matches(i + 1)[-1]
        assert {match.map for match in [*found.matches, *found.raw_matches]} == wanted


def test_what_writers_do_to_the_map_is_noticed(localiser, client, assets, server, name):
    server.keep(name, assets / "home.map")
    localiser(map=address(server.port, name), explain_rate_hz=0.0, **SOON)
    side = client().connect()
    run = updates()
    sent = 0

    def answered():
        nonlocal sent
        side.send(run[sent % len(run)] if sent < len(run) else msgspec.structs.replace(run[0], seq=0))
        sent += 1
        time.sleep(0.05)
        return side.wait_matches(sent)[-1]

    assert {match.map for match in answered().matches} == {"home"}
    with server.change(name) as database:
        model = database.model

        def put(building_name, seed, put_):
            graph = building.corridor(seed=seed)
            arrays = GraphArrays.from_scene_graph(graph, model.labelspace, building_name)
            put_(building_name, graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays))

        put("annexe", 7, database.add_building)
        wait_for(lambda: "annexe" in {match.map for match in answered().matches}, "the building that was added")
        hashes = {side.matches[-1].map.hash}
        put("annexe", 8, database.replace_building)
        wait_for(lambda: answered().map.hash not in hashes, "the building that was replaced")
        assert side.matches[-1].status != "no_graph"
        database.remove_building("home")
        wait_for(lambda: {match.map for match in answered().matches} == {"annexe"}, "the building to go")
    assert "no_graph" not in {answer.status for answer in side.matches}
