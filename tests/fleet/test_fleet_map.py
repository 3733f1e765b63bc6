"""A map on a server against the same map in a file: content hashes, places, buildings, search."""

from pathlib import Path

import numpy as np
import pytest
from fleet_maps import fill
from map_cases import make_map, make_model

from semloc_core.fleet import reading, server
from semloc_core.fleet.address import MilvusAddress
from semloc_core.fleet.file_source import FileSource
from semloc_core.fleet.milvus_source import MilvusSource
from semloc_core.map_database import load


def test_a_catalogue_of_more_rows_than_one_message_holds(
    address: MilvusAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(address)
    whole = MilvusSource(address).catalogue()
    monkeypatch.setattr(server, "MAX_ROWS", 4)  # four rows there are
    monkeypatch.setattr(reading, "_POINTERS_AT_ONCE", 1)
    assert MilvusSource(address).catalogue() == whole


@pytest.mark.parametrize("order", [("a", "b"), ("b", "a")])
def test_content_is_that_of_the_file(address: MilvusAddress, tmp_path: Path, order: tuple[str, ...]) -> None:
    fill(address, order)
    file = FileSource(make_map(tmp_path / "x.map", make_model()))
    source = MilvusSource(address)
    here, there = file.catalogue(), source.catalogue()
    assert there.content_hash == here.content_hash == load(tmp_path / "x.map").hash
    assert (there.model_hash, there.labelspace_hash, there.dimension) == (
        here.model_hash,
        here.labelspace_hash,
        here.dimension,
    )
    assert list(there.buildings) == ["a", "b"]
    for name in ("a", "b"):
        ours, theirs = file.fetch(name), source.fetch(name)
        assert theirs.stored == ours.stored
        assert theirs.places.ids == ours.places.ids
        assert theirs.places.positions.tobytes() == ours.places.positions.tobytes()
        assert theirs.places.embeddings.tobytes() == ours.places.embeddings.tobytes()
    assert source.model().to_bytes() == file.model().to_bytes()
    z = file.fetch("a").places.embeddings[3]
    for buildings in (None, ["b"], ["a", "b"]):
        ours_near, theirs_near = file.nearest(z, 10, buildings), source.nearest(z, 10, buildings)
        assert theirs_near.place_ids == ours_near.place_ids
        assert theirs_near.buildings == ours_near.buildings
        np.testing.assert_allclose(theirs_near.similarities, ours_near.similarities, atol=1e-5)
    source.close()
