"""Numbers at the ends of their range: every probability is one, whatever lies where; nothing overflows on the way."""

from __future__ import annotations

import itertools
import math
import os
import tempfile
import warnings
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from small_building import CLASSES, building_update, make_map, make_model

from semloc_core.config import MATCH_RADIUS_M, LocaliserConfig
from semloc_core.errors import GraphError, MessageError
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.wire import codec as wire
from semloc_core.wire.codec import Object, Place, SceneGraphUpdate

EXAMPLES = int(os.environ.get("SEMLOC_SOAK", "0")) or 40  # set by `make soak`
ROUNDED = 2e-6
"""What six decimals lose, of a few."""
ENDS = (
    0.0, -0.0, 5e-324, -5e-324, 1e-308, 1e-9, 0.8, 1.0, -1.0, 4.0, 12.0, 13.0, 15.4,
    1e5, 1e5 + 1.0, -1e5, 1e8, 1e9, -1e9,
)  # fmt: skip
COORDINATES = st.one_of(st.sampled_from(ENDS), st.floats(-20.0, 20.0), st.floats(-1e9, 1e9))
POSITIONS = st.one_of(
    st.tuples(COORDINATES, COORDINATES, COORDINATES),
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.just(0.0)),
)


@st.composite
def graphs(draw: st.DrawFn) -> SceneGraphUpdate:
    """Places in a chain and objects, many of them at the same few points."""
    points = draw(st.lists(POSITIONS, min_size=1, max_size=5))
    places = draw(st.lists(st.sampled_from(points), min_size=1, max_size=8))
    objects = draw(
        st.lists(st.tuples(st.sampled_from(points), st.integers(0, 20), st.sampled_from(CLASSES)), max_size=12)
    )
    return full(places, [(at, parent % len(places), name) for at, parent, name in objects], draw(st.integers(0, 7)))


def full(
    places: list[tuple[float, float, float]], objects: list[tuple[tuple[float, float, float], int, str]], query: int = 0
) -> SceneGraphUpdate:
    """A full update of places in a chain, and objects with a parent and a class."""
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=0,
        frame_id="odom",
        seq=0,
        full=True,
        places=[Place(f"p{i}", at) for i, at in enumerate(places)],
        objects=[Object(f"o{i}", name, at) for i, (at, _, name) in enumerate(objects)],
        edges=[
            *((f"p{i}", f"p{i + 1}") for i in range(len(places) - 1)),
            *((f"p{p}", f"o{i}") for i, (_, p, _) in enumerate(objects)),
        ],
        query_place=f"p{query % len(places)}",
    )


def check(loaded: LoadedMap, *updates: SceneGraphUpdate, filters: bool = True) -> None:
    """Answers with all that there is, and looks at every number."""
    asked = [Localiser(loaded, LocaliserConfig(top_n=100))]
    if filters:
        explained = LocaliserConfig(filter="bayes", explain_rate_hz=1000.0, explainer="class_shapley")
        asked.append(Localiser(loaded, explained))
    for update, localiser in itertools.product(updates, asked):
        with np.errstate(over="raise", invalid="raise", divide="raise"), warnings.catch_warnings():
            warnings.simplefilter("error")
            result = localiser.update(wire.encode(update))
        assert result.matches is not None
        check_message(result.matches)
        for message in (result.matches, result.attributions):
            if message is not None:
                wire.decode(wire.encode(message), type(message))
        for kept in localiser._filter._kept if localiser._filter is not None else ():
            assert np.isfinite(kept.pose).all()
            assert (kept.chance >= 0).all()
            assert kept.chance.sum() <= 1.0 + 1e-9


def check_message(message: wire.PlaceMatches) -> None:
    for match in [*message.matches, *message.rivals, *(message.raw_matches or [])]:
        assert 0.0 <= match.probability <= 1.0
        assert -1.0 - 1e-6 <= match.similarity <= 1.0 + 1e-6
    apart: list[wire.Match] = []
    for match in message.matches:
        if all(
            match.map != other.map or math.dist(match.position, other.position) > 2 * MATCH_RADIUS_M for other in apart
        ):
            apart.append(match)
    assert sum(match.probability for match in apart) <= 1.0 + ROUNDED * len(apart)
    chances = [match.probability for match in message.matches]
    assert all(chances[0] >= chance for chance in chances), "an answer below a likelier one"


@pytest.fixture(scope="module")
def model():
    return make_model("rings")


