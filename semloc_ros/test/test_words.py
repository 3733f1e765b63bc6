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
"""A robot whose detector has other names than the map: parameters join them, at the start and while the node runs."""

import building
import msgspec
import pytest
from conftest import wait_for

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.localiser import Localiser
from semloc_core.map_database import load

OTHERS = {"couch": "settee", "painting": "picture", "plant": "houseplant", "shelf": "shelving"}
"""Other names of the map's classes, which the shipped cross-walk knows."""


def updates(names=OTHERS, **options):
    for step in building.steps(building.corridor(), **options):
        things = [
            msgspec.structs.replace(thing, class_=names.get(thing.class_, thing.class_))
            for thing in step.update.objects
        ]
        yield msgspec.structs.replace(step.update, objects=things)


def answers(loaded, run, **options):
    """The core's, as a subscriber has them."""
    core = Localiser(loaded, LocaliserConfig(**options))
    return [wire.decode(wire.encode(core.update(update).matches), wire.PlaceMatches) for update in run]


def state(node):
    return node._state_machine.current_state[1]


@pytest.fixture
def home(assets):
    return load(assets / "home.map")


def test_other_names_are_the_maps_from_the_start(localiser, client, home):
    localiser(synonyms="auto")
    side = client().connect()
    run = list(updates())[:5]
    expected = answers(home, updates(names={}))
    for i, update in enumerate(run, 1):
        side.send(update)
        assert side.wait_matches(i)[-1].matches == expected[i - 1].matches
    assert expected[0].matches != answers(home, run)[0].matches, "expected the names to matter"


def test_they_are_joined_while_the_node_runs_and_no_update_is_needed_anew(localiser, client, home, tmp_path):
    node = localiser()
    side = client().connect()
    run = list(updates())
    (tmp_path / "names.yaml").write_text("synonyms: {settee: couch, picture: painting}")
    (tmp_path / "other.yaml").write_text("synonyms: {settee: zeppelin}")
    told = [{}, {"synonyms": "auto"}, {"synonyms": str(tmp_path / "names.yaml")}, {"synonyms": ""}]
    for i, said in enumerate(told):
        if said:
            assert side.set(**said)[0].successful
        side.send(run[i])
        answer = side.wait_matches(i + 1)[-1]
        assert answer.matches == answers(home, run[: i + 1], **said)[-1].matches
    for bad in (str(tmp_path / "other.yaml"), str(tmp_path / "nowhere.yaml")):
        refused = side.set(synonyms=bad)[0]
        assert not refused.successful
        assert refused.reason.startswith("expected")
    assert not side.set(labelspace="no such labelspace")[0].successful
    assert node.get_parameter("synonyms").value == ""


def test_numbers_are_read_by_a_labelspace(localiser, client, home, tmp_path):
    rows = "\n".join(f"- {{name: {name}, ids: [{40 + i}]}}" for i, name in enumerate(building.CLASSES))
    (tmp_path / "space.yaml").write_text(f"name: mine\nclasses:\n{rows}\n")
    localiser(labelspace=str(tmp_path / "space.yaml"))
    side = client().connect()
    numbers = {name: f"class_{40 + i}" for i, name in enumerate(building.CLASSES)}
    side.send(next(updates(names=numbers)))
    assert side.wait_matches(1)[-1].matches == answers(home, [next(updates(names={}))])[0].matches


def test_a_file_that_is_not_right_is_told_in_a_line_at_configure(localiser, tmp_path, capfd):
    (tmp_path / "other.yaml").write_text("synonyms: {settee: zeppelin}")
    node = localiser(synonyms=str(tmp_path / "other.yaml"))
    assert state(node) == "unconfigured"
    (line, *_) = [line for line in capfd.readouterr().err.splitlines() if "configure failed" in line]
    assert "zeppelin" in line
    assert "Traceback" not in line


def test_a_reset_forgets_the_graph_and_not_the_words(localiser, client, home, tmp_path):
    path = tmp_path / "names.yaml"
    path.write_text("".join(["synonyms:\n", *(f"  {other}: {name}\n" for name, other in OTHERS.items())]))
    localiser(synonyms=str(path))
    side = client().connect()
    path.unlink()
    assert side.call("reset").success
    side.send(next(updates()))
    assert side.wait_matches(1)[-1].matches == answers(home, [next(updates(names={}))])[0].matches
    wait_for(lambda: side.diagnostics("localisation"), "diagnostics")
