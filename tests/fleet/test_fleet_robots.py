"""Robots on a real server: as on a file, through its restart, and while writers change what they stand on."""

import threading
import time

import numpy as np
import pytest
from lite_server import LiteServer
from msgspec.structs import replace
from small_building import building_update, delta, make_map, make_model

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.encoding.model import embed_graph
from semloc_core.errors import MapError, MapUnavailableError
from semloc_core.fleet.file_source import FileSource
from semloc_core.fleet.link import Link
from semloc_core.fleet.localiser import FleetLocaliser
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.milvus.source import MilvusSource
from semloc_core.fleet.narrowing import ShortlistConfig
from semloc_core.fleet.open_map import open_localiser
from semloc_core.fleet.writing.database import FleetDatabase
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.replay.recorded import replay
from semloc_core.sources import write_run
from semloc_core.sources.simulate import SimulationConfig, simulate_traversal

NAMES = ["hq/it's", 'hq/"1"', "hq/größe", "lab 1", "lab\\2", "lab%"]
FEW = ShortlistConfig(nearest=40, buildings=3)


@pytest.fixture(scope="module")
def model():
    return make_model("paper")


def embedded(model, seed):
    graph = SceneGraph.from_update(building_update(seed=seed))
    arrays = GraphArrays.from_scene_graph(graph, model.labelspace)
    return graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays)


@pytest.fixture
def file(tmp_path, model, address):
    """A map file, and the same map on the server."""
    path = tmp_path / f"{address.name}.map"
    make_map(path, model, **{name: building_update(seed=i) for i, name in enumerate(NAMES)})
    source = FileSource(path)
    with FleetDatabase.create(address, model) as database:
        for name in source.catalogue().buildings:
            fetched = source.fetch(name)
            database.copy_building(fetched.stored, fetched.places)
    return path


def test_a_replay_gives_the_same_bytes_from_file_and_server(file, address, tmp_path):
    graph = SceneGraph.from_update(building_update(seed=3))
    config = SimulationConfig.of(distance_m=15.0, rate_hz=2.0)
    write_run(tmp_path / "run.mcap", simulate_traversal(graph, config, np.random.default_rng(0)))
    config = LocaliserConfig(filter="bayes", buildings=("hq/*", "lab*"))
    for map_, name in ((str(file), "a.mcap"), (str(address), "b.mcap")):
        localiser = open_localiser(map_, config)
        replay(tmp_path / "run.mcap", localiser, config, results=tmp_path / name)
        localiser.close()
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@pytest.mark.parametrize("buildings", [(), ("lab*", "hq/*")], ids=["all", "sites"])
def test_short_list_of_file_and_server(file, address, buildings):
    config = LocaliserConfig(buildings=buildings)
    rng = np.random.default_rng(0)
    here, there = (
        FleetLocaliser(Link(source, rng), config, FEW) for source in (FileSource(file), MilvusSource(address))
    )
    for seed in (1, 4):
        for i in range(4):
            update = delta(i, query=f"p{5 + i}") if i else building_update(seed=seed, query="p5")
            mine, theirs = here.update(update), there.update(update)
            assert here.map.buildings == there.map.buildings
            assert wire.encode(mine.matches) == wire.encode(theirs.matches)
            assert mine.matches.matches
    there.close()


def test_addresses_that_lead_nowhere(address):
    with pytest.raises(MapUnavailableError, match="expected"):
        open_localiser("milvus+http://127.0.0.1:9/x", LocaliserConfig(server_timeout_s=0.5))
    waiting = open_localiser("milvus+http://127.0.0.1:9/x", LocaliserConfig(server_timeout_s=0.5), wait=True)
    assert waiting.update(building_update()).matches.status == "no_graph"
    waiting.close()
    for wait in (False, True):
        with pytest.raises(MapError, match="expected"):
            open_localiser(str(address), wait=wait)  # the server is there, the map is not
        with pytest.raises(MapError, match="expected an address"):
            open_localiser("milvus+http://user:secret@127.0.0.1/x", wait=wait)


def test_a_server_that_is_stopped_and_started_again(tmp_path, model, monkeypatch):
    server = LiteServer(tmp_path / "data")
    server.start()
    address = MilvusAddress("127.0.0.1", server.port, "site")
    with FleetDatabase.create(address, model) as database:
        for seed, name in enumerate(NAMES):
            database.add_building(name, *embedded(model, seed))
    now, asked, asking = [0.0], [], Server._guarded
    monkeypatch.setattr(Server, "_guarded", lambda *given: asked.append(1) or asking(*given))
    robots = [  # one holds all that there is, the other a short list
        FleetLocaliser(Link(MilvusSource(address, 2.0, 0.0), np.random.default_rng(0), lambda: now[0]), limits=limits)
        for limits in (ShortlistConfig(), FEW)
    ]
    before = [robot.update(building_update(seed=2)).matches for robot in robots]
    assert all(answer.matches for answer in before)
    server.stop(kill=True)
    for robot in robots:
        asked.clear()
        for i in range(1, 8):
            lost = robot.update(delta(i, query=f"p{i}")).matches
            assert (lost.status, lost.matches, lost.seq) == ("no_graph", [], i)
        assert len(asked) == 1, "by these robots' clock no time passes: it was asked again and again, or never"
    server.start()
    deadline = time.monotonic() + 120  # it hangs
    for robot, then in zip(robots, before, strict=True):
        while not robot.server().answers:
            assert time.monotonic() < deadline
            now[0] += 40.0  # longer than any pause
            robot.keep_up()
            time.sleep(0.05)
        again = robot.update(delta(8, query="p5")).matches
        # The robot has walked meanwhile: what it saw counts less for its pose.
        assert [replace(match, pose=None) for match in again.matches] == [
            replace(match, pose=None) for match in then.matches
        ]
        robot.close()
    server.stop(kill=True)


def test_robots_ask_while_writers_write(file, address, model):
    """Every answer is of buildings as they were committed at one time, whole; none is lost."""
    versions = {name: [embedded(model, seed)[3]] for seed, name in enumerate(NAMES)}
    done = threading.Event()
    problems: list[BaseException] = []
    answers: list[str] = []

    def robot(number):
        localiser = FleetLocaliser(Link(MilvusSource(address, 5.0, 0.05), np.random.default_rng(number)), limits=FEW)
        try:
            seq = 0
            while not done.is_set() or seq < 5:
                update = delta(seq, query=f"p{5 + seq % 20}") if seq else building_update(seed=number)
                located = localiser.update(update).located
                answers.append(located.matches.status)
                assert located.matches.status != "no_graph", located.query.reason
                loaded = located.map
                for name in loaded.buildings:
                    now = loaded.embeddings[loaded.rows_of(name)]
                    assert any(np.array_equal(now, one) for one in versions[name]), f"{name} was never like this"
                seq += 1
        except BaseException as error:
            problems.append(error)
        finally:
            localiser.close()

    robots = [threading.Thread(target=robot, args=(number,)) for number in range(3)]
    for thread in robots:
        thread.start()
    with FleetDatabase.open(address) as database:
        for change in range(6):
            name = NAMES[change % 3]
            fresh = embedded(model, 10 + change)
            versions[name].append(fresh[3])
            database.replace_building(name, *fresh)
            if change % 3 == 1:
                database.remove_building(NAMES[4])
            elif change % 3 == 2:
                database.add_building(NAMES[4], *embedded(model, 4))
    done.set()
    for thread in robots:
        thread.join(60)
    assert not problems, problems[0]
    assert len(answers) >= 15
