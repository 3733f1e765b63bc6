"""Relocalisation: the right building, within 4 m, from a database of all buildings."""

from pathlib import Path

import numpy as np
import pytest

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.errors import FileFormatError
from semloc_core.evaluate.relocalise import (
    evaluate_relocalise,
    fitted,
    judge_layout,
    make_arena,
    read_buildings,
    relabelled,
)
from semloc_core.graph.labels.files import load_synonyms
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.metrics.rows import Row
from semloc_core.sources.world import KINDS, World, draw_pair, write_world
from semloc_core.training.config import TrainConfig


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, small_worlds: list[World]) -> Path:
    """Three buildings, each queried with its own map."""
    folder = tmp_path_factory.mktemp("buildings")
    for name, world in zip("abc", small_worlds, strict=True):
        (folder / name).mkdir()
        for part in ("map", "query"):
            write_world(folder / name / f"{part}.json", world)
    return folder


def by_scope(rows: list[Row], method: str) -> dict[str, Row]:
    return {str(row["scope"]): row for row in rows if row["method"] == method}


def test_a_building_is_found_from_its_own_map(root: Path, small_worlds: list[World]) -> None:
    rows = evaluate_relocalise(root, train_paper=False)
    assert list(dict.fromkeys(row["method"] for row in rows)) == [
        "bag_of_words",
        "tfidf",
        "histogram",
        "rings",
        "rings + layout",
        "general",
    ]
    tested = by_scope(rows, "rings + layout")
    assert list(tested) == ["all", "a", "b", "c", "foreign"]
    assert float(tested["all"]["success@1"] or 0) > 0.95
    assert 0 <= float(tested["all"]["ece"] or 0) < 0.2
    assert float(tested["foreign"]["foreign_accepted"] or 0) < 0.5
    rings = by_scope(rows, "rings")
    assert list(rings) == ["all", "a", "b", "c"]
    assert rings["all"]["success@1"] == 1.0
    assert rings["all"]["queries"] == sum(len(world.graph.places) for world in small_worlds)
    assert rings["b"]["queries"] == len(small_worlds[1].graph.places)
    sizes = [len(world.graph.places) for world in small_worlds]
    for name, world in zip("abc", small_worlds, strict=True):
        at = np.array(list(world.graph.places.values()))
        near = (np.linalg.norm(at[:, None] - at[None], axis=2) <= 4.0).sum() / len(at)
        assert rings[name]["chance"] == tested[name]["chance"] == pytest.approx(near / sum(sizes))
    mean = sum(float(rings[name]["chance"] or 0) * size for name, size in zip("abc", sizes, strict=True)) / sum(sizes)
    assert rings["all"]["chance"] == pytest.approx(mean)
    for row in rows:
        for n in (1, 5, 10) if row["scope"] != "foreign" else ():
            low, value, high = (float(row[f"success@{n}{end}"] or 0.0) for end in ("_low", "", "_high"))
            assert low <= value <= high
        if row["scope"] != "foreign":
            assert float(row["success@1"] or 0) <= float(row["success@5"] or 0) <= float(row["success@10"] or 0)


def test_the_right_spot_in_the_wrong_building_is_wrong(tmp_path: Path, small_worlds: list[World]) -> None:
    """The queries are swapped: each finds its twin, at the very same coordinates, in the other building."""
    for name, first, second in (("a", 0, 1), ("b", 1, 0)):
        (tmp_path / name).mkdir()
        write_world(tmp_path / name / "map.json", small_worlds[first])
        write_world(tmp_path / name / "query.json", small_worlds[second])
    rings = by_scope(evaluate_relocalise(tmp_path, baselines=("rings",), train_paper=False, verified=False), "rings")
    assert rings["all"]["success@1"] == 0.0


