"""The map database: what goes in comes out, and a change is all or nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from map_cases import LABELS, ONE_LINE, Building, make_building, make_map, make_model, same

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model, embed_graph
from semloc_core.errors import MapError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.map_database import MapDatabase, describe, load
from semloc_core.sources.hydra import read_hydra


@pytest.fixture(scope="module")
def model() -> Model:
    return make_model()


@pytest.fixture
def path(tmp_path: Path, model: Model) -> Path:
    """A map of two buildings, at rest."""
    return make_map(tmp_path / "site.map", model)


def test_what_goes_in_comes_out(path: Path, model: Model) -> None:
    loaded = load(path)
    assert (loaded.name, loaded.buildings, loaded.n_places) == ("site", ("a", "b"), 19)
    assert loaded.model.hash == model.hash
    assert loaded.model.labelspace.hash == LABELS.hash
    assert loaded.embeddings.dtype == np.float32
    assert loaded.embeddings.flags.c_contiguous
    assert loaded.building_index.tolist() == [0] * 7 + [1] * 12
    for name, seed, count in (("a", 2, 7), ("b", 1, 12)):
        graph, ids, positions, embeddings = make_building(model, count, seed)
        rows = loaded.rows_of(name)
        assert list(loaded.place_ids[rows]) == ids
        np.testing.assert_array_equal(loaded.positions[rows], positions)
        np.testing.assert_array_equal(loaded.embeddings[rows], embeddings)
        stored = loaded.graph(name)
        assert stored.to_update(0, 0, "") == (rounded := stored.to_update(0, 0, ""))
        assert [place.id for place in rounded.places] == sorted(graph.places)
        assert stored.objects == graph.objects
        assert stored.neighbours.keys() == graph.neighbours.keys()
        assert stored.parents == graph.parents
        assert rounded.query_place is None
    assert (loaded.frame_id("a"), loaded.frame_id("b")) == ("map", "b_map")
    assert loaded.row("b", str(2**63 + 3)) == 7 + 3


def test_at_rest_it_is_one_file(path: Path) -> None:
    load(path)
    describe(path)
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_search_finds_a_place_by_its_embedding_and_keeps_to_the_buildings_asked_for(path: Path) -> None:
    loaded = load(path)
    rows, similarities = loaded.search(loaded.embeddings[9], 19)
    assert similarities[0] == pytest.approx(1, abs=1e-6)
    assert 9 in rows[similarities == similarities[0]]
    rows, _ = loaded.search(loaded.embeddings[9], 19, buildings=["a"])
    assert sorted(rows.tolist()) == list(range(7))
    with pytest.raises(MapError, match="buildings: a, b \\(got 'c'\\)"):
        loaded.search(loaded.embeddings[9], 3, buildings=["c"])


def test_content_hash_is_of_content_alone(path: Path, tmp_path: Path, model: Model) -> None:
    """Order of adding, detours, notes and file bytes change nothing; a place, a frame or a graph does."""
    other = tmp_path / "other.map"
    with MapDatabase.create(other, model) as database:
        database.add_building("a", *make_building(model, 9, 5))
        database.add_building("b", *make_building(model, 12, 1), frame_id="b_map", source="elsewhere")
        database.add_building("c", *make_building(model, 3, 1))
        database.remove_building("c")
        graph, ids, positions, embeddings = make_building(model, 7, 2)
        backwards = slice(None, None, -1)
        database.replace_building("a", graph, ids[::-1], positions[backwards], embeddings[backwards])
        assert database.meta.content_hash == load(path).hash
        assert load(other).hash == load(path).hash
        hashes = {load(path).hash}
        for change in (
            lambda: database.replace_building("a", graph, ids, positions, embeddings, frame_id="odom"),
            lambda: database.replace_building("a", graph, ids, positions + 1e-9, embeddings),
            lambda: database.replace_building("a", graph, ids, positions, -embeddings),
            lambda: database.replace_building("a", make_building(model, 7, 3)[0], ids, positions, embeddings),
            lambda: database.replace_places("a", ids[:1], positions[:1] + 1, embeddings[:1]),
            lambda: database.remove_places("a", ids[:1]),
        ):
            change()
            hashes.add(load(other).hash)
    assert len(hashes) == 7


def test_places_are_added_removed_and_replaced(path: Path, model: Model) -> None:
    _, ids, positions, embeddings = make_building(model, 7, 2)
    with MapDatabase.open(path) as database:
        before = load(path)
        database.remove_places("a", ids[2:4])
        assert database.place_ids("a") == (*ids[:2], *ids[4:])
        assert load(path).n_places == 17
        database.add_places("a", ids[2:4], positions[2:4], embeddings[2:4])
        assert same(load(path), before)
        database.replace_places("a", ids[:1], positions[:1] + 5, embeddings[1:2])
        database.replace_places("a", ids, positions, embeddings)
        assert same(load(path), before)
        larger = make_building(model, 8, 2)
        database.add_places("a", larger[1][7:], larger[2][7:], larger[3][7:], graph=larger[0])
        assert database.place_ids("a") == tuple(larger[1])
        assert len(database.graph("a").places) == 8


def without(rows: slice) -> Callable[[Building], tuple[object, ...]]:
    return lambda b: (b[0], b[1][rows], b[2], b[3])


REFUSED: dict[str, Callable[[MapDatabase, Building], object]] = {
    "name taken": lambda d, b: d.add_building("a", *b),
    "no name": lambda d, b: d.add_building("", *b),
    "name of two lines": lambda d, b: d.add_building("c\nd", *b),
    "no places": lambda d, b: d.add_building("c", b[0], [], np.zeros((0, 3)), np.zeros((0, 6))),
    "place twice": lambda d, b: d.add_building("c", b[0], [b[1][0]] * 7, b[2], b[3]),
    "place not in the graph": lambda d, b: d.add_building("c", b[0], [*b[1][:6], "x"], b[2], b[3]),
    "fewer ids than rows": lambda d, b: d.add_building("c", b[0], b[1][:6], b[2], b[3]),
    "positions in the plane": lambda d, b: d.add_building("c", b[0], b[1], b[2][:, :2], b[3]),
    "wrong dimension": lambda d, b: d.add_building("c", b[0], b[1], b[2], b[3][:, :5]),
    "NaN embedding": lambda d, b: d.add_building("c", b[0], b[1], b[2], b[3] * np.nan),
    "infinite position": lambda d, b: d.add_building("c", b[0], b[1], b[2] + np.inf, b[3]),
    "words for numbers": lambda d, b: d.add_building("c", b[0], b[1], "north", b[3]),
    "stamp beyond 64 bits": lambda d, b: d.add_building("c", *b, stamp_ns=2**63),
    "surrogate in an id": lambda d, b: d.add_building("c", b[0], [*b[1][:6], "\ud800"], b[2], b[3]),
    "remove unknown building": lambda d, b: d.remove_building("c"),
    "replace unknown building": lambda d, b: d.replace_building("c", *b),
    "replace by a wrong dimension": lambda d, b: d.replace_building("a", b[0], b[1], b[2], b[3][:, :5]),
    "add places that are there": lambda d, b: d.add_places("a", *b[1:]),
    "add places to unknown building": lambda d, b: d.add_places("c", *b[1:]),
    "add a place that no graph has": lambda d, b: d.add_places("a", ["x"], b[2][:1], b[3][:1]),
    "add NaN": lambda d, b: d.replace_places("a", b[1], b[2], b[3] * np.nan),
    "remove unknown place": lambda d, b: d.remove_places("a", [b[1][0], "x"]),
    "remove a place twice": lambda d, b: d.remove_places("a", [b[1][0]] * 2),
    "remove all places": lambda d, b: d.remove_places("a", b[1]),
    "graph without the places": lambda d, b: d.remove_places("a", b[1][:1], graph=SceneGraph()),
    "rebuild with a building missing": lambda d, b: d.rebuild(make_model(1), {"a": b[3]}),
    "rebuild with a wrong shape": lambda d, b: d.rebuild(make_model(1), {"a": b[3], "b": b[3]}),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refused_change_changes_nothing(name: str, path: Path, model: Model) -> None:
    before = load(path)
    with MapDatabase.open(path) as database:
        generation = database.meta.generation
        with pytest.raises(MapError, match=ONE_LINE):
            REFUSED[name](database, make_building(model, 7, 2))
        assert database.meta.generation == generation
        assert same(load(path), before)
        database.remove_building("a")  # and it goes on working
    assert load(path).buildings == ("b",)


def test_a_transaction_is_all_or_nothing(path: Path, model: Model) -> None:
    before = load(path)
    with MapDatabase.open(path) as database:

        def swap_and_fail() -> None:
            with database.transaction():
                database.remove_building("a")
                database.add_building("c", *make_building(model, 3))
                raise RuntimeError("stop")

        with pytest.raises(RuntimeError, match="stop"):
            swap_and_fail()
        assert same(load(path), before)
        with database.transaction():
            database.remove_building("a")
            with pytest.raises(MapError, match=ONE_LINE):
                database.replace_building("b", *make_building(model, 3)[:3], np.zeros((3, 5)))
            assert same(load(path), before)  # a reader sees nothing of it yet
    assert load(path).buildings == ("b",)
    assert load(path).n_places == 12


def test_rebuild_replaces_model_and_all_embeddings(path: Path, model: Model) -> None:
    other = make_model(7)
    with MapDatabase.open(path) as database:
        embeddings = {name: make_building(other, len(database.place_ids(name)), 5)[3] for name in database.buildings}
        generation = database.meta.generation
        database.rebuild(other, embeddings)
        assert database.meta.generation == generation + 1
    loaded = load(path)
    loaded.require(model_hash=other.hash, labelspace_hash=LABELS.hash)
    np.testing.assert_array_equal(loaded.embeddings, np.concatenate([embeddings["a"], embeddings["b"]]))


def test_reset_builds_a_map_anew_in_one_step(path: Path) -> None:
    other = make_model(7)
    with MapDatabase.open(path) as database, database.transaction():
        database.reset(other)
        database.add_building("z", *make_building(other, 4))
        assert load(path).buildings == ("a", "b")
    assert load(path).buildings == ("z",)
    assert load(path).model.hash == other.hash


def test_another_model_or_labelspace_is_refused_by_name(path: Path, model: Model, tmp_path: Path) -> None:
    stranger = make_model(3)
    labels = Labelspace("other", ("chair", "table", "lamp"))
    for refuse in (load(path).require, MapDatabase.open(path).require):
        refuse(model.hash, LABELS.hash)
        with pytest.raises(MapError, match=f"model {stranger.hash[:12]} \\(got paper {model.hash[:12]}\\)"):
            refuse(model_hash=stranger.hash)
        with pytest.raises(MapError, match=f"labelspace {labels.hash[:12]} \\(got test {LABELS.hash[:12]}\\)"):
            refuse(labelspace_hash=labels.hash)
    with pytest.raises(MapError, match=f"{stranger.hash[:12]}"):
        MapDatabase.create(path, stranger, exist_ok=True)
    with MapDatabase.create(path, model, exist_ok=True) as database:
        assert database.buildings == ("a", "b")


def test_create_refuses_a_name_that_is_taken(path: Path, model: Model) -> None:
    before = path.read_bytes()
    with pytest.raises(MapError, match=ONE_LINE):
        MapDatabase.create(path, model)
    assert path.read_bytes() == before
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_create_is_not_fooled_by_the_log_of_a_map_that_is_gone(tmp_path: Path, model: Model) -> None:
    path = tmp_path / "site.map"
    database = MapDatabase.create(path, model)
    database.add_building("old", *make_building(model, 3))
    log = Path(f"{path}-wal").read_bytes()
    database.close()
    path.unlink()
    Path(f"{path}-wal").write_bytes(log)
    MapDatabase.create(path, model).close()
    assert load(path).buildings == ()


def test_a_map_without_buildings_loads(tmp_path: Path, model: Model) -> None:
    MapDatabase.create(tmp_path / "empty.map", model).close()
    loaded = load(tmp_path / "empty.map")
    assert loaded.embeddings.shape == (0, 6)
    assert loaded.search(np.zeros(6), 3)[0].shape == (0,)


def test_describe_counts_what_is_there(path: Path, model: Model) -> None:
    told = describe(path)
    assert (told["hash"], told["places"], told["dimension"]) == (load(path).hash, 19, 6)
    assert told["model"] == {"name": "paper", "hash": model.hash, "config": told["model"]["config"]}
    assert told["model"]["config"]["hidden"] == 8
    assert told["labelspace"] == {"name": "test", "hash": LABELS.hash, "classes": 3}
    assert told["bytes"] == path.stat().st_size
    a, b = told["buildings"]
    assert (b["name"], b["source"], b["frame_id"], b["stamp_ns"], b["places"]) == ("b", "b.json", "b_map", -5, 12)
    assert a["objects"] == 4 == sum(a["classes"].values())
    assert set(b["classes"]) <= {"chair", "table"}


@pytest.mark.data
def test_a_real_building_comes_back(data_root: Path, tmp_path: Path) -> None:
    file = read_hydra(data_root / "hydra" / "apartment_long.json")
    labels = Labelspace("file", tuple(sorted({item.class_ for item in file.graph.objects.values()})))
    model = Model(build_encoder("rings", None, len(labels)), labels)
    arrays = GraphArrays.from_scene_graph(file.graph, labels)
    with MapDatabase.create(tmp_path / "real.map", model) as database:
        database.add_building(
            "apartment", file.graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays)
        )
    loaded = load(tmp_path / "real.map")
    assert loaded.n_places == 437
    assert len(loaded.graph("apartment").objects) == 27
    again = GraphArrays.from_scene_graph(loaded.graph("apartment"), labels)
    np.testing.assert_allclose(embed_graph(model, again), loaded.embeddings, atol=1e-5)
