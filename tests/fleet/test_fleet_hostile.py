"""Whatever a server sends, a reader gives the map as it was committed or one line of refusal; nothing grows."""

from __future__ import annotations

import base64
import copy
import http.server
import math
import re
import resource
import secrets
import socket
import threading
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from fleet_maps import fill
from map_cases import ONE_LINE, make_building, make_model

from semloc_core.errors import MapError, MapUnavailableError
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus.address import CERTIFICATE_VARIABLE, TOKEN_VARIABLE, MilvusAddress
from semloc_core.fleet.milvus.rows import OBJECTS, Pointer, pack, unpack
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.milvus.source import MilvusSource
from semloc_core.fleet.writing.database import FleetDatabase

Rows = list[dict[str, Any]]
Tamper = Callable[[Rows], object]


@pytest.fixture(scope="module")
def site(lite: Any) -> MilvusAddress:
    # Tests of a file may be dealt out in parts: the fixture is made again on the same server.
    address = MilvusAddress("127.0.0.1", lite.port, f"hostile_{secrets.token_hex(4)}")
    fill(address)
    return address


def read_all(source: MilvusSource) -> None:
    source.model()
    for name in source.catalogue().buildings:
        source.fetch(name)
    z = make_building(make_model(), 7, 2)[3][0]
    source.nearest(z, 12)
    source.nearest(z, 12, ["a"])
    assert set(source.objects(["a", "b"])) == {"a", "b"}


def each(field: str, value: object) -> Tamper:
    """Every row gets this value."""

    def tamper(rows: Rows) -> None:
        for row in rows:
            if field in row:
                row[field] = copy.copy(value)

    return tamper


def change(field: str, make: Callable[[Any], object]) -> Tamper:
    """The first row that has the field gets another value."""

    def tamper(rows: Rows) -> None:
        for row in rows[:1]:
            if field in row:
                row[field] = make(row[field])

    return tamper


def pointer(**values: object) -> Tamper:
    """Rows of buildings in the catalogue say something else."""

    def tamper(rows: Rows) -> None:
        for row in rows:
            if row.get("data") and row["key"].startswith("b"):
                record = unpack(row["data"], Pointer)
                row["data"] = pack(msgspec.structs.replace(record, **values))

    return tamper


def recoded(data: str, make: Callable[[bytes], bytes]) -> str:
    return base64.b64encode(make(base64.b64decode(data))).decode()


def packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data)).decode()


def objects(make: Callable[[bytes], bytes], **values: object) -> Tamper:
    """The objects by which buildings are proposed are others."""

    def tamper(rows: Rows) -> None:
        for row in rows:
            if row.get("kind") == OBJECTS:
                row["data"] = recoded(row["data"], make)
                row.update(values)

    return tamper


