"""Online evaluation: what a walk reveals, and that arrays give the answers that the localiser gives on the stream."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from semloc_core.config import LocaliserConfig
from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model, embed_graph
from semloc_core.errors import GraphError
from semloc_core.evaluate.online.agreement import Agreement
from semloc_core.evaluate.online.answers import make_walks, steps_at, verdict
from semloc_core.evaluate.online.fragments import answered, embed_walk
from semloc_core.evaluate.online.protocol import evaluate_online
from semloc_core.evaluate.relocalise import make_arena, read_buildings
from semloc_core.evaluate.verified_answers import Past, fragments_along, layout_verifier, reranked
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap, MapDatabase, load
from semloc_core.metrics import accepted_share
from semloc_core.metrics.rows import Row
from semloc_core.sources.simulate.walks import Walk, WalkConfig, walk
from semloc_core.sources.world import World, write_world
from semloc_core.tracking import FrameFilter, frame_filter
from semloc_core.wire.messages import SceneGraphUpdate

NOISY = WalkConfig(distance_m=15.0, flicker_rate=0.3, object_noise_m=0.5, place_noise_m=0.1)


def stream(walk: Walk, labelspace: Labelspace) -> Iterator[SceneGraphUpdate]:
    """The walk as a robot would publish it: one full update, then deltas."""
    whole = walk.graph.to_scene_graph(labelspace).to_update(0, 0, "odom")
    known_places: set[str] = set()
    known_objects: set[str] = set()
    for step in range(walk.steps):
        places = {i for i, seen in zip(walk.graph.place_ids, walk.seen_places[step], strict=True) if seen}
        objects = {i for i, seen in zip(walk.graph.object_ids, walk.seen_objects[step], strict=True) if seen}
        nodes, new = places | objects, (places - known_places) | (objects - known_objects)
        yield SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=step,
            frame_id="odom",
            seq=step,
            full=step == 0,
            places=[p for p in whole.places if p.id in new],
            objects=[o for o in whole.objects if o.id in new],
            edges=[(a, b) for a, b in whole.edges if a in nodes and b in nodes and (a in new or b in new)],
            query_place=walk.graph.place_ids[walk.places[step]],
            removed_nodes=sorted(known_objects - objects),
        )
        known_places, known_objects = places, objects


def test_chance_is_how_often_a_place_drawn_at_random_is_right(small_worlds: list[World], tmp_path: Path) -> None:
    """A success of 0.43 says nothing in a home of which 4 m around the robot are 43 %."""
    for index, world in enumerate(small_worlds):
        (tmp_path / f"b{index}").mkdir()
        for part in ("map", "query"):
            write_world(tmp_path / f"b{index}" / f"{part}.json", world)
    rows = evaluate_online(tmp_path, encoders=("rings",), walks=2, scopes_m=(0.0, 5.0), filtered=False, bound=False)
    chance = {(row["method"], row["home"], row["scope"]): float(row["chance"] or 0) for row in rows}
    assert len(chance) == 8
    buildings = read_buildings(tmp_path)
    arena = make_arena(buildings, buildings[0].map.labelspace)
    paths = make_walks(arena, WalkConfig(distance_m=5.0), 2, 0)
    rng = np.random.default_rng(0)
    for home in ("any", "known"):
        drawn = []
        for path in paths:
            pool = np.flatnonzero((arena.building == path.building) | (home == "any"))
            best = rng.choice(pool, (1, 20_000))
            drawn.append(verdict(arena, path, np.array([0]), best, 4.0)[0].mean())
        assert chance["rings", home, "0m"] == pytest.approx(np.mean(drawn), abs=0.01)
        assert chance["rings + layout", home, "0m"] == chance["rings", home, "0m"]
    assert 0 < chance["rings", "any", "0m"] < chance["rings", "known", "0m"] < 1


@pytest.mark.parametrize("name", ["rings", "bag_of_words", "paper", "geodesic_attention"])
def test_a_walk_in_arrays_is_answered_as_its_stream_is(
    name: str, small_worlds: list[World], small_arrays: GraphArrays
) -> None:
    space = small_worlds[0].labelspace
    model = Model(build_encoder(name, None, len(space)).eval(), space)
    database = embed_graph(model, small_arrays)
    loaded = LoadedMap(
        "small", "", model, ("small",), small_arrays.place_ids, small_arrays.place_positions,
        np.zeros(small_arrays.n_places, dtype=np.int32), database,
    )  # fmt: skip
    localiser = Localiser(loaded, LocaliserConfig(explain_rate_hz=0.0))
    path = walk(small_arrays, NOISY, np.random.default_rng(1))
    embedded, asked = embed_walk(model, path), answered(path)
    answers = 0
    for step, update in enumerate(stream(path, space)):
        located = localiser.update(update).located
        assert located is not None
        if located.query.encoded is None:
            assert not asked[step] or not embedded[step].any()
            continue
        answers += 1
        z = located.query.encoded.embedding[0].numpy()
        np.testing.assert_allclose(embedded[step], z, atol=2e-6)
        best = located.matches.matches[0].similarity
        assert best == pytest.approx(float((database @ embedded[step]).max()), abs=1e-5)
    assert answers > path.steps / 2


def test_the_filter_on_arrays_believes_what_the_localiser_does(
    small_worlds: list[World], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The map's three buildings, a walk in the second; odometry is the way from place to place."""
    space = small_worlds[0].labelspace
    model = Model(build_encoder("rings", None, len(space)), space)
    maps = [GraphArrays.from_scene_graph(w.graph, space, n) for n, w in zip("abc", small_worlds, strict=True)]
    with MapDatabase.create(tmp_path / "abc.map", model) as database:
        for arrays, world in zip(maps, small_worlds, strict=True):
            database.add_building(
                arrays.name, world.graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays)
            )
    loaded = load(tmp_path / "abc.map")
    monkeypatch.setattr(frame_filter, "APART_M", 5.0)  # the buildings are small
    path = walk(maps[1], WalkConfig(distance_m=40.0), np.random.default_rng(2))
    every = np.arange(path.steps)
    verifier = layout_verifier(tuple(maps), len(space))
    fragments = fragments_along(path, every, verifier, np.random.default_rng(0))
    similarity = embed_walk(model, path) @ loaded.embeddings.T
    past, chances = Past(FrameFilter(), loaded.buildings, path.metres), np.zeros(path.steps)
    reranked(verifier, fragments, similarity, chances=chances, past=past)
    localiser = Localiser(loaded, LocaliserConfig(explain_rate_hz=0.0, filter="bayes"))
    plain = Localiser(loaded, LocaliserConfig(explain_rate_hz=0.0))
    answers = alike = differ = 0
    for step, update in enumerate(stream(path, space)):
        answer, unfiltered = localiser.update(update).matches, plain.update(update).matches
        assert answer is not None
        assert unfiltered is not None
        if not answer.matches or not chances[step]:
            continue
        answers += 1
        found = answer.matches[0]
        alike += abs(found.probability - chances[step]) < 0.02
        differ += abs(found.probability - unfiltered.matches[0].probability) > 1e-6
    assert answers > path.steps / 2
    assert alike > 0.9 * answers, "odometry's way and the walk's differ by a rounding at most"
    assert differ, "the filter never spoke: nothing was tested"


