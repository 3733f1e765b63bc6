"""A map on a server against the same map in a file: content hashes, places, buildings, search."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from fleet_maps import fill
from map_cases import make_building, make_map, make_model

from semloc_core.errors import MapError
from semloc_core.fleet.file_source import FileSource
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus import reading, server
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.milvus.creating import make_collections
from semloc_core.fleet.milvus.rows import OBJECTS
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.milvus.source import MilvusSource
from semloc_core.fleet.writing.database import FleetDatabase
from semloc_core.map_database import MapDatabase, load


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
        # A server's storeys follow from its graph, where the file has them beside it.
        assert theirs.stored == dataclasses.replace(ours.stored, storeys=None)
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
    ours_objects, theirs_objects = file.objects(["a", "b"]), source.objects(["a", "b"])
    for name in ("a", "b"):
        assert theirs_objects[name].pack() == ours_objects[name].pack() != b""
    best = {name: z @ file.fetch(name).places.embeddings.T for name in ("a", "b")}
    for asked in (file, source):
        assert asked.similar(z, 19) == pytest.approx({name: each.max() for name, each in best.items()}, abs=1e-5)
        assert list(asked.similar(z, 19, ["b"])) == ["b"]
    source.close()


def test_a_map_written_before_it_said_its_objects(address: MilvusAddress) -> None:
    """It is read as ever; what is written anew says them."""
    fill(address)
    server_ = Server(address)
    server_.delete(layout.blobs(address.name), f'kind == "{OBJECTS}"')
    server_.close()
    source = MilvusSource(address, poll_s=0.0)
    assert source.objects(["a", "b"]) == {}
    assert set(source.similar(source.fetch("a").places.embeddings[0], 19)) == {"a", "b"}
    with FleetDatabase.open(address) as database:
        database.replace_building("b", *make_building(database.model, 8, 4))
    assert list(source.objects(["a", "b"])) == ["b"]
    source.close()


@pytest.mark.parametrize("index", ["HNSW", "FLAT", "IVF_FLAT"])
def test_indexed_rows_are_found_as_the_newest_are(address: MilvusAddress, tmp_path: Path, index: str) -> None:
    """What the server has written to its disk and indexed; a part of it replaced since, and left over."""
    model = make_model()
    with (
        FleetDatabase.create(address, model, index=index) as there,
        MapDatabase.create(tmp_path / "x.map", model) as here,
    ):
        for database in (there, here):
            for i in range(3):
                database.add_building(str(i), *make_building(model, 300, i))
        connection = Server(address, 30)
        connection.flush(layout.places(address.name, 6))
        for database in (there, here):
            database.replace_building("1", *make_building(model, 250, 7))
        connection.flush(layout.places(address.name, 6))
        connection.close()
    file, source = FileSource(tmp_path / "x.map"), MilvusSource(address, timeout_s=30)
    for seed in range(5):
        z = make_building(model, 5, 50 + seed)[3][0]
        for buildings in (None, ["1"], ["0", "2"]):
            ours, theirs = file.nearest(z, 40, buildings), source.nearest(z, 40, buildings)
            both = set(zip(ours.buildings, ours.place_ids, strict=True)) & set(
                zip(theirs.buildings, theirs.place_ids, strict=True)
            )
            assert len(theirs.place_ids) == 40
            assert len(both) >= (40 if index == "FLAT" else 36), (seed, buildings)
    assert len(source.fetch("1").places.ids) == 250
    source.close()


def test_a_map_half_made_is_none_and_can_be_made(address: MilvusAddress) -> None:
    """Killed while it made collections; and two who make the same one at once."""
    model = make_model()
    connection = Server(address, 30)
    make_collections(connection, model, "HNSW")
    connection.close()
    with pytest.raises(MapError, match=f"expected map '{address.name}'.*begun and never finished"):
        FleetDatabase.open(address)
    with ThreadPoolExecutor() as pool:
        made = list(pool.map(lambda _: FleetDatabase.create(address, model, exist_ok=True), range(2)))
    for i, database in enumerate(made):
        database.add_building(str(i), *make_building(model, 5))
        database.close()
    assert list(MilvusSource(address).catalogue().buildings) == ["0", "1"]
    with pytest.raises(MapError, match=r"expected no map at .* already"):
        FleetDatabase.create(address, model)
    with pytest.raises(MapError, match=r"made with model .* \(got paper"):
        FleetDatabase.create(address, make_model(1), exist_ok=True)
    with pytest.raises(MapError, match="Milvus Lite"):
        FleetDatabase.create(MilvusAddress(address.host, address.port, "disk"), model, index="DISKANN")
