"""What must not change an answer: how many are asked at once, the order in a message, threads, the processor."""

import os
import random
import subprocess
import sys

import msgspec
import numpy as np
import pytest
import torch
from small_building import CLASSES, SPACE, building_update, delta, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.encoding.encoder import ENCODERS
from semloc_core.encoding.model import embed_batch
from semloc_core.encoding.place_graph import Batch, extract
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.graph.visibility import Visibility
from semloc_core.localiser import Localiser
from semloc_core.wire import codec as wire
from semloc_core.wire.codec import Object, Place, SceneGraphUpdate

CLOSE = 1e-5
LEARNED = [name for name in ENCODERS if name not in ("bag_of_words", "tfidf", "histogram")]


def batch_of(model, places: list[str]) -> Batch:
    graph = SceneGraph.from_update(building_update(30, 20))
    extraction = model.encoder.extraction
    return extract(graph, Visibility(graph, extraction.visibility_m), SPACE, places, extraction)


@pytest.mark.parametrize("name", LEARNED)
def test_a_batch_of_one_is_as_a_batch_of_many(name):
    model = make_model(name)
    places = [f"p{i}" for i in range(30)]
    many = embed_batch(model, batch_of(model, places))
    one = np.concatenate([embed_batch(model, batch_of(model, [place])) for place in places])
    assert np.abs(many - one).max() < CLOSE


def walk() -> list[SceneGraphUpdate]:
    """A building, and updates of every kind while the robot walks on."""
    things = [Object(f"n{i}", CLASSES[i % 4], (12.0 + i, 0.5, 0.3)) for i in range(5)]
    rooms = [Place(f"q{i}", (12.0 + 0.5 * i, 1.0, 0.0)) for i in range(5)]
    return [
        building_update(30, 20),
        delta(1, query="p7", objects=things, edges=[(f"p{12 + i}", f"n{i}") for i in range(5)]),
        delta(2, query="p9", places=rooms, edges=[(f"q{i}", f"p{12 + i}") for i in range(5)]),
        delta(3, query="p11", removed_nodes=["o1", "o2", "p28"], sightings=[("p11", "n0"), ("p12", "n0")]),
        delta(4, query="q3", places=[Place("q1", (12.4, 1.3, 0.0)), Place("p14", (14.1, 0.2, 0.0))]),
    ]


def shuffled(update: SceneGraphUpdate, rng: random.Random) -> SceneGraphUpdate:
    """The same update, in another order; edges also the other way round."""
    lists = ("places", "objects", "sightings", "removed_nodes")
    parts = {part: rng.sample(getattr(update, part), len(getattr(update, part))) for part in lists}
    edges = [pair if rng.random() < 0.5 else pair[::-1] for pair in rng.sample(update.edges, len(update.edges))]
    return msgspec.structs.replace(update, **parts, edges=edges)


@pytest.mark.parametrize(("rerank", "filter_"), [("layout", "none"), ("layout", "bayes"), ("none", "none")])
@pytest.mark.parametrize("name", LEARNED)
def test_the_order_of_nodes_and_edges_in_a_message_does_not_matter(name, rerank, filter_, tmp_path):
    """Byte for byte, explanation included, from the first update to the last of a walk."""
    buildings = {"home": building_update(30, 20), "other": building_update(25, 18, seed=4)}
    loaded = make_map(tmp_path / "home.map", make_model(name), **buildings)
    rng, answers = random.Random(0), set()
    for _ in range(3):
        localiser = Localiser(loaded, LocaliserConfig(explain_rate_hz=1000.0, rerank=rerank, filter=filter_))
        said = b""
        for update in walk():
            result = localiser.update(shuffled(update, rng))
            assert result.attributions is not None
            said += wire.encode(result.matches) + wire.encode(result.attributions)
        answers.add(said)
    assert len(answers) == 1


def test_the_number_of_threads_does_not_matter(tmp_path):
    """Byte for byte: the wire rounds to 6 decimals, and the few candidates of a search are scored in float64."""
    encoders = ("paper", "geodesic_attention")
    for name in encoders:
        loaded = make_map(tmp_path / f"{name}.map", make_model(name), home=building_update(30, 20))
    (tmp_path / "walk.json").write_bytes(b"\n".join(wire.encode(update) for update in walk()))
    program = f"""
import sys, torch
torch.set_num_threads(int(sys.argv[1]))
from semloc_core.wire import codec as wire
from semloc_core.config import LocaliserConfig
from semloc_core.localiser import Localiser
from semloc_core.map_database import load
folder = {str(tmp_path)!r}
for name, filter_ in [(name, filter_) for name in {encoders} for filter_ in ("none", "bayes")]:
    config = LocaliserConfig(explain_rate_hz=1000.0, filter=filter_)
    localiser = Localiser(load(f"{{folder}}/{{name}}.map"), config)
    for line in open(f"{{folder}}/walk.json"):
        result = localiser.update(line)
        sys.stdout.buffer.write(wire.encode(result.matches) + wire.encode(result.attributions))
"""
    said = {
        subprocess.run(
            [sys.executable, "-c", program, threads],
            env={**os.environ, "OMP_NUM_THREADS": threads},
            capture_output=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    }
    assert len(said) == 1
    assert loaded.hash.encode() in said.pop()


@pytest.mark.parametrize("poison", [float("nan"), float("inf"), 1e38])
def test_weights_that_overflow_are_refused_or_do_no_harm(poison, tmp_path):
    """NaN can't get out: of a checkpoint, of a map, of a message."""
    model = make_model("paper")
    with torch.no_grad():
        model.encoder.embed.bias[0] = poison
    if poison != 1e38:
        with pytest.raises(Exception, match="finite"):
            type(model).from_bytes(model.to_bytes())
        with pytest.raises(Exception, match="finite"):
            make_map(tmp_path / "home.map", model, home=building_update())
        return
    loaded = make_map(tmp_path / "home.map", model, home=building_update())
    result = Localiser(loaded).update(building_update())
    wire.decode(wire.encode(result.matches), wire.PlaceMatches)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", LEARNED)
def test_a_gpu_gives_what_the_processor_gives(name):
    """Within 1e-4: another order of sums, and TF32 off."""
    torch.backends.cuda.matmul.allow_tf32 = False
    model = make_model(name)
    batch = batch_of(model, [f"p{i}" for i in range(30)])
    here = embed_batch(model, batch)
    fields = {key: value.cuda() if isinstance(value, torch.Tensor) else value for key, value in vars(batch).items()}
    model.encoder.cuda()
    there = embed_batch(model, Batch(**fields))
    assert np.abs(here - there).max() < 1e-4
