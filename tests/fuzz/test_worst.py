"""The worst that can be thought of, by hand: it is taken or refused in one line, and costs memory by its size alone."""

from __future__ import annotations

import io
import json
import resource
import struct
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import fuzz_seeds as seeds
import pytest
from fuzz_run import BYTES_PER_INPUT_BYTE, FLOOR_BYTES, HANG_S
from fuzz_targets import check_line
from killing import in_a_child
from small_building import building_update, make_map, make_model

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.encoding.model import Model
from semloc_core.errors import MapError, SemlocError
from semloc_core.graph.labels.files import load_labelspace
from semloc_core.localiser import Localiser
from semloc_core.map_database import load
from semloc_core.sources.bag import read_messages
from semloc_core.sources.hydra import read_hydra

LONG = 10**7
BYTES_PER_UPDATE_BYTE = 256
"""An update that is answered takes more than one that is only read: all that its query place reaches is embedded."""
WATCHED = {"open", "os.listdir", "os.scandir", "sqlite3.connect", "socket.connect", "subprocess.Popen", "os.system"}

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def update(**changes: object) -> bytes:
    """A full update of a small building with some members replaced."""
    return json.dumps(json.loads(wire.encode(building_update(12, 8))) | changes).encode()


def places(n: int) -> list[dict[str, object]]:
    return [{"id": str(i), "position": [i % 1000, i // 1000, 0]} for i in range(n)]


UPDATES: dict[str, Callable[[], bytes]] = {
    "100 MB": lambda: update(frame_id="x" * 100_000_000),
    "an id of ten million characters": lambda: update(places=[{"id": "x" * LONG, "position": [0, 0, 0]}]),
    "a class of ten million characters": lambda: update(
        objects=[{"id": "o", "class": "x" * LONG, "position": [0, 0, 0]}], edges=[]
    ),
    "an unknown node of ten million characters": lambda: update(edges=[["p0", "x" * LONG]]),
    "a member of ten million characters": lambda: update(**{"x" * LONG: 1}),
    "a number of ten million digits": lambda: update().replace(b'"seq": 0', b'"seq": ' + b"9" * LONG),
    "a coordinate of ten million digits": lambda: update().replace(b"1.0", b"0." + b"1" * LONG, 1),
    "escapes": lambda: update(frame_id="\x01" * 2_000_000),
    "lists in lists": lambda: update().replace(b'"frame_id": "odom"', b'"frame_id": ' + b"[" * LONG),
    "members in members": lambda: b'{"schema":' * 1_000_000,
    "many places": lambda: update(places=places(30_000), objects=[], edges=[], query_place="5"),
    "a star of places": lambda: update(
        places=places(20_000),
        objects=[{"id": "o", "class": "chair", "position": [0, 0, 0]}],
        edges=[["0", str(i)] for i in range(1, 20_000)] + [["0", "o"]],
        query_place="0",
    ),
    "one object seen from all": lambda: update(
        places=places(20_000),
        objects=[{"id": "o", "class": "chair", "position": [0, 0, 0]}],
        edges=[[str(i), "o"] for i in range(20_000)],
        query_place="0",
    ),
    "all edges twice over": lambda: update(edges=[["p0", "p1"], ["p1", "p0"]] * 200_000),
    "all removed": lambda: update(full=False, places=[], objects=[], edges=[], removed_nodes=["x"] * 500_000),
}


def hydra(**changes: object) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return json.dumps(json.loads(seeds.hydra(Path(folder))[0]) | changes).encode()


def node(number: int, **attributes: object) -> dict[str, object]:
    at = {"type": "PlaceNodeAttributes", "position": [0.0, 0.0, 0.0]} | attributes
    return {"id": number, "layer": number, "attributes": at}


HYDRA: dict[str, Callable[[], bytes]] = {
    "lists in lists": lambda: hydra().replace(b'"nodes": [', b'"nodes": ' + b"[" * LONG),
    "members in members": lambda: b'{"metadata":' * 1_000_000,
    "what is skipped nested": lambda: hydra().replace(b'"nodes": [', b'"mesh": ' + b"[" * LONG + b', "nodes": ['),
    "a layer for each of many nodes": lambda: hydra(nodes=[node(i) for i in range(30_000)], edges=[]),
    "many labelspaces": lambda: hydra(metadata={"labelspaces": {f"_l{i}p0": [[1, "a"]] for i in range(50_000)}}),
    "a name of ten million characters": lambda: hydra(metadata={"labelspaces": {"_l2p0": [[1, "x" * LONG]]}}),
    "an id of a million digits": lambda: hydra().replace(b'"id": ', b'"id": ' + b"9" * 1_000_000, 1),
    "one node many times": lambda: hydra(nodes=[node(1)] * 30_000, edges=[]),
}


def checkpoint(change: Callable[[dict[str, bytes]], object], compression: int = zipfile.ZIP_STORED) -> bytes:
    with zipfile.ZipFile(io.BytesIO(seeds.models()[0])) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def header(**config: object) -> Callable[[dict[str, bytes]], object]:
    def change(members: dict[str, bytes]) -> None:
        found = json.loads(members["header.json"])
        members["header.json"] = json.dumps(found | {"config": found["config"] | config}).encode()

    return change


def nested(members: dict[str, bytes]) -> None:
    deep = b'"provenance":' + b"[" * LONG + b"]" * LONG + b',"x":'
    members["header.json"] = members["header.json"].replace(b'"provenance":', deep)


def lying_sizes() -> bytes:
    """The directory says that a member has four gigabytes."""
    data = bytearray(seeds.models()[0])
    at = data.rindex(b"PK\x01\x02")
    data[at + 20 : at + 28] = struct.pack("<II", 2**32 - 2, 2**32 - 2)
    return bytes(data)


CHECKPOINTS: dict[str, Callable[[], bytes]] = {
    "a bomb": lambda: checkpoint(lambda m: m.update({"bomb.npy": bytes(200_000_000)}), zipfile.ZIP_DEFLATED),
    "a bomb in the header": lambda: checkpoint(lambda m: m.update({"header.json": b" " * 10**8}), zipfile.ZIP_DEFLATED),
    "a billion layers": lambda: checkpoint(header(layers=10**9)),
    "a billion heads": lambda: checkpoint(header(heads=10**9)),
    "a billion numbers a place": lambda: checkpoint(header(dimension=10**9)),
    "5,000 members": lambda: checkpoint(lambda m: m.update({f"{i}.npy": b"" for i in range(5_000)})),
    "a header nested": lambda: checkpoint(nested),
    "a member named as a path": lambda: checkpoint(lambda m: m.update({"../../x.npy": b""})),
    "sizes that lie": lying_sizes,
}


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


START = b"\x89MCAP0\r\n" + record(1, text(b"ros2") + text(b"test"))
BAGS: dict[str, Callable[[], bytes]] = {
    "a record of 2⁶³ bytes": lambda: START + struct.pack("<BQ", 6, 2**63),
    "many schemas": lambda: START + b"".join(
        record(3, struct.pack("<H", i % 65535 + 1) + text(b"n") + text(b"ros2msg") + text(b"")) for i in range(50_000)
    ),
    "many channels": lambda: START + b"".join(
        record(4, struct.pack("<HH", i % 65535, 0) + text(b"/t") + text(b"cdr") + text(b"")) for i in range(50_000)
    ),
    "many empty chunks": lambda: START + record(6, struct.pack("<QQQI", 0, 0, 0, 0) + text(b"") + bytes(8)) * 50_000,
    "a topic of ten million characters": lambda: START + record(
        4, struct.pack("<HH", 1, 0) + text(b"x" * LONG) + text(b"cdr") + text(b"")
    ),
}  # fmt: skip

LABELSPACES: dict[str, Callable[[], bytes]] = {
    "laughs": lambda: b"name: t\nclasses:\n- &a0 {name: a, ids: [1]}\n" + b"".join(
        b"x%d: &a%d [%s]\n" % (i, i, b",".join([b"*a%d" % (i - 1)] * 20)) for i in range(1, 30)
    ) + b"synonyms: *a29\n",
    "lists in lists": lambda: b"name: " + b"[" * 100_000,
    "a class of a million characters": lambda: b"name: t\nclasses:\n- {name: " + b"x" * 1_000_000 + b", ids: [1]}\n",
}  # fmt: skip


def cost(use: Callable[[], object]) -> dict[str, int | str]:
    """What a use of an input does to a process of its own: its line if it is refused, and the memory it takes more."""

    def work() -> dict[str, int | str]:
        line = ""
        resource.setrlimit(resource.RLIMIT_CPU, (HANG_S, HANG_S))
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak is counted from here
        before = resident("VmHWM")
        try:
            use()
        except SemlocError as error:
            line = str(error)
        return {"line": line, "bytes": resident("VmHWM") - before}

    return in_a_child(work)


def resident(what: str) -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(status.partition(f"{what}:")[2].split()[0])


def check(use: Callable[[], object], size: int, multiple: int = BYTES_PER_INPUT_BYTE) -> str:
    found = cost(use)
    line = str(found["line"])
    check_line(line)
    assert int(found["bytes"]) <= multiple * size + FLOOR_BYTES, (found, size)
    return line


@pytest.fixture(scope="module")
def localiser(tmp_path_factory: pytest.TempPathFactory) -> Localiser:
    loaded = make_map(tmp_path_factory.mktemp("map") / "a.map", make_model("paper"), home=building_update())
    found = Localiser(loaded, LocaliserConfig(filter="bayes"))
    found.update(update())
    return found


@pytest.mark.parametrize("name", UPDATES)
def test_updates(name: str, localiser: Localiser) -> None:
    data = UPDATES[name]()
    line = check(lambda: localiser.update(data), len(data), BYTES_PER_UPDATE_BYTE)
    assert name != "100 MB" or "at most" in line


def test_a_hundred_megabytes_where_they_are_allowed(localiser: Localiser) -> None:
    data = UPDATES["100 MB"]()
    wide = Localiser(localiser.map, LocaliserConfig(max_update_bytes=2**30, filter="bayes"))
    assert check(lambda: wide.update(data), len(data), BYTES_PER_UPDATE_BYTE) == ""


@pytest.mark.parametrize("name", HYDRA)
def test_scene_graph_files(name: str, tmp_path: Path) -> None:
    path = tmp_path / "graph.json"
    path.write_bytes(HYDRA[name]())
    check(lambda: read_hydra(path), path.stat().st_size)


@pytest.mark.parametrize("name", CHECKPOINTS)
def test_checkpoints(name: str) -> None:
    data = CHECKPOINTS[name]()
    assert check(lambda: Model.from_bytes(data), len(data))


@pytest.mark.parametrize("name", BAGS)
def test_bags(name: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(BAGS[name]())
    check(lambda: list(read_messages(path)), path.stat().st_size)


@pytest.mark.parametrize("name", LABELSPACES)
def test_labelspaces(name: str, tmp_path: Path) -> None:
    path = tmp_path / "space.yaml"
    path.write_bytes(LABELSPACES[name]())
    check(lambda: load_labelspace(str(path)), path.stat().st_size)


def test_no_path_in_a_message_is_opened(localiser: Localiser) -> None:
    """Ids, classes and frames are names, also where they look like files; nothing is opened for an update at all."""
    paths = (
        "../../../etc/passwd",
        "/etc/passwd",
        "file:///etc/passwd",
        "~/.ssh/id_rsa",
        "..",
        "C:\\boot.ini",
        "%2e%2e/x",
    )
    messages = [
        update(
            seq=0,
            frame_id=path,
            places=[{"id": path, "position": [0, 0, 0]}, {"id": "b", "position": [1, 0, 0]}],
            objects=[{"id": f"{path}/o", "class": path, "position": [0, 0, 0]}],
            edges=[[path, f"{path}/o"], [path, "b"]],
            query_place=path,
        )
        for path in paths
    ]
    localiser.update(messages[0])  # what is loaded when first needed

    def work() -> dict[str, int | str]:
        opened: list[str] = []
        sys.addaudithook(lambda event, given: opened.append(f"{event} {given[:1]}") if event in WATCHED else None)
        for message in messages:
            localiser.update(message)
        return {"opened": " ".join(opened)}

    assert in_a_child(work) == {"opened": ""}


def test_maps_behind_links(tmp_path: Path) -> None:
    loaded = make_map(tmp_path / "a.map", make_model("paper"), **{"../../etc": building_update(6, 3)})
    (tmp_path / "link.map").symlink_to("a.map")
    (tmp_path / "loop.map").symlink_to("loop.map")
    (tmp_path / "nothing.map").symlink_to("/proc/self/mem")
    found = load(tmp_path / "link.map")
    assert (found.hash, found.buildings) == (loaded.hash, ("../../etc",))
    assert found.graph("../../etc").places
    for name in ("loop.map", "nothing.map"):
        with pytest.raises(MapError) as refused:
            load(tmp_path / name)
        check_line(str(refused.value))
    assert {each.name for each in tmp_path.iterdir()} == {"a.map", "link.map", "loop.map", "nothing.map"}
