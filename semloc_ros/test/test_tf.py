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
"""The transform from a building's frame to that of the updates: when it is sent, when not, and what tf2 makes of it."""

import math
import time
from types import SimpleNamespace

import building
import pytest
import rclpy
from conftest import wait_for
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from semloc_ros.tf import Steady
from test_pure import answer, match
from tf2_msgs.msg import TFMessage

from semloc_core import wire
from semloc_ros import conversions, qos

S = 1_000_000_000
START = 1_000 * S


def updates(**options):
    given = {"shared_frame": True, "frame_id": "odom", **options}
    return [step.update for step in building.steps(building.corridor(), **given)]


# -- the rules ------------------------------------------------------------------------------------------------------


def located(status="match", at_s=0.0, yaw=0.25, building_name="home", frame_id="map", map_hash="a", tested=True):
    """An answer at so many seconds."""
    transform = wire.Transform((1.0, 2.0, 0.0), yaw) if tested and status in ("match", "ambiguous") else None
    found = answer(match(1, (0.0, 0.0, 0.0), 0.9, building_name), status=status)
    fields = {name: getattr(found, name) for name in found.__struct_fields__}
    info = wire.MapInfo("home.map", map_hash, 40)
    changed = {"stamp_ns": START + round(at_s * S), "transform": transform, "map": info, "frame_id": frame_id}
    return wire.PlaceMatches(**fields | changed)


class Told:
    """The rules, with clocks that the test sets."""

    def __init__(self):
        self.lines = []
        self.steady = Steady(self.lines.append)

    def answer(self, found, child="odom", late_s=0.0, tolerance_s=1.0):
        """What is sent when an answer comes, seconds after its update was made."""
        now = found.stamp_ns + round(late_s * S)
        return self.steady.answer(found, child, now, now, tolerance_s)

    def tick(self, at_s, steady_s=None, tolerance_s=1.0):
        """What is sent at so many seconds, by a clock that may have jumped."""
        now = START + round(at_s * S)
        return self.steady.tick(now, now if steady_s is None else START + round(steady_s * S), tolerance_s)


def test_nothing_is_sent_before_the_first_match():
    told = Told()
    assert told.tick(0.0) is None
    assert told.answer(located("ambiguous", 0.1)) is None
    assert told.answer(located("unknown", 0.2)) is None
    assert told.tick(0.3) is None
    sent = told.answer(located("match", 0.4))
    assert (sent.parent, sent.child, sent.transform.yaw) == ("map", "odom", 0.25)


def test_it_is_stamped_ahead_of_the_clock_and_sent_again_through_ambiguous_answers():
    told = Told()
    assert told.answer(located(at_s=0.0), late_s=0.3, tolerance_s=0.5).stamp_ns == START + S * 8 // 10
    assert told.tick(0.4, tolerance_s=0.5).stamp_ns == START + S * 9 // 10
    assert told.answer(located("ambiguous", 0.5, yaw=2.0)).transform.yaw == 0.25
    for i in range(6, 200):
        assert told.tick(i / 10).transform.yaw == 0.25
    assert told.answer(located(at_s=20.0, yaw=-1.0)).transform.yaw == -1.0


def test_a_clock_that_stands_still_has_nothing_said_twice():
    told = Told()
    assert told.answer(located()) is not None
    assert told.tick(0.0, steady_s=1.0) is None
    assert told.tick(0.1, steady_s=2.0) is not None