CASES: dict[str, tuple[str, Tamper]] = {
    "no rows": ("catalogue", lambda rows: rows.clear()),
    "no row of the map": ("catalogue", lambda rows: rows.__delitem__(slice(0, 1))),
    "far more rows than asked for": ("catalogue", lambda rows: rows.extend(rows * 20_000)),
    "data that is no text": ("catalogue", each("data", 5)),
    "data in no alphabet": ("catalogue", each("data", "§" * 100)),
    "data longer than a field": ("catalogue", each("data", "A" * 70_000)),
    "data that unpacks to a gigabyte": ("catalogue", each("data", packed(bytes(2**30)))),
    "data of another kind": ("catalogue", each("data", packed(b"[]"))),
    "data of too much": ("catalogue", each("data", packed(b'{"format": 1, "surprise": true}'))),
    "generation as text": ("catalogue", each("generation", "7")),
    "generation as truth": ("catalogue", each("generation", True)),
    "key as number": ("catalogue", each("key", 1)),
    "a key that ends the condition": ("catalogue", change("key", lambda _: 'b"] or key != "')),
    "ten million places": ("catalogue", pointer(n_places=10_000_000)),
    "one place less": ("catalogue", pointer(n_places=6)),
    "a graph of half a gigabyte": ("catalogue", pointer(graph_packed=2**29)),
    "a history that is not there": ("catalogue", pointer(history_bytes=2**27)),
    "another digest": ("catalogue", pointer(digest="0" * 64)),
    "another graph": ("catalogue", pointer(graph_digest="0" * 64)),
    "another frame": ("catalogue", pointer(frame_id="elsewhere")),
    "a frame of two lines": ("catalogue", pointer(frame_id="a\nb")),
    "a name of two lines": ("catalogue", pointer(name="a\nb")),
    "another name": ("catalogue", pointer(name="c")),
    "changes that the history lacks": ("catalogue", pointer(changes={"chair": {"stayed": 1.0, "moved": 2.0}})),
    "NaN for a coordinate": ("places", change("x", lambda _: math.nan)),
    "infinity for a coordinate": ("places", change("y", lambda _: math.inf)),
    "a number that no float holds": ("places", change("z", lambda _: 10**400)),
    "text for a coordinate": ("places", change("z", lambda _: "high")),
    "nothing for a coordinate": ("places", change("z", lambda _: None)),
    "a row without a coordinate": ("places", lambda rows: [row.pop("x", None) for row in rows]),
    "a coordinate a little off": ("places", change("x", lambda x: np.nextafter(x, 9.0))),
    "NaN in an embedding": ("places", change("embedding", lambda z: [math.nan, *z[1:]])),
    "a short embedding": ("places", change("embedding", lambda z: z[1:])),
    "short embeddings": ("places", each("embedding", [0.0])),
    "no embedding": ("places", change("embedding", lambda _: None)),
    "text for an embedding": ("places", change("embedding", lambda _: "zero")),
    "another embedding": ("places", change("embedding", lambda z: [-z[0], *z[1:]])),
    "another id": ("places", change("id", lambda _: "nowhere")),
    "no id": ("places", change("id", lambda _: None)),
    "an id of two lines": ("places", change("id", lambda id_: f"{id_}\n")),
    "one id for all": ("places", each("id", "here")),
    "a row too few": ("places", lambda rows: rows.pop() if rows else None),
    "rows that are elsewhere": ("places", change("row", lambda row: row + 1000)),
    "a row number as fraction": ("places", change("row", lambda row: row + 0.5)),
    "a blob of no alphabet": ("blobs", each("data", "§")),
    "another blob": ("blobs", change("data", lambda data: recoded(data, lambda blob: blob[::-1]))),
    "a blob a byte longer": ("blobs", change("data", lambda data: recoded(data, lambda blob: blob + b"x"))),
    "a blob of nothing": ("blobs", each("data", "")),
    "no blob": ("blobs", lambda rows: rows.clear()),
    "a piece out of order": ("blobs", each("piece", -1)),
    "objects of no alphabet": ("blobs", objects(lambda blob: blob, data="§")),
    "objects a byte short": ("blobs", objects(lambda blob: blob[1:])),
    "objects of classes that are none": ("blobs", objects(lambda blob: b"\xff" * len(blob))),
    "objects at no finite position": ("blobs", objects(lambda blob: blob[:2] + b"\xff" * 12 + blob[14:])),
    "more objects than count": ("blobs", objects(lambda blob: blob * 1000)),
    "objects of another building": ("blobs", objects(lambda blob: blob, generation=7)),
    "NaN for a similarity": ("search", each("distance", math.nan)),
    "text for a similarity": ("search", each("distance", "near")),
    "no generation": ("search", each("entity", {"id": "x"})),
    "a generation as text": ("search", each("entity", {"generation": "7", "id": "x"})),
    "no place": ("search", each("entity", {"generation": 7})),
    "no entity": ("search", lambda rows: [row.pop("entity") for row in rows]),
    "more places than asked for": ("search", lambda rows: rows.extend(rows * 9)),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_refused_in_one_line(site: MilvusAddress, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    where, tamper = CASES[case]
    original = Server._call

    def call(self: Server, method: str, *args: Any, **kwargs: Any) -> Any:
        answer = original(self, method, *args, **kwargs)
        if method == "query" and f"_{where}" in args[0]:
            answer = [dict(row) for row in answer]
            tamper(answer)
        elif method == "search" and where == "search":
            answer = [{"distance": hit["distance"], "entity": dict(hit["entity"])} for hit in answer[0]]
            tamper(answer)
            answer = [answer]
        return answer

    source = MilvusSource(site)
    monkeypatch.setattr(Server, "_call", call)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(MapError) as caught:
        read_all(source)
    assert re.fullmatch(ONE_LINE, str(caught.value)), caught.value
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert grown < 200, f"{grown:.0f} MiB for an answer of kilobytes"
    # What was refused leaves nothing behind: from an honest server the same reader reads on.
    monkeypatch.setattr(Server, "_call", original)
    read_all(source)
    source.close()


def test_rows_of_no_building_are_never_found(site: MilvusAddress) -> None:
    """Places under a generation that nothing points to, were they ever so near."""
    server = Server(site)
    z = make_building(make_model(), 7, 2)[3][0]
    generation = layout.new_generation()
    row = {"generation": generation, "x": 0.0, "y": 0.0, "z": 0.0, "embedding": 9 * z}
    server.insert(
        layout.places(site.name, 6), [{"key": f"{generation}:{i}", "row": i, "id": f"{i}", **row} for i in range(50)]
    )
    source = MilvusSource(site)
    nearest = source.nearest(z, 19)
    assert sorted(set(nearest.buildings)) == ["a", "b"]
    assert len(nearest.place_ids) == 19
    server.delete(layout.places(site.name, 6), f"generation == {generation}")
    server.close()
    source.close()


def test_queries_that_do_not_fit(site: MilvusAddress) -> None:
    source = MilvusSource(site)
    z = np.zeros(6, dtype=np.float32)
    for query, k, message in (
        (np.zeros(5, dtype=np.float32), 3, "query of 6 numbers"),
        (np.full(6, np.nan, dtype=np.float32), 3, "finite query"),
        (z, 0, "k of 1 to 16384"),
        (z, 20_000, "k of 1 to 16384"),
    ):
        with pytest.raises(MapError, match=message):
            source.nearest(query, k)
    with pytest.raises(MapError, match=r"one of the map's buildings: a, b \(got '\"\] or 1 == 1'\)"):
        source.nearest(z, 3, ['"] or 1 == 1'])
    with pytest.raises(MapError, match=r"one of the map's buildings: a, b \(got 'c'\)"):
        source.fetch("c")
    source.close()


def test_what_is_no_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody there, somebody who says nothing, and somebody else: one line each, the token in none."""
    monkeypatch.setenv(TOKEN_VARIABLE, "root:secret-word")
    with socket.socket() as silent, http.server.HTTPServer(("127.0.0.1", 0), http.server.BaseHTTPRequestHandler) as web:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        threading.Thread(target=web.serve_forever, daemon=True).start()
        with socket.socket() as gone:
            gone.bind(("127.0.0.1", 0))
            free = gone.getsockname()[1]
        for port in (free, silent.getsockname()[1], web.server_port):
            source = MilvusSource(MilvusAddress("127.0.0.1", port, "x"), timeout_s=0.5)
            with pytest.raises(MapUnavailableError) as caught:
                source.catalogue()
            assert re.fullmatch(ONE_LINE, str(caught.value)), caught.value
            assert re.search(rf"127.0.0.1:{port}/x (within 0.5 s )?\(got none", str(caught.value)), caught.value
            assert "secret" not in str(caught.value)
            source.close()
        web.shutdown()


def test_a_wait_that_was_not_made_is_not_claimed() -> None:
    with socket.socket() as gone:
        gone.bind(("127.0.0.1", 0))
        free = gone.getsockname()[1]
    source = MilvusSource(MilvusAddress("127.0.0.1", free, "x"), timeout_s=60)
    with pytest.raises(MapUnavailableError, match=r"/x \(got none: no server there\)"):
        source.catalogue()
    source.close()


def test_a_missing_certificate_is_named_with_its_variable(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(CERTIFICATE_VARIABLE, str(tmp_path / "ca.pem"))
    source = MilvusSource(MilvusAddress("127.0.0.1", 1, "x", secure=True))
    with pytest.raises(MapError, match=rf"expected {CERTIFICATE_VARIABLE} to name a file \(got .*ca.pem"):
        source.catalogue()


def test_no_such_map(site: MilvusAddress) -> None:
    with pytest.raises(MapError, match=r"expected a map 'nowhere' at http://127.0.0.1:\d+ \(got maps: .*hostile_"):
        FleetDatabase.open(MilvusAddress(site.host, site.port, "nowhere"))
    source = MilvusSource(MilvusAddress(site.host, site.port, "nowhere"))
    with pytest.raises(MapError, match="expected a map 'nowhere'"):
        source.catalogue()
