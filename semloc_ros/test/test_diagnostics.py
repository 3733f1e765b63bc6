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
"""What diagnostics say, and that what is drawn and said has the time of the update that it is about."""

import time

import building
import rclpy
from conftest import wait_for
from diagnostic_msgs.msg import DiagnosticStatus
from visualization_msgs.msg import Marker

from semloc_core import wire


def updates(**options):
    return [step.update for step in building.steps(building.corridor(), **options)]


def test_diagnostics_say_what_is_going_on(localiser, client):
    localiser(stale_after_s=0.5)
    side = client().connect()
    wait_for(lambda: (d := side.diagnostics("localisation")) and "no update has come yet" in d.message, "no input")
    run = updates()
    for update in run[:2]:
        side.send(update)
    wait_for(lambda: "stale input" in side.diagnostics("localisation").message, "stale input")

    def says(text):
        for _ in range(200):
            side.send(full)
            if text in side.diagnostics("localisation").message:
                return True
            time.sleep(0.05)
        return False

    full = run[0]
    assert says("localised: home") or says("ambiguous: home")
    fields = {name: getattr(run[0], name) for name in run[0].__struct_fields__}
    full = type(run[0])(**fields | {"query_place": None})
    assert says("unknown: no query place")
    values = {v.key: v.value for v in side.diagnostics("localisation").values}
    assert float(values["latency p99 (ms)"]) > 0
    map_values = {v.key: v.value for v in side.diagnostics(": map").values}
    assert len(map_values["map hash"]) == len(map_values["model hash"]) == 64


def message_of(side, line="localisation"):
    status = side.diagnostics(line)
    return status.message if status is not None else ""


def status_while(side, send, condition, line="localisation"):
    """Go on sending until a line of diagnostics meets a condition."""

    def met():
        send()
        status = side.diagnostics(line)
        return status is not None and condition(status) and status

    return wait_for(met, f"diagnostics of {line}")


def localised(side, run):
    """Have the localiser answer, and say so."""
    return status_while(side, lambda: side.send(run[0]), lambda s: s.message.startswith(("localised", "ambiguous")))


def test_garbage_only_is_an_error_and_the_next_full_update_mends_it(localiser, client):
    localiser(stale_after_s=1.0)
    side = client().connect()
    run = updates()
    localised(side, run)
    status = status_while(side, lambda: side.send("no update"), lambda s: s.level == DiagnosticStatus.ERROR)
    assert "none could be applied for" in status.message
    assert "malformed (the last one: expected" in status.message
    assert side.diagnostics(": updates").level == DiagnosticStatus.ERROR
    localised(side, run)


def test_a_mapper_that_starts_again_with_changes_only_is_an_error(localiser, client, capfd):
    localiser(stale_after_s=1.0)
    side = client().connect()
    run = updates(full_every_s=1000.0)
    for count, update in enumerate(run[:30], 1):
        side.send(update)
        side.wait_matches(count)
    capfd.readouterr()
    repeated = iter(run[1:29] * 1000)
    begun = time.monotonic()
    status = status_while(side, lambda: side.send(next(repeated)), lambda s: s.level == DiagnosticStatus.ERROR)
    assert "none could be applied for" in status.message
    assert "a mapper that starts again must begin with a full update" in status.message
    said = [line for line in capfd.readouterr().err.splitlines() if "update not used" in line]
    assert 1 <= len(said) <= time.monotonic() - begun + 2  # one line a second, not one an update
    localised(side, run)