def test_a_walk_goes_along_edges_and_remembers_what_was_in_range(small_arrays: GraphArrays) -> None:
    path = walk(small_arrays, WalkConfig(distance_m=30.0, range_m=3.0), np.random.default_rng(0))
    edges = {tuple(edge) for edge in small_arrays.place_edges.T.tolist()}
    for a, b in zip(path.places[:-1].tolist(), path.places[1:].tolist(), strict=True):
        assert (min(a, b), max(a, b)) in edges
    steps = np.linalg.norm(np.diff(path.truth(), axis=0), axis=1)
    np.testing.assert_allclose(np.diff(path.metres), steps, atol=1e-6)
    assert path.metres[-2] < 30.0 <= path.metres[-1]
    assert not (path.seen_places[:-1] & ~path.seen_places[1:]).any()
    assert path.seen_places[np.arange(path.steps), path.places].all()
    near = np.linalg.norm(small_arrays.place_positions - path.truth()[:, None], axis=2) <= 3.0
    assert not (path.seen_places & ~np.logical_or.accumulate(near, axis=0)).any()
    child, parent = small_arrays.object_parents
    for step in range(path.steps):
        seen = np.zeros(small_arrays.n_objects, dtype=bool)
        seen[child[path.seen_places[step, parent]]] = True
        assert (seen == path.seen_objects[step]).all()


