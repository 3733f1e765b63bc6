"""The embedded file behind the interface of a fleet's map: nothing may differ from the map loaded whole."""

from pathlib import Path

import numpy as np
import pytest
from map_cases import make_building, make_map, make_model

from semloc_core.errors import MapError
from semloc_core.fleet.file_source import FileSource
from semloc_core.map_database import MapDatabase, load
from semloc_core.map_database.building_patterns import matching_buildings
from semloc_core.map_database.stored.records import building_digest


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    return make_map(tmp_path / "office.map", make_model())


def test_catalogue_and_buildings_are_the_files(map_file: Path) -> None:
    source, loaded = FileSource(map_file), load(map_file)
    catalogue = source.catalogue()
    assert source.name == "office"
    assert catalogue.content_hash == loaded.hash
    assert (catalogue.model_hash, catalogue.dimension) == (loaded.model.hash, 6)
    assert list(catalogue.buildings) == ["a", "b"]
    assert catalogue.n_places == 19
    for name in catalogue.buildings:
        fetched = source.fetch(name)
        stored = fetched.stored
        digest = building_digest(fetched.places, stored.frame_id, stored.graph.digest, stored.history)
        assert digest == fetched.entry.digest == catalogue.buildings[name].digest
        assert fetched.entry.n_places == len(fetched.places.ids)


def test_nearest_are_those_of_the_loaded_map(map_file: Path) -> None:
    source, loaded = FileSource(map_file), load(map_file)
    z = loaded.embeddings[3]
    rows, similarities = loaded.search(z, 5)
    nearest = source.nearest(z, 5)
    assert nearest.place_ids == tuple(loaded.place_ids[row] for row in rows)
    assert nearest.buildings == tuple(loaded.buildings[loaded.building_index[row]] for row in rows)
    assert np.array_equal(nearest.similarities, similarities)
    assert set(source.nearest(z, 50, ["b"]).buildings) == {"b"}
    with pytest.raises(MapError, match="one of the map's buildings"):
        source.nearest(z, 5, ["nowhere"])
    with pytest.raises(MapError, match="one query"):
        source.nearest(loaded.embeddings[:2], 5)


def test_a_changed_file_is_read_again(map_file: Path) -> None:
    source = FileSource(map_file)
    before = source.catalogue()
    assert source.catalogue() is before
    with MapDatabase.open(map_file) as database:
        database.replace_building("a", *make_building(source.model(), 9, 5))
    after = source.catalogue()
    assert after.buildings["b"] == before.buildings["b"]
    assert after.buildings["a"].generation != before.buildings["a"].generation
    assert len(source.fetch("a").places.ids) == 9


def test_patterns_pick_the_buildings_of_a_site() -> None:
    names = ["hq/1", "hq/2", "lab", "Lab"]
    assert matching_buildings(names, ()) == ("Lab", "hq/1", "hq/2", "lab")
    assert matching_buildings(names, ("hq/*", "hq/1")) == ("hq/1", "hq/2")
    assert matching_buildings(names, ("lab",)) == ("lab",)
    with pytest.raises(MapError, match="a pattern that fits a building of the map: Lab, hq/1, hq/2, lab"):
        matching_buildings(names, ("hq/*", "plant*"))
