"""A large file is answered from a few buildings at a time, and nobody who opens it need know."""

import numpy as np
import pytest
from small_building import building_update, make_map, make_model

import semloc_core.fleet.open_map
from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import MapError
from semloc_core.fleet.file_source import LoadedSource
from semloc_core.fleet.link import Link
from semloc_core.fleet.localiser import LargeMapLocaliser
from semloc_core.fleet.narrowing import ShortlistConfig
from semloc_core.fleet.open_map import open_localiser
from semloc_core.localiser import Localiser
from semloc_core.map_database import load

NAMES = [f"{site}/{i}" for site in ("hq", "lab") for i in range(4)]


@pytest.fixture
def path(tmp_path):
    make_map(tmp_path / "site.map", make_model("rings"), **{n: building_update(seed=i) for i, n in enumerate(NAMES)})
    return tmp_path / "site.map"


@pytest.fixture
def small_limit(monkeypatch):
    monkeypatch.setattr(semloc_core.fleet.open_map, "WHOLE_PLACES", 100)


def test_only_a_large_file_is_narrowed(path, monkeypatch):
    assert type(open_localiser(str(path))) is Localiser
    monkeypatch.setattr(semloc_core.fleet.open_map, "WHOLE_PLACES", 100)
    large = open_localiser(str(path))
    assert type(large) is LargeMapLocaliser
    assert large.server() is None  # nothing for diagnostics to report of a server
    assert type(open_localiser(str(path), LocaliserConfig(buildings=("hq/1", "lab/2")))) is Localiser


@pytest.mark.parametrize("filter_", ["none", "bayes"])
def test_it_answers_as_the_whole_file_does_where_the_list_holds_the_building(path, filter_):
    config, loaded = LocaliserConfig(filter=filter_), load(path)
    link = Link(LoadedSource(loaded), np.random.default_rng(0))
    large = LargeMapLocaliser(link, config, ShortlistConfig(nearest=60, buildings=3))
    large.refresh()
    exact = Localiser(loaded, config)
    for i, name in enumerate(NAMES):
        update = building_update(seed=i, query="p7", seq=i)
        mine, theirs = large.update(update).matches, exact.update(update).matches
        assert len(large.map.buildings) == 3
        assert name in large.map.buildings
        assert (mine.matches[0].map, mine.matches[0].place) == (theirs.matches[0].map, theirs.matches[0].place)
        assert mine.map == theirs.map == wire.MapInfo("site", loaded.hash, loaded.n_places)
        assert mine.model == theirs.model


def test_buildings_that_are_not_asked_for_are_never_answered(path, small_limit):
    large = open_localiser(str(path), LocaliserConfig(buildings=("hq/*",)))
    assert type(large) is LargeMapLocaliser
    found = large.update(building_update(seed=6)).matches
    assert {match.map for match in found.matches} <= set(NAMES[:4])
    assert large.buildings == tuple(NAMES[:4])
    with pytest.raises(MapError, match="a pattern that fits a building of the map"):
        open_localiser(str(path), LocaliserConfig(buildings=("attic/*",)))


def test_another_file_takes_the_stream_over(path, small_limit):
    first, second = open_localiser(str(path)), open_localiser(str(path))
    first.update(building_update(seed=2))
    second.take_over(first)
    first.close()
    located = second.locate()
    assert located.matches.status in ("match", "ambiguous")
    assert located.matches.seq == 0
    assert second.renewed(LocaliserConfig(top_n=2)).config.top_n == 2