def test_noise_and_flicker_do_not_change_the_way(small_arrays: GraphArrays) -> None:
    plain, noisy = (
        walk(small_arrays, config, np.random.default_rng(3)) for config in (WalkConfig(distance_m=15.0), NOISY)
    )
    assert (plain.places == noisy.places).all()
    assert (plain.truth() == noisy.truth()).all()
    assert not np.array_equal(plain.graph.place_positions, noisy.graph.place_positions)
    gone = noisy.seen_objects[:-1] & ~noisy.seen_objects[1:]
    assert gone.any()


def test_a_building_with_nowhere_to_go_is_an_error(small_arrays: GraphArrays) -> None:
    from dataclasses import replace

    alone = replace(small_arrays, place_edges=np.zeros((2, 0), dtype=np.int64))
    with pytest.raises(GraphError, match=r"expected a building with places to walk between \(got none\)"):
        walk(alone, WalkConfig(), np.random.default_rng(0))


def test_the_answer_at_a_distance_is_the_first_from_there_on(small_arrays: GraphArrays) -> None:
    path = walk(small_arrays, WalkConfig(distance_m=20.0), np.random.default_rng(0))
    at = steps_at(path, (0.0, 5.0, 20.0))
    assert at[0] == 0
    assert at[2] == path.steps - 1
    assert path.metres[at[1] - 1] < 5.0 <= path.metres[at[1]]


def test_the_true_place_explains_all_that_a_perfect_detector_saw(small_arrays: GraphArrays) -> None:
    """With no tolerance too: distances in the fragment are longer than in the map only by way of unseen places."""
    path = walk(small_arrays, WalkConfig(distance_m=1.0), np.random.default_rng(5))
    classes = int(small_arrays.object_classes.max()) + 1
    steps = np.arange(path.steps)
    unexplained = Agreement([small_arrays], classes).unexplained(path, steps, 4.0)
    assert unexplained.shape == (path.steps, small_arrays.n_places)
    assert (unexplained[steps, path.places] == 0).all()
    assert (unexplained > 0).any()


def test_an_object_that_should_have_been_seen_speaks_against_a_place(small_arrays: GraphArrays) -> None:
    path = walk(small_arrays, WalkConfig(distance_m=1.0), np.random.default_rng(5))
    blind = Walk(
        path.graph,
        path.positions,
        path.places,
        path.metres,
        path.seen_places,
        np.zeros_like(path.seen_objects),
    )
    classes = int(small_arrays.object_classes.max()) + 1
    unexplained = Agreement([small_arrays], classes).unexplained(blind, np.array([0]), 6.0)
    d = walk(small_arrays, WalkConfig(distance_m=1.0, range_m=4.0), np.random.default_rng(5)).seen_objects[0].sum()
    assert unexplained[0, path.places[0]] == d


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, small_worlds: list[World]) -> Path:
    """Three buildings, each queried with its own map."""
    folder = tmp_path_factory.mktemp("online")
    for name, world in zip("abc", small_worlds, strict=True):
        (folder / name).mkdir()
        for part in ("map", "query"):
            write_world(folder / name / f"{part}.json", world)
    return folder


def figures(rows: list[Row], method: str, home: str, filter_: str = "none") -> dict[str, float]:
    return {
        str(row["scope"]): float(row["success@1"] or 0.0)
        for row in rows
        if (row["method"], row["home"], row["filter"]) == (method, home, filter_)
    }


def test_a_robot_finds_itself_once_it_has_seen_the_building(root: Path) -> None:
    rows = evaluate_online(root, encoders=("rings",), walks=4, scopes_m=(0.0, 60.0))
    assert {row["filter"] for row in rows if row["method"] == "rings + layout"} == {"none", "bayes"}
    filtered = figures(rows, "rings + layout", "any", "bayes")
    assert filtered["60m"] > 0.9
    any_, known = figures(rows, "rings", "any"), figures(rows, "rings", "known")
    assert filtered["0m"] == figures(rows, "rings + layout", "any")["0m"], "the first answer has no past"
    assert list(any_) == ["0m", "60m"]
    assert any_["60m"] > 0.9
    assert any_["60m"] > any_["0m"]
    assert all(known[scope] >= any_[scope] for scope in any_)
    assert rows == evaluate_online(root, encoders=("rings",), walks=4, scopes_m=(0.0, 60.0))
    bound = figures(rows, "agreeing places, perfect detector", "any")
    assert bound["60m"] > bound["0m"] > 0


