"""Localising in buildings whose floors or rooms are alike: never a match where nothing tells twins apart."""

import numpy as np
import pytest
from small_building import make_map

from semloc_core.config import LocaliserConfig
from semloc_core.encoding.general import general_model
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.replay.traversal_score import on_wrong_storey, right_matches
from semloc_core.sources.simulate import SimulationConfig, simulate_traversal
from semloc_core.wire import Object, Place, SceneGraphUpdate

RISE_M = 2.8
FURNITURE = (("chair", 0.9, 1.4), ("tv", 2.3, 3.1), ("couch", 3.6, 1.7))
"""Class, x and y in the room, metres."""


def wing(level: int, rooms: list[tuple[tuple[str, float, float], ...]], pitch: float = 5.0):
    """Places every metre along a corridor and up its rooms, on a floor of its own; what stands in the rooms."""
    z = 0.4 + RISE_M * level
    at = {(x, 0) for x in range(round(pitch) * len(rooms))}
    at |= {(round(pitch) * k + x, y) for k in range(len(rooms)) for x in (1, 2, 3) for y in (1, 2, 3)}
    ids = {xy: f"p{level}-{xy[0]}-{xy[1]}" for xy in at}
    places = [Place(id=id_, position=(float(x), float(y), z)) for (x, y), id_ in sorted(ids.items())]
    objects, edges = [], []
    for (x, y), id_ in sorted(ids.items()):
        edges += [
            (id_, ids[n]) for n in ((x + 1, y), (x, y + 1)) if n in ids and (y == n[1] != 0 or x % 5 == 2 or not n[1])
        ]
    for k, items in enumerate(rooms):
        for i, (class_, x, y) in enumerate(items):
            name = f"o{level}-{k}-{i}"
            objects.append(Object(id=name, class_=class_, position=(pitch * k + x, y, z)))
            edges.append((ids[(round(pitch) * k + 2, 2)], name))
    return places, objects, edges


def update(*wings, stairs=()) -> SceneGraphUpdate:
    places, objects, edges = ([item for w in wings for item in w[i]] for i in range(3))
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1", stamp_ns=1, frame_id="map", seq=0, full=True,
        places=places, objects=objects, edges=[*edges, *stairs], query_place=None,
    )  # fmt: skip


def graph_of(full: SceneGraphUpdate) -> SceneGraph:
    graph = SceneGraph()
    graph.apply(full)
    return graph


def walk(loaded, graph, **config):
    """Answers along a walk, each with where the robot truly was, metres."""
    localiser = Localiser(loaded, LocaliserConfig(explain_rate_hz=0.0))
    options = SimulationConfig(**{"range_m": 8.0, "miss_rate": 0.0, "shared_frame": True, **config})
    for step in simulate_traversal(graph, options, np.random.default_rng(3)):
        yield localiser.update(step.update).matches, step.position


@pytest.fixture(scope="module")
def two_floors(tmp_path_factory):
    """Two floors joined by one flight without a place on it; of the furniture of four rooms one floor has it turned."""
    turned = tuple((class_, 4.5 - x, 4.0 - y) for class_, x, y in FURNITURE)
    more = (("bed", 1.2, 2.9), ("oven", 3.4, 3.4))
    rooms = [FURNITURE, turned, (*FURNITURE, more[0]), (*turned, more[1])]
    building = update(wing(0, rooms), wing(1, rooms[::-1]), stairs=[("p0-0-0", "p1-0-0")])
    return make_map(
        tmp_path_factory.mktemp("floors") / "a.map", general_model([graph_of(building)]), home=building
    ), building


def test_no_match_is_on_the_wrong_storey_and_on_stairs_an_answer_is_ambiguous_between_both(two_floors):
    loaded, building = two_floors
    assert set(loaded.storeys.tolist()) == {0, 1}
    levels, between = set(), 0
    for answer, truth in walk(loaded, graph_of(building), distance_m=90.0, start_place="p0-0-0"):
        if answer.status == "match":
            assert not on_wrong_storey(answer, "home", truth, loaded.same_storey), (answer.seq, truth)
            levels.add(loaded.storeys[loaded.row("home", answer.matches[0].place)])
        if 0.4 + 0.4 * RISE_M < truth[2] < 0.4 + 0.5 * RISE_M and answer.matches:
            between += 1
            assert answer.status != "match", truth
            if answer.status == "ambiguous":
                named = [answer.matches[0], *answer.rivals]
                assert {loaded.storeys[loaded.row("home", m.place)] for m in named} == {0, 1}
    assert levels == {0, 1}, "the walk is found on both floors"
    assert between, "the walk climbs the stairs"


def test_rooms_alike_are_ambiguous_with_the_twin_as_rival_until_the_walk_tells_them_apart(tmp_path):
    rooms = [FURNITURE, FURNITURE, FURNITURE]
    building = update(wing(0, rooms))
    loaded = make_map(tmp_path / "a.map", general_model([graph_of(building)]), home=building)
    said = []
    for answer, truth in walk(loaded, graph_of(building), distance_m=30.0, start_place="p0-7-2", range_m=3.0):
        said.append(answer.status)
        right = right_matches(answer, "home", truth, loaded.same_storey)
        if answer.status == "match":
            assert right[0], (answer.seq, truth)
        elif answer.status == "ambiguous" and len(said) == 1:
            named = np.array([m.position for m in [answer.matches[0], *answer.rivals]])
            assert np.linalg.norm(named - np.array(truth), axis=1).min() <= 4.0, "the truth is among the rivals"
            assert len(named) >= 3
    assert said[0] == "ambiguous"
    assert "match" in said, "the corridor's end tells them apart"
