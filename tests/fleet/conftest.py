"""A real server for the tests of fleet maps: Milvus Lite, in a process of its own, on loopback."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from lite_server import LiteServer

from semloc_core.fleet.milvus.address import MilvusAddress


@pytest.fixture(scope="session")
def lite(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiteServer]:
    """A running server that all tests share; each takes a map name of its own."""
    pytest.importorskip("milvus_lite")
    server = LiteServer(tmp_path_factory.mktemp("milvus"))
    server.start()
    yield server
    server.stop(kill=True)


@pytest.fixture
def address(lite: LiteServer, request: pytest.FixtureRequest) -> MilvusAddress:
    """Where a test may make a map of its own."""
    name = "".join(c if c.isascii() and c.isalnum() else "_" for c in request.node.name)[:48]
    return MilvusAddress("127.0.0.1", lite.port, f"{name}_{os.getpid()}")