def test_updates_that_are_applied_but_not_answered_are_an_error(localiser, client, monkeypatch):
    node = localiser(stale_after_s=1.0)
    side = client().connect()
    run = updates()
    localised(side, run)

    def broken(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(node._session.worker, "_on_answer", broken)
    monkeypatch.setattr("semloc_core.localiser.Localiser.locate", broken)
    status = status_while(side, lambda: side.send(run[0]), lambda s: s.level == DiagnosticStatus.ERROR)
    assert "updates are applied, but none was answered for" in status.message


def test_a_node_that_is_not_configured_says_so_and_why(localiser, client):
    node = localiser(start=False)
    side = client()
    status = status_while(side, lambda: None, lambda s: s.message.startswith("unconfigured: waits for"))
    assert status.level == DiagnosticStatus.WARN
    node.set_parameters([rclpy.parameter.Parameter("map", value="/nowhere/at/all.map")])
    node.trigger_configure()
    status = status_while(side, lambda: None, lambda s: s.level == DiagnosticStatus.ERROR)
    assert "unconfigured: configure failed: expected" in status.message
    assert "/nowhere/at/all.map" in status.message


def test_autostart_tries_again_until_the_map_is_there(localiser, client, assets, tmp_path):
    localiser(map=str(tmp_path / "late.map"))
    side = client()
    status_while(side, lambda: None, lambda s: s.level == DiagnosticStatus.ERROR and "late.map" in s.message)
    (tmp_path / "late.map").write_bytes((assets / "home.map").read_bytes())
    side.connect()
    localised(side, updates())


def test_diagnostics_name_the_places_that_could_be_it_and_say_when_there_is_no_graph(localiser, client):
    node = localiser(accept_probability=1.0)
    side = client().connect()
    run = updates()
    side.send(run[0])
    assert side.wait_matches(1)[0].status == "ambiguous"
    wait_for(lambda: message_of(side).startswith("ambiguous: home"), "ambiguous")
    assert ", or home (" in message_of(side) or not side.matches[-1].rivals
    side.send(run[2])
    wait_for(lambda: message_of(side).startswith("no graph"), "no graph")
    assert side.diagnostics("localisation").level == DiagnosticStatus.ERROR
    node.trigger_deactivate()
    wait_for(lambda: message_of(side).startswith("inactive"), "inactive")


def test_a_building_that_has_changed_is_said_with_the_classes_that_are_responsible(localiser, client):
    localiser(accept_probability=0.0, explain_rate_hz=1000.0, stale_after_s=60.0)
    side = client().connect()

    def walk(change, begin):
        for count, update in enumerate(updates(distance_m=30.0, rate_hz=2.0, full_every_s=1000.0), begin + 1):
            fields = {name: getattr(update, name) for name in update.__struct_fields__}
            things = [change(item) for item in update.objects]
            side.send(type(update)(**fields | {"objects": things}))
            for topic in ("matches", "attributions"):
                seen = side.seen[f"/localiser/{topic}"]
                wait_for(lambda seen=seen, count=count: len(seen) == count, f"{count} {topic}")
        return count

    end = walk(lambda item: item, 0)
    wait_for(lambda: message_of(side, "lost or changed?").startswith("as in the map"), "nothing unusual")
    walk(lambda item: wire.Object(item.id, "lamp", item.position), end)  # as long as the window
    time.sleep(1.5)
    wait_for(lambda: message_of(side, "lost or changed?").startswith("changed?"), "the change")
    status = side.diagnostics("lost or changed?")
    assert status.level == DiagnosticStatus.WARN
    assert "more lamp" in status.message
    values = {v.key: v.value for v in status.values}
    for kind in ("classes", "attributions"):
        assert 0.4 < float(values[f"{kind}: distance from the map"]) <= 1.0
        assert "lamp" in values[f"{kind}: responsible"]


def test_what_is_drawn_and_said_has_the_updates_stamp(localiser, client):
    localiser(accept_probability=0.0, explain_rate_hz=1000.0)
    side = client().connect()
    wait_for(lambda: side.node.count_publishers("/localiser/markers"))
    time.sleep(0.5)
    update = updates()[0]
    side.send(update)
    wait_for(lambda: any(m.ns == "attributions" for a in side.seen["/localiser/markers"] for m in a.markers))
    headers = [m.header for a in side.seen["/localiser/markers"] for m in a.markers if m.action == Marker.ADD]
    headers += [message.header for message in side.seen["/localiser/pose"]]
    assert {h.stamp.sec * 10**9 + h.stamp.nanosec for h in headers} == {update.stamp_ns}
    assert {m.stamp_ns for m in [*side.matches, *side.attributions]} == {update.stamp_ns}