def test_walks_are_by_number_of_places_and_a_model_of_fewer_classes_walks_the_same(root: Path) -> None:
    space = Labelspace("mine", ("plant", "couch", "computer"))
    given = Model(build_encoder("rings", None, 3), space)
    rows = evaluate_online(root, encoders=("rings",), models=[given], walks=3, scopes_m=(0.0, 30.0), bound=False)
    methods = {row["method"] for row in rows}
    names = {"rings", f"rings {given.hash[:8]}"}
    assert methods == names | {f"{name} + layout" for name in names}
    assert {row["queries"] for row in rows} == {rows[0]["queries"]}
    assert 7 <= int(rows[0]["queries"] or 0) <= 11


def test_a_carried_robot_is_right_again_and_a_foreign_building_can_be_told(root: Path) -> None:
    rows = evaluate_online(
        root, encoders=("rings",), walks=2, scopes_m=(0.0, 40.0), kidnapped=True, foreign=True, bound=False
    )
    by = {(row["filter"], row["scope"]): row for row in rows if row["home"] == "any" and row["method"] != "rings"}
    for name in ("none", "bayes"):
        carried = by[name, "kidnapped"]
        assert carried["recovered"] == 1.0
        assert 0 <= float(carried["metres_until_right"] or 0) <= float(carried["metres_until_right_p90"] or 0) < 40
        for scope in ("0m", "40m"):
            accepted = by[name, f"foreign {scope}"]["foreign_accepted"]
            assert accepted is not None
            assert 0 <= float(accepted) <= 1
    assert float(by["bayes", "foreign 40m"]["foreign_accepted"] or 0) < 1


def test_the_threshold_keeps_nine_of_ten_right_answers() -> None:
    home = np.arange(20.0)
    right = home >= 10
    figures = accepted_share(home, np.array([0.0, 10.5, 11.0, 30.0]), right)
    assert figures == {"foreign_accepted": 0.75, "wrong_accepted": 0.0}
    assert accepted_share(home, home, home < 0)["foreign_accepted"] is None


@pytest.mark.data
def test_rings_gain_with_every_metre_on_real_homes(data_root: Path, tmp_path: Path) -> None:
    for home in ("Onaga", "Pomaria"):
        (tmp_path / home).symlink_to(data_root / "gibson" / home)
    rows = evaluate_online(tmp_path, encoders=("rings",), walks=10, scopes_m=(0.0, 10.0, 40.0), bound=False)
    found = list(figures(rows, "rings", "any").values())
    assert found[0] < found[1] < found[2]
    assert found[2] > 0.7


def figure(row: Row, name: str) -> float:
    """A figure that the row must have; it may be exactly 0."""
    value = row[name]
    assert isinstance(value, float)
    return value


def test_the_peer_is_registered_against_every_building_and_finds_its_pose(root: Path) -> None:
    rows = evaluate_online(
        root, encoders=("rings",), walks=2, scopes_m=(0.0, 30.0), bound=False, filtered=False, verified=False, peer=True
    )
    peer = {row["scope"]: row for row in rows if row["method"] == "clipper"}
    assert peer["30m"]["queries"] == rows[0]["queries"]
    assert peer["30m"]["success@1"] == 1.0, "the same objects are there as in the map"
    # In a frame of the robot's own: a heading that were not undone would be off by tens of degrees.
    assert figure(peer["30m"], "position_error_m_p90") < 0.5
    assert figure(peer["30m"], "heading_error_deg_p90") < 3.0


def test_the_peer_is_judged_in_the_frame_as_it_has_drifted(root: Path) -> None:
    """Of a frame that has drifted once in the building and once where the robot wrote it, a quarter would be wrong."""
    rows = evaluate_online(
        root,
        encoders=("rings",),
        config=WalkConfig(drift=5.0),
        walks=4,
        scopes_m=(10.0,),
        bound=False,
        filtered=False,
        verified=False,
        peer=True,
    )
    (peer,) = (row for row in rows if row["method"] == "clipper")
    assert figure(peer, "success@1") == 1.0
    assert figure(peer, "position_error_m") < 0.5
    assert figure(peer, "heading_error_deg") < 4.0
