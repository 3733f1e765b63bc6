"""What is fuzzed. A target takes bytes and raises nothing but what a caller is told to expect, in one line.

`TARGETS` names them; each is made with an empty folder to work in, and gives its seeds.
"""

from __future__ import annotations

import hashlib
import io
import json
import random
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import fuzz_seeds as seeds
import msgspec
import numpy as np
from fuzz_mutate import damage, damage_json

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.encoding.model import Model
from semloc_core.errors import GraphError, MessageError, SemlocError
from semloc_core.graph.labels.files import load_labelspace
from semloc_core.localiser import Localiser
from semloc_core.map_database import describe, load
from semloc_core.map_database.stored.records import PackedGraph, unpack_graph
from semloc_core.sources import read_run
from semloc_core.sources.bag import read_messages
from semloc_core.sources.hydra import read_hydra
from semloc_core.wire.messages import MESSAGES

LONGEST_LINE = 1000


class Target:
    """Bytes in; counts of what became of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.counts: Counter[str] = Counter()
        self.seeds: tuple[bytes, ...] = ()
        self.setup()

    def setup(self) -> None:
        """Make the seeds."""

    def mutate(self, data: bytes, rng: random.Random) -> bytes:
        """A new input from one of the seeds."""
        return damage(data, rng, self.seeds)

    def use(self, data: bytes) -> None:
        """What a program does with the bytes; may raise SemlocError."""
        raise NotImplementedError

    def __call__(self, data: bytes) -> None:
        """Use them; an error that is not one line is a fault, and so is any error that is not ours."""
        try:
            self.use(data)
        except SemlocError as error:
            check_line(str(error))
            self.counts["refused"] += 1
        else:
            self.counts["taken"] += 1


def check_line(line: str) -> None:
    """One printable line of bounded length."""
    assert "\n" not in line, line
    assert len(line) <= LONGEST_LINE, f"{len(line)} characters: {line[:200]}"
    assert line.isprintable(), repr(line)


class Wire(Target):
    """JSON text to messages, of all kinds; what is taken is written and read again, and is the same."""

    def setup(self) -> None:
        self.seeds = seeds.messages() + seeds.updates()

    def mutate(self, data: bytes, rng: random.Random) -> bytes:
        if rng.random() < 0.6:
            try:
                return damage_json(data, rng)
            except ValueError:  # examples of what must be refused
                pass
        return damage(data, rng, self.seeds)

    def use(self, data: bytes) -> None:
        refused = None
        for type_ in MESSAGES.values():
            try:
                message = wire.decode(data, type_)
            except MessageError as error:
                check_line(str(error))
                refused = error
            else:
                text = wire.encode(message)
                assert wire.encode(wire.decode(text, type_)) == text
                return
        if refused is not None:
            raise refused


class Hydra(Target):
    """A scene-graph file; what is taken is a graph that the wire takes as well."""

    def setup(self) -> None:
        self.seeds = seeds.hydra(self.folder)

    def mutate(self, data: bytes, rng: random.Random) -> bytes:
        return damage_json(data, rng) if rng.random() < 0.7 else damage(data, rng)

    def use(self, data: bytes) -> None:
        path = self.folder / "input.json"
        path.write_bytes(data)
        found = read_hydra(path)
        wire.decode_update(wire.encode(found.graph.to_update(0, 0, found.frame_id)), 2**30)


class Bag(Target):
    """An mcap file: all its messages, and the run in it."""

    def setup(self) -> None:
        self.seeds = seeds.bags(self.folder)

    def use(self, data: bytes) -> None:
        path = self.folder / "input.mcap"
        path.write_bytes(data)
        for _ in read_messages(path):
            pass
        for _ in read_run(path):
            pass


class MapFile(Target):
    """A map file: loaded, its graphs unpacked, described."""

    def setup(self) -> None:
        self.seeds = seeds.maps(self.folder)
        path = self.folder / "sound.map"
        path.write_bytes(self.seeds[0])
        self.sound = load(path).hash

    def use(self, data: bytes) -> None:
        path = self.folder / "input.map"
        for left in self.folder.glob("input.map*"):
            left.unlink()
        path.write_bytes(data)
        loaded = load(path)
        assert loaded.hash == self.sound, "a changed map was taken for sound"
        for building in loaded.buildings:
            loaded.graph(building)
        describe(path)


class MapGraph(Target):
    """The scene graph in a map, as somebody who makes the digests fit can forge it."""

    def setup(self) -> None:
        self.seeds = seeds.updates()[:3]

    def mutate(self, data: bytes, rng: random.Random) -> bytes:
        return damage_json(data, rng) if rng.random() < 0.7 else damage(data, rng)

    def use(self, data: bytes) -> None:
        unpack_graph(PackedGraph(hashlib.sha256(data).hexdigest(), len(data), zlib.compress(data)))


class Checkpoint(Target):
    """A model file; half of the inputs are whole archives whose members were damaged."""

    def setup(self) -> None:
        self.seeds = seeds.models()
        self.sound = {Model.from_bytes(seed).hash for seed in self.seeds}

    def mutate(self, data: bytes, rng: random.Random) -> bytes:
        if rng.random() < 0.5:
            return damage(data, rng, self.seeds)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        name = "header.json" if rng.random() < 0.6 else rng.choice(list(members))
        change: Callable[..., bytes] = damage_json if name == "header.json" and rng.random() < 0.8 else damage
        members[name] = change(members[name], rng)
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", rng.choice((0, 0, 0, 8))) as archive:
            for each, content in members.items():
                archive.writestr(each, content)
        return out.getvalue()

    def use(self, data: bytes) -> None:
        model = Model.from_bytes(data)
        assert model.hash in self.sound, "a changed model was taken for sound"


class Yaml(Target):
    """A labelspace file."""

    def setup(self) -> None:
        self.seeds = (seeds.YAML,)

    def use(self, data: bytes) -> None:
        path = self.folder / "input.yaml"
        path.write_bytes(data)
        load_labelspace(str(path))


class Live(Target):
    """Updates through one localiser that lives on; after a refusal nothing has changed, and no NaN gets out."""

    filter = "none"
    known: bytes | None = None
    """The state as it was left, where that was looked at."""

    def setup(self) -> None:
        self.seeds = seeds.updates()
        path = self.folder / "live.map"
        path.write_bytes(seeds.maps(self.folder)[0])
        self.localiser = Localiser(load(path), LocaliserConfig(explain_rate_hz=2.0, filter=self.filter))

    def mutate(self, data: bytes, rng: random.Random) -> bytes:
        graph, stream = self.localiser.live.stream.graph, self.localiser.live.stream
        if graph is None or len(graph.places) + len(graph.objects) > 200:
            return self.seeds[0]
        document = json.loads(data)
        if rng.random() < 0.9:
            document["seq"] = stream._seq + 1
        text = json.dumps(document).encode()
        chance = rng.random()
        return text if chance < 0.1 else damage_json(text, rng) if chance < 0.8 else damage(text, rng, self.seeds)

    def state(self) -> bytes:
        """All that an update can change, to the last bit and in its order."""
        at, live, stream = self.localiser, self.localiser.live, self.localiser.live.stream
        index, past = stream.graph and stream.graph._index, at._filter
        kept = live.surroundings and live.surroundings._ego
        parts = (
            stream.graph and vars(stream.graph) | {"_index": index and vars(index)},
            (stream._seq, live._seq, live._stamp_ns, live.odometry, at._explained_ns, live.unknown_classes),
            live.visibility and {name: value for name, value in vars(live.visibility).items() if name != "graph"},
            kept and (kept._slots, kept._free, kept._ids, kept._rows, kept._kind),
            past and (past._kept, past._spots),
        )
        return msgspec.msgpack.encode(parts, enc_hook=np.ndarray.tobytes)

    def use(self, data: bytes) -> None:
        before = self.known or self.state()
        try:
            result = self.localiser.update(data)
        except (MessageError, GraphError):
            self.known = self.state()
            assert self.known == before, "a refused update changed something"
            raise
        self.known = None
        self.counts[result.outcome.value] += 1
        for message, type_ in (
            (result.matches, wire.PlaceMatches),
            (result.attributions, wire.ClassAttributions),
        ):
            if message is not None:
                wire.decode(wire.encode(message), type_)
        if result.matches is not None:
            self.counts[result.matches.status] += 1


class LiveFiltered(Live):
    """The same with the filter."""

    filter = "bayes"


TARGETS: dict[str, type[Target]] = {
    "wire": Wire,
    "hydra": Hydra,
    "bag": Bag,
    "map": MapFile,
    "map_graph": MapGraph,
    "checkpoint": Checkpoint,
    "labelspace": Yaml,
    "localiser": Live,
    "localiser_filtered": LiveFiltered,
}