def test_the_updates_stamps_do_where_no_clock_runs():
    steady = Steady(lambda line: None)
    assert steady.answer(located(at_s=0.0), "odom", 0, 5, 1.0).stamp_ns == START + S
    assert steady.tick(0, 6, 1.0) is None
    assert steady.answer(located(at_s=0.2), "odom", 0, 7, 1.0).stamp_ns == START + S * 12 // 10
    assert steady.tick(START + S * 3 // 10, 8, 1.0) is not None  # it begins to run: that is no jump


@pytest.mark.parametrize("status", ["unknown", "no_graph"])
def test_it_is_silent_after_three_seconds_without_an_idea_until_the_next_match(status):
    told = Told()
    told.answer(located())
    assert told.answer(located(status, 1.0)) is not None
    assert told.tick(3.9) is not None
    assert told.tick(4.0) is None
    assert told.answer(located("ambiguous", 4.1)) is None
    assert told.tick(4.2) is None
    assert told.answer(located(at_s=4.3)) is not None
    assert told.tick(9.0) is not None


def test_an_ambiguous_answer_ends_the_three_seconds():
    told = Told()
    told.answer(located())
    told.answer(located("unknown", 1.0))
    told.answer(located("ambiguous", 3.0))
    told.answer(located("unknown", 3.5))
    assert told.tick(6.4) is not None
    assert told.tick(6.5) is None


CHANGES = {
    "it is told to forget": lambda told: told.steady.forget(),
    "the clock goes back": lambda told: told.tick(-2.0, steady_s=0.1),
    "the clock leaps ahead": lambda told: told.tick(100.0, steady_s=0.1),
    "another map answers": lambda told: told.answer(located("ambiguous", 0.1, map_hash="b")),
    "updates name another frame": lambda told: told.answer(located("ambiguous", 0.1), "odom2"),
    "the run begins again": lambda told: told.answer(located("ambiguous", -1.0), late_s=1.1),
    "a match elsewhere was not tested": lambda told: told.answer(located(at_s=0.1, building_name="b", tested=False)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_it_is_silent_after_a_change_until_the_next_match(change):
    told = Told()
    assert told.answer(located()) is not None
    assert change(told) is None
    now = told.steady._clock[0] / S - START / S + 0.1
    assert told.tick(now) is None
    assert told.answer(located("ambiguous", now + 0.1)) is None
    assert told.answer(located(at_s=now + 0.2, map_hash="b")) is not None


def test_simulated_time_may_go_fast_or_wait():
    told = Told()
    told.answer(located())
    assert told.tick(2.5, steady_s=0.02) is not None  # a hundred times as fast, forty ticks a second
    assert told.tick(62.5, steady_s=60.1) is not None  # a process that was held up


def test_another_building_has_another_parent():
    told = Told()
    told.answer(located(frame_id="home"))
    assert told.answer(located(at_s=0.1, building_name="other", frame_id="other", yaw=1.0)).parent == "other"
    assert told.tick(0.2).parent == "other"


@pytest.mark.parametrize(("parent", "child"), [("map", "map"), ("map", "/map"), ("map", "")])
def test_frames_that_can_not_be_joined_are_refused_in_one_line(parent, child):
    told = Told()
    for i in range(5):
        assert told.answer(located(at_s=i, frame_id=parent), child) is None
        assert told.tick(i + 0.5) is None
    (line,) = told.lines
    assert "expected" in line
    assert "\n" not in line


# -- the node ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def tf(spin):
    """What comes on /tf."""
    seen = []
    node = spin(rclpy.create_node("tf_listener"))
    node.create_subscription(TFMessage, "/tf", lambda m: seen.extend(m.transforms), qos.TRANSFORMS)
    return SimpleNamespace(seen=seen, node=node)


def stamp_ns(transform):
    return transform.header.stamp.sec * S + transform.header.stamp.nanosec


def quiet(tf, seconds=0.5):
    """Whether nothing comes any more."""
    time.sleep(0.3)
    count = len(tf.seen)
    time.sleep(seconds)
    return len(tf.seen) == count


def test_nothing_is_sent_by_default(localiser, client, tf):
    localiser()
    side = client().connect()
    side.send(updates()[0])
    assert side.wait_matches(1)[0].status == "match"
    assert quiet(tf)
    assert tf.seen == []


def test_the_transform_is_the_messages_stamped_ahead_and_sent_again_and_again(localiser, client, tf):
    node = localiser(publish_tf=True, transform_tolerance=0.5)
    side = client().connect()
    wait_for(lambda: tf.node.count_publishers("/tf"))
    before = node.get_clock().now().nanoseconds
    side.send(updates()[0])
    wait_for(lambda: len(tf.seen) >= 12, "a dozen transforms")
    after = node.get_clock().now().nanoseconds
    expected = side.wait_matches(1)[0].transform
    for sent in tf.seen[:12]:
        assert (sent.header.frame_id, sent.child_frame_id) == ("map", "odom")
        shift, turn = sent.transform.translation, sent.transform.rotation
        assert (shift.x, shift.y, shift.z) == pytest.approx(expected.translation, abs=1e-6)
        assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(expected.yaw, abs=1e-6)
    stamps = [stamp_ns(sent) for sent in tf.seen[:12]]
    assert stamps == sorted(set(stamps))
    assert before + S // 2 <= stamps[0]
    assert stamps[-1] <= after + S // 2
    assert (stamps[-1] - stamps[1]) / 10 == pytest.approx(0.1 * S, rel=0.5)


def test_reset_map_swap_and_deactivation_silence_it_until_the_next_match(localiser, client, tf, assets):
    node = localiser(publish_tf=True)
    side = client().connect()
    run = updates()

    def silenced(change):
        side.send(run[0])
        wait_for(lambda: not quiet(tf, 0.3), "transforms")
        change()
        assert quiet(tf)

    silenced(lambda: side.call("reset"))
    silenced(lambda: side.set(map=str(assets / "attention.map")))
    silenced(lambda: side.set(publish_tf=False))
    assert side.set(publish_tf=True)[0].successful
    silenced(lambda: side.set(frame_id="elsewhere"))
    silenced(node.trigger_deactivate)


def test_equal_frames_are_refused_in_one_line(localiser, client, tf, capfd):
    localiser(publish_tf=True)
    side = client().connect()
    for count, update in enumerate(updates(frame_id="map")[:4], 1):
        side.send(update)
        side.wait_matches(count)
    assert quiet(tf)
    assert tf.seen == []
    assert len([line for line in capfd.readouterr().err.splitlines() if "no transform is sent" in line]) == 1


def test_it_follows_a_simulated_clock_and_is_silent_after_a_jump(localiser, client, tf, spin):
    node = localiser(publish_tf=True, use_sim_time=True)
    side = client().connect()
    clock = spin(rclpy.create_node("clock")).create_publisher(Clock, "/clock", 10)
    wait_for(lambda: clock.get_subscription_count(), "the clock to be heard")
    run = updates()
    now = run[0].stamp_ns

    def to(stamp):
        clock.publish(Clock(clock=conversions.time_msg(stamp)))
        wait_for(lambda: node.get_clock().now().nanoseconds == stamp, "the clock")
        time.sleep(0.05)

    to(now)
    side.send(run[0])
    wait_for(lambda: tf.seen, "a transform")
    assert stamp_ns(tf.seen[-1]) == now + S
    assert quiet(tf)  # time stands still, and so does this
    for _ in range(10):
        now += S // 10
        to(now)
    wait_for(lambda: stamp_ns(tf.seen[-1]) == now + S, "the latest transform")
    to(now - 10 * S)
    for i in range(1, 5):
        to(now - 10 * S + i * S // 10)
    assert quiet(tf)
    count = len(tf.seen)
    side.send(run[0])  # the bag loops
    wait_for(lambda: len(tf.seen) > count, "a transform after a match")


def test_tf2_finds_the_robot_in_the_map(localiser, client, spin):
    tf2_ros = pytest.importorskip("tf2_ros")
    localiser(publish_tf=True)
    side = client().connect()
    listening = spin(rclpy.create_node("listening"))
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer, listening, spin_thread=False)
    (update, *_) = updates()
    side.send(update)
    clock = listening.get_clock()
    # What is stamped a second ahead holds from a second on.
    wait_for(lambda: buffer.can_transform("map", "odom", clock.now()), "a transform that holds now")
    found = buffer.lookup_transform("map", "odom", clock.now()).transform
    pose, here = side.wait_matches(1)[0].matches[0].pose, update.odometry
    yaw = 2 * math.atan2(found.rotation.z, found.rotation.w)
    x, y, _ = here.position
    assert math.cos(yaw) * x - math.sin(yaw) * y + found.translation.x == pytest.approx(pose.position[0], abs=1e-4)
    assert math.sin(yaw) * x + math.cos(yaw) * y + found.translation.y == pytest.approx(pose.position[1], abs=1e-4)
    listener.unregister()


def test_two_robots_in_namespaces_have_a_tree_each_by_remapping(spin, assets, tf):
    from semloc_ros.node import LocaliserNode

    nodes, seen = {}, {}
    for name in ("one", "two"):
        values = {"map": str(assets / "home.map"), "publish_tf": True, "frame_id": f"{name}/map"}
        nodes[name] = spin(
            LocaliserNode(
                namespace=name,
                cli_args=["--ros-args", "-r", "/tf:=tf"],
                parameter_overrides=[Parameter(key, value=value) for key, value in values.items()],
            )
        )
        nodes[name].start()
        seen[name] = []
        tf.node.create_subscription(
            TFMessage, f"/{name}/tf", lambda m, name=name: seen[name].extend(m.transforms), qos.TRANSFORMS
        )
    from conftest import Client

    for name in nodes:
        side = Client(spin(rclpy.create_node(f"client_{name}", namespace=name)), f"/{name}/localiser").connect()
        side.send(updates(frame_id=f"{name}/odom")[0])
        wait_for(lambda name=name: seen[name], f"transforms of {name}")
    for name in nodes:
        assert {(s.header.frame_id, s.child_frame_id) for s in seen[name]} == {(f"{name}/map", f"{name}/odom")}
    assert tf.seen == []
