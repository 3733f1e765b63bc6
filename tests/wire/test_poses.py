"""Poses as messages, as ROS has them and as evo reads them."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from semloc_core.config import LocaliserConfig
from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model, embed_graph
from semloc_core.graph.arrays import GraphArrays
from semloc_core.localiser import Localiser
from semloc_core.map_database import MapDatabase, load
from semloc_core.replay.recorded import POSE_TOPIC, replay
from semloc_core.sources import write_run
from semloc_core.sources.bag import POSE_WITH_COVARIANCE, read_messages
from semloc_core.sources.simulate import SimulationConfig, simulate_traversal
from semloc_core.sources.world import KINDS, draw_pair
from semloc_core.wire import PlaceMatches, decode, encode
from semloc_core.wire.messages import Pose
from semloc_core.wire.poses import TumWriter, quaternion_of, ros_covariance, yaw_of


@pytest.fixture(scope="module")
def home():
    return draw_pair(KINDS["home"], np.random.default_rng(21))[0]


@pytest.fixture(scope="module")
def loaded(home, tmp_path_factory):
    model = Model(build_encoder("rings", None, len(home.labelspace)).eval(), home.labelspace)
    file = tmp_path_factory.mktemp("map") / "home.map"
    with MapDatabase.create(file, model) as database:
        arrays = GraphArrays.from_scene_graph(home.graph, home.labelspace, "home")
        z = embed_graph(model, arrays)
        database.add_building("home", home.graph, arrays.place_ids, arrays.place_positions, z)
    return load(file)


def steps_of(home, **options):
    config = SimulationConfig.of(
        **{"distance_m": 12.0, "shared_frame": True, "frame_id": "home", "position_noise_m": 0.02, **options}
    )
    return list(simulate_traversal(home.graph, config, np.random.default_rng(3)))


def answers_of(loaded, updates, **options):
    localiser = Localiser(loaded, LocaliserConfig(explain_rate_hz=0.0, **options))
    return [decode(encode(localiser.update(update).matches), PlaceMatches) for update in updates]


@pytest.mark.parametrize("filter_", ["none", "bayes"])
def test_odometry_in_the_updates_frame_is_the_pose_transformed(home, loaded, filter_):
    steps = steps_of(home)
    for step, answer in zip(
        steps[-5:], answers_of(loaded, [s.update for s in steps], filter=filter_)[-5:], strict=True
    ):
        pose, transform = answer.matches[0].pose, answer.transform
        assert np.linalg.norm(np.subtract(pose.position, step.position)) < 0.15
        assert abs(math.remainder(pose.yaw - step.heading, 2 * math.pi)) < math.radians(3.0)
        odometry = step.update.odometry
        c, s = math.cos(transform.yaw), math.sin(transform.yaw)
        x, y, z = odometry.position
        moved = np.array([c * x - s * y, s * x + c * y, z]) + transform.translation
        np.testing.assert_allclose(pose.position, moved, atol=1e-4)
        turned = pose.yaw - yaw_of(odometry.orientation_xyzw) - transform.yaw
        assert math.remainder(turned, 2 * math.pi) == pytest.approx(0.0, abs=1e-4)
        assert np.linalg.eigvalsh(np.reshape(pose.covariance, (4, 4))).min() > 0
        assert all(match.pose is None for match in answer.raw_matches)


@pytest.mark.parametrize("frame", [None, "wheels"])
def test_odometry_of_another_frame_leaves_the_heading_unknown(home, loaded, frame):
    steps = steps_of(home)
    updates = [
        msgspec.structs.replace(s.update, odometry=msgspec.structs.replace(s.update.odometry, frame_id=frame))
        for s in steps
    ]
    answer, last = answers_of(loaded, updates)[-1], steps[-1]
    pose = answer.matches[0].pose
    assert pose.yaw is None
    covariance = np.reshape(pose.covariance, (4, 4))
    assert covariance[3, 3] == pytest.approx(math.pi**2 / 3, abs=1e-5)
    assert not covariance[3, :3].any()
    assert not covariance[:3, 3].any()
    # It is the query place's, not the robot's.
    assert np.linalg.norm(np.subtract(pose.position, home.graph.places[last.place])) < 0.15
    assert answer.transform is not None, "the transform's yaw is known all the same"


def test_nothing_tested_has_no_pose(home, loaded):
    first = steps_of(home)[0].update
    places = {place.id for place in first.places}
    bare = msgspec.structs.replace(first, objects=[], edges=[e for e in first.edges if places.issuperset(e)])
    (answer,) = answers_of(loaded, [bare])
    assert answer.transform is None
    (answer,) = answers_of(loaded, [first], rerank="none")
    assert answer.transform is None
    assert all(match.pose is None for match in answer.matches)


def test_a_full_that_repeats_what_is_known_changes_no_pose(home, loaded):
    """An object sent again unchanged keeps its age: publishers repeat everything every few seconds."""
    deltas = [s.update for s in steps_of(home, full_every_s=1e6, drift=1.0)]
    fulls = [s.update for s in steps_of(home, full_every_s=0.0, drift=1.0)]
    for a, b in zip(answers_of(loaded, deltas), answers_of(loaded, fulls), strict=True):
        assert a.transform == b.transform


def test_ros_covariance_has_no_roll_and_no_pitch():
    pose = Pose((0.0, 0.0, 0.0), 0.5, [float(i) for i in range(16)])
    full = np.reshape(ros_covariance(pose), (6, 6))
    np.testing.assert_array_equal(full[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])].ravel(), pose.covariance)
    assert not full[3:5].any()
    assert not full[:, 3:5].any()
    assert yaw_of(quaternion_of(-2.5)) == pytest.approx(-2.5)


def test_evo_reads_what_replay_writes(home, loaded, tmp_path):
    """evo's own program, as a process: the trajectory lies on the truth, unaligned, in place and in heading."""
    program = shutil.which("evo_ape", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")
    if program is None:
        pytest.skip("evo is not installed (extra test)")
    run, results, tum = tmp_path / "run.mcap", tmp_path / "results.mcap", tmp_path / "poses.tum"
    write_run(run, steps_of(home))
    with TumWriter(tum, loaded.buildings) as writer:
        summary = replay(run, loaded, LocaliserConfig(explain_rate_hz=0.0), results=results, tum=writer)
    assert writer.files == [tmp_path / "poses.truth.tum", tum]
    environment = {**os.environ, "HOME": str(tmp_path), "MPLBACKEND": "Agg"}
    for relation, most in (("trans_part", 0.3), ("angle_deg", 5.0)):
        command = [program, "tum", str(tmp_path / "poses.truth.tum"), str(tum), "--pose_relation", relation]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        (rmse,) = (float(line.split()[1]) for line in done.stdout.splitlines() if line.split()[:1] == ["rmse"])
        assert rmse < most
    row = summary.rows[-1]
    assert row["position_error_m"] < 0.15
    assert row["heading_error_deg"] < 3.0
    # The bag has the same poses, one for each match.
    messages = list(read_messages(results, {POSE_TOPIC: POSE_WITH_COVARIANCE}))
    lines = tum.read_text().splitlines()
    assert len(messages) == len(lines) == summary.statuses["match"]
    from rosbags.typesys import Stores, get_typestore

    first = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(messages[0].data, POSE_WITH_COVARIANCE)
    assert first.header.frame_id == "map"
    position = first.pose.pose.position
    np.testing.assert_allclose(
        [position.x, position.y, position.z], [float(v) for v in lines[0].split()[1:4]], atol=1e-6
    )
    assert first.pose.covariance.shape == (36,)


def test_of_several_buildings_each_has_a_file(tmp_path):
    writer = TumWriter(tmp_path / "t.tum", ["a", "b"])
    with writer:
        writer.truth("a", -1, (1.0, 2.0, 3.0), None)
        writer.truth("b", 1_500_000_000, (1.0, 2.0, 3.0), (0.0, 0.0, 1.0, 0.0))
    assert [file.name for file in writer.files] == ["t.a.truth.tum", "t.b.truth.tum"]
    assert (tmp_path / "t.b.truth.tum").read_text() == (
        "1.500000000 1.000000 2.000000 3.000000 0.000000 0.000000 1.000000 0.000000\n"
    )