@settings(max_examples=EXAMPLES)
@given(mapped=graphs(), seen=st.lists(graphs(), min_size=1, max_size=3))
def test_every_probability_is_one_wherever_things_lie(model, mapped, seen):
    with tempfile.TemporaryDirectory() as folder:
        loaded = make_map(Path(folder) / "a.map", model, a=mapped, b=building_update(6, 5))
        check(loaded, mapped, *seen)


def scattered(n: int, side_m: float, seed: int = 0, flat: bool = True) -> list[tuple[float, float, float]]:
    """Points at random in a square."""
    points = np.random.default_rng(seed).uniform(0.0, side_m, (n, 3))
    return [(x, y, 0.0 if flat else z) for x, y, z in points.tolist()]


def things(points: list[tuple[float, float, float]], places: int) -> list[tuple[tuple[float, float, float], int, str]]:
    return [(at, i % places, CLASSES[i % len(CLASSES)]) for i, at in enumerate(points)]


ORIGIN, FAR = (0.0, 0.0, 0.0), (1e5, -1e5, 1e5)
CORNERS = {
    "one place, one object at it": ([ORIGIN], things([ORIGIN], 1)),
    "negative zero": ([(-0.0, -0.0, -0.0), (1.0, -0.0, 0.0)], things([(-0.0, 0.0, -0.0)], 2)),
    "the least numbers": ([(5e-324, 1e-308, -5e-324), (1e-308, 0.0, 0.0)], things([(1e-308, -1e-308, 0.0)] * 3, 2)),
    "the largest numbers": ([(1e9, -1e9, 1e9), (-1e9, 1e9, -1e9)], things([(1e9, 1e9, 1e9), (-1e9, -1e9, -1e9)], 2)),
    "all places at a point": ([ORIGIN] * 50, things([(1.0, 0.0, 0.0)] * 20, 50)),
    "all objects at a point": (scattered(30, 8.0), things([(3.0, 3.0, 1.0)] * 200, 30)),
    "objects far off": (scattered(30, 8.0), things([FAR] * 20, 30)),
    "objects at the places": (scattered(30, 8.0), things(scattered(30, 8.0), 30)),
    "all of it far off": ([(x + 1e5, y + 1e5, 0.0) for x, y, _ in scattered(30, 8.0)], things([FAR] * 5, 30)),
    "5,000 objects": (scattered(60, 20.0), things(scattered(5000, 20.0, 1, flat=False), 60)),
}


def test_answers_apart_share_what_there_is(model, tmp_path):
    """Two were each believed as much as the best one left, together more than there is."""
    chairs = [((0.0, y, 0.0), 0, "chair") for y in (0.0, 0.0, 0.0, 9.0)]
    mapped = full([(0.0, 0.0, 0.0), (0.0, 9.0, 0.0)], chairs)
    check(make_map(tmp_path / "a.map", model, a=mapped, b=building_update(6, 5)), mapped)


@pytest.mark.parametrize("case", CORNERS)
def test_corners(case, model, tmp_path):
    """As a map, asked from itself and from another building; and as what a robot sees in another building."""
    places, objects = CORNERS[case]
    corner, home = full(places, objects, len(places) // 2), building_update(30, 20)
    check(make_map(tmp_path / "corner.map", model, corner=corner, home=home), corner, home)
    check(make_map(tmp_path / "home.map", model, home=home), home, corner)


@pytest.mark.parametrize(("n", "filters"), [(1, True), (1500, True), (20_000, False)])
def test_numbers_of_places(n, filters, model, tmp_path):
    """The filter reads 20,000 places in 17 s: too long for a test."""
    grid = [(float(i % 200), float(i // 200), 0.0) for i in range(n)]
    update = full(grid, things(scattered(500, 100.0), n), query=n // 2)
    check(make_map(tmp_path / "hall.map", model, hall=update), building_update(30, 20), update, filters=filters)


@pytest.mark.parametrize("coordinate", [1e308, -1e308, 1.0000001e9, float("inf"), float("nan")])
def test_what_is_no_position_is_refused(coordinate, model, tmp_path):
    localiser = Localiser(make_map(tmp_path / "home.map", model, home=building_update()))
    update = full([(0.0, coordinate, 0.0)], [])
    text = wire.encode(full([(0.0, 7.5, 0.0)], [])).replace(b"7.5", repr(coordinate).encode())
    with pytest.raises(GraphError):
        localiser.update(update)
    with pytest.raises((GraphError, MessageError)):
        localiser.update(text)
    assert localiser.live.stream.graph is None
