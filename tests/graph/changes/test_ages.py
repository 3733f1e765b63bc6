"""Ages are metres walked since an id last changed, whatever the stream repeats."""

import pytest

from semloc_core.graph.changes.ages import Ages
from semloc_core.graph.changes.drift import SHIFT_M, DriftMeter
from semloc_core.graph.changes.stream import UpdateStream
from semloc_core.wire.messages import Object, Odometry, Place, SceneGraphUpdate

STILL = (0.0, 0.0, 0.0, 1.0)


def update(seq, x, objects, full=False):
    places = [Place(f"p{i}", (float(i), 0.0, 0.0)) for i in range(20)] if full else []
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=seq,
        frame_id="odom",
        seq=seq,
        full=full,
        places=places,
        objects=[Object(key, "chair", position) for key, position in objects.items()],
        edges=[],
        query_place="p0",
        odometry=Odometry((x, 0.0, 0.0), STILL),
    )


def fed(*updates):
    stream, ages = UpdateStream(), Ages()
    for each in updates:
        _, change = stream.apply(each)
        if stream.graph is not None and change is not None:
            ages.update(stream.graph, change, each.odometry)
    return ages


def test_an_object_that_is_sent_again_as_it_was_keeps_its_age():
    a, b = {"a": (1.0, 0.0, 0.0)}, {"b": (2.0, 0.0, 0.0)}
    ages = fed(update(0, 0.0, a, full=True), update(1, 4.0, b), update(2, 6.0, a | b, full=True), update(3, 7.0, {}))
    assert ages("a") == pytest.approx(7.0)
    assert ages("b") == pytest.approx(3.0)
    assert ages("nobody") == 0.0


def test_an_object_that_moved_is_new_again():
    ages = fed(update(0, 0.0, {"a": (1.0, 0.0, 0.0)}, full=True), update(1, 5.0, {"a": (1.1, 0.0, 0.0)}))
    assert ages("a") == 0.0


def test_an_age_outlives_a_gap_in_the_stream():
    a = {"a": (1.0, 0.0, 0.0)}
    ages = fed(update(0, 0.0, a, full=True), update(5, 3.0, {}), update(6, 8.0, a, full=True))
    assert ages("a") == pytest.approx(8.0)


def test_a_robot_that_stands_still_grows_no_ages():
    a = {"a": (1.0, 0.0, 0.0)}
    steps = [update(i, 0.1 * (i % 2), {}) for i in range(1, 50)]
    assert fed(update(0, 0.0, a, full=True), *steps)("a") == 0.0


def test_drift_is_what_objects_move_by_that_are_written_anew():
    meter = DriftMeter()
    for _ in range(19):
        meter.add(SHIFT_M * 2**0.5, 1.0, 0.0)
    assert meter.drift is None, "too little to go by"
    meter.add(SHIFT_M * 2**0.5, 1.0, 0.0)
    assert meter.drift == pytest.approx(1.0)
    meter.add(3.0, 1.0, 0.0)  # carried elsewhere by somebody
    assert meter.drift == pytest.approx(1.0)