def test_a_trained_encoder_and_a_given_model_are_judged_beside(root: Path) -> None:
    """The given model has a labelspace of its own, with fewer classes in another order."""
    space = Labelspace("mine", ("plant", "couch", "computer"))
    given = Model(build_encoder("rings", None, 3), space)
    calls: list[tuple[int, int]] = []
    rows = evaluate_relocalise(
        root,
        verified=False,
        baselines=(),
        models=[given],
        config=TrainConfig(steps=3, pool=2),
        progress=lambda done, total, words: calls.append((done, total)),
    )
    assert set(by_scope(rows, "paper")) == {"all", "a", "b", "c"}
    assert float(by_scope(rows, f"rings {given.hash[:8]}")["all"]["success@1"] or 0) > 0.95
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)
    assert calls[-1] == (4, 4)


def test_idf_is_counted_on_maps(root: Path) -> None:
    buildings = read_buildings(root)
    arena = make_arena(buildings, buildings[0].map.labelspace)
    idf = fitted("tfidf", arena).encoder.state_dict()["idf"].tolist()
    seen = {arena.labelspace.classes[c] for graph in arena.maps for c in graph.object_classes}
    for name, weight in zip(arena.labelspace.classes, idf, strict=True):
        assert (weight < max(idf)) == (name in seen), name


def test_a_folder_without_buildings_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "map.json").write_text("{}")
    with pytest.raises(FileFormatError, match=r"expected folders with map.json and query.json in .*\(got none\)"):
        evaluate_relocalise(tmp_path)


@pytest.mark.data
def test_rings_find_real_homes_where_bag_of_words_does_not(data_root: Path, tmp_path: Path) -> None:
    for home in ("Onaga", "Pomaria"):
        (tmp_path / home).symlink_to(data_root / "gibson" / home)
    rows = evaluate_relocalise(tmp_path, baselines=("rings", "bag_of_words"), train_paper=False, verified=False)
    assert float(by_scope(rows, "rings")["all"]["success@1"] or 0) > 0.9
    assert float(by_scope(rows, "bag_of_words")["all"]["success@1"] or 0) < 0.7


def test_a_detector_of_other_names_is_led_back_by_the_cross_walk(tmp_path) -> None:
    """By a table that was written apart from the walk: what has a name of its own there comes back, gaps may be it."""
    world, second = draw_pair(KINDS["home"], np.random.default_rng(7))
    (tmp_path / "home").mkdir()
    for one, name in ((world, "map"), (second, "query")):
        write_world(tmp_path / "home" / f"{name}.json", one)
    names = load_synonyms(Path(__file__).parent / "coco_by_ade20k.yaml")
    (before,) = read_buildings(tmp_path)
    (after,) = relabelled([before], names)
    assert after.map is before.map
    lost = {name for name, said in names.items() if said == "unknown"}
    mapped = {thing.class_ for thing in before.map.graph.objects.values()}
    same = total = 0
    for i, thing in before.query.graph.objects.items():
        read = after.query.graph.objects[i]
        found = read.class_
        if thing.class_ in lost:
            assert read.labels is None or thing.class_ in read.labels or thing.class_ not in mapped
        elif thing.class_ in names:
            total, same = total + 1, same + (found == thing.class_)
    assert total > 10
    assert same >= 0.9 * total


@pytest.mark.parametrize("table", ["coco_by_nyu40", "coco_by_mpcat40", "coco_by_scannet20"])
def test_names_for_the_rest_and_no_names_place_a_robot_as_its_own_names_do(tmp_path, table) -> None:
    """Most of what tells this home apart is `otherprop`, `objects` or without a name to that detector."""
    world, second = draw_pair(KINDS["home"], np.random.default_rng(7))
    (tmp_path / "home").mkdir()
    for one, name in ((world, "map"), (second, "query")):
        write_world(tmp_path / "home" / f"{name}.json", one)
    (before,) = read_buildings(tmp_path)
    (after,) = relabelled([before], load_synonyms(Path(__file__).parent / f"{table}.yaml"))
    space = before.map.labelspace
    shares = []
    for building in (before, after):
        arena = make_arena([building], space)
        rows = judge_layout("rings", fitted("rings", arena), arena, 4.0, 0)
        shares.append(float(rows[0]["success@1"] or 0))
    assert shares[1] >= shares[0] - 0.03
    seen = [thing for thing in after.query.graph.objects.values() if thing.labels or thing.class_ == "unknown"]
    assert len(seen) > 0.3 * len(after.query.graph.objects)
