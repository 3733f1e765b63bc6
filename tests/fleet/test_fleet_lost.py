"""A server that is killed and comes back: one line meanwhile, afterwards the map as it was."""

from pathlib import Path

import pytest
from fleet_maps import fill
from lite_server import LiteServer
from map_cases import make_building, make_model

from semloc_core.errors import MapUnavailableError
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.milvus.source import MilvusSource
from semloc_core.fleet.writing.database import FleetDatabase


def test_server_killed_and_started_again(tmp_path: Path) -> None:
    pytest.importorskip("milvus_lite")
    server = LiteServer(tmp_path / "data")
    server.start()
    address = MilvusAddress("127.0.0.1", server.port, "x")
    try:
        fill(address)
        source, database = MilvusSource(address, timeout_s=5, poll_s=0.0), FleetDatabase.open(address, timeout_s=5)
        before = source.catalogue()
        z = make_building(make_model(), 7, 2)[3][0]
        near = source.nearest(z, 5)
        server.stop(kill=True)
        for ask in (source.catalogue, lambda: source.nearest(z, 5), lambda: source.fetch("a")):
            with pytest.raises(MapUnavailableError):
                ask()
        with pytest.raises(MapUnavailableError):
            database.remove_building("a")
        server.start()
        assert source.catalogue().content_hash == before.content_hash
        assert source.nearest(z, 5).place_ids == near.place_ids
        assert len(source.fetch("a").places.ids) == 7
        database.remove_building("a")
        assert list(source.catalogue().buildings) == ["b"]
        source.close()
        database.close()
    finally:
        server.stop(kill=True)
