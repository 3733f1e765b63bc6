"""A place's embedding is one thing: from the online graph, from a whole building, whatever the number of threads."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from semloc_core.encoding import model as model_module
from semloc_core.encoding.encoder import ENCODERS, build_encoder
from semloc_core.encoding.model import Model, embed_batch, embed_graph
from semloc_core.encoding.place_graph import extract, repeat
from semloc_core.errors import ModelError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.graph.visibility import Visibility
from semloc_core.sources.hydra import read_hydra
from semloc_core.wire import Object, Place, SceneGraphUpdate

LABELSPACE = Labelspace("test", ("chair", "couch", "plant"))


def corridor(places: int = 14, seed: int = 0) -> SceneGraph:
    """A corridor with alcoves and one isolated place; one class is unknown; some objects are sighted explicitly."""
    rng = np.random.default_rng(seed)
    names = [f"p{i}" for i in range(places)]
    classes = ("chair", "couch", "plant", "unheard_of")
    objects = [f"o{i}" for i in range(9)]
    edges = [(names[i], names[i - 1 if i % 3 else max(0, i - 2)]) for i in range(1, places - 1)]
    edges += [(o, names[int(rng.integers(places - 1))]) for o in objects]
    return SceneGraph.from_update(
        SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=0,
            frame_id="map",
            query_place=None,
            seq=0,
            full=True,
            places=[Place(p, (1.3 * i, 0.2 * (i % 3), 0.0)) for i, p in enumerate(names)],
            objects=[Object(o, classes[i % 4], (0.0, 0.0, 0.0)) for i, o in enumerate(objects)],
            edges=edges,
            sightings=[("p2", "o3"), ("p9", "o3")],
        )
    )


def make(name: str, labelspace: Labelspace = LABELSPACE) -> Model:
    """A model whose batch norms have seen data."""
    encoder = build_encoder(name, None, len(labelspace), torch.Generator().manual_seed(1))
    generator = torch.Generator().manual_seed(2)
    for key, buffer in encoder.named_buffers():
        if key.endswith(("running_mean", "running_var", "idf")):
            buffer.uniform_(0.3, 1.5, generator=generator)
    return Model(encoder.eval(), labelspace)


def one_by_one(model: Model, graph: SceneGraph, places: tuple[str, ...]) -> np.ndarray:
    """Each place as a query of the online graph."""
    extraction = model.encoder.extraction
    visibility = Visibility(graph, extraction.visibility_m)
    batches = [extract(graph, visibility, model.labelspace, [place], extraction) for place in places]
    return np.concatenate([embed_batch(model, batch) for batch in batches])


@pytest.mark.parametrize("name", sorted(ENCODERS))
def test_a_query_and_its_place_in_the_map_have_the_same_embedding(name: str) -> None:
    model, graph = make(name), corridor()
    arrays = GraphArrays.from_scene_graph(graph, LABELSPACE)
    z = embed_graph(model, arrays)
    assert z.shape == (14, model.encoder.dimension)
    assert z.dtype == np.float32
    np.testing.assert_allclose(one_by_one(model, graph, arrays.place_ids), z, atol=1e-5)
    batch = extract(
        graph,
        Visibility(graph, model.encoder.extraction.visibility_m),
        LABELSPACE,
        arrays.place_ids,
        model.encoder.extraction,
    )
    np.testing.assert_allclose(embed_batch(model, batch), z, atol=1e-5)
    lengths = np.linalg.norm(z, axis=1)
    assert ((np.abs(lengths - 1) < 1e-5) | (lengths == 0)).all()


@pytest.mark.data
@pytest.mark.parametrize("name", sorted(ENCODERS))
def test_the_same_on_a_real_apartment(name: str, data_root: Path) -> None:
    file = read_hydra(data_root / "hydra" / "apartment_short.json")
    labelspace = Labelspace("its own", tuple(sorted({o.class_ for o in file.graph.objects.values()})))
    model = make(name, labelspace)
    arrays = GraphArrays.from_scene_graph(file.graph, labelspace)
    z = embed_graph(model, arrays)
    some = range(0, arrays.n_places, 4)
    np.testing.assert_allclose(
        one_by_one(model, file.graph, tuple(arrays.place_ids[i] for i in some)), z[list(some)], atol=1e-5
    )


@pytest.mark.parametrize("name", ["rings", "histogram"])
def test_chunks_of_roots_change_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model, arrays = make(name), GraphArrays.from_scene_graph(corridor(), LABELSPACE)
    whole = embed_graph(model, arrays)
    for size in (1, 7, 13):
        monkeypatch.setattr(model_module, "ROOTS_AT_ONCE", size)
        np.testing.assert_array_equal(embed_graph(model, arrays), whole)


@pytest.fixture
def restore_threads() -> Iterator[None]:
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize("name", ["paper", "rings"])
@pytest.mark.usefixtures("restore_threads")
def test_the_number_of_threads_does_not_matter(name: str) -> None:
    """Enough places for torch to split the work."""
    model = make(name)
    arrays = GraphArrays.from_scene_graph(corridor(places=1200), LABELSPACE)
    found = []
    for threads in (1, 2, 4):
        torch.set_num_threads(threads)
        found.append(embed_graph(model, arrays))
    np.testing.assert_allclose(found[1], found[0], atol=1e-6, rtol=0)
    np.testing.assert_allclose(found[2], found[0], atol=1e-6, rtol=0)


@pytest.mark.parametrize("name", sorted(ENCODERS))
def test_an_empty_building_has_no_embeddings(name: str) -> None:
    model = make(name)
    z = embed_graph(model, GraphArrays.from_scene_graph(SceneGraph(), LABELSPACE))
    assert z.shape == (0, model.encoder.dimension)
    assert z.dtype == np.float32


@pytest.mark.parametrize("name", sorted(ENCODERS))
def test_copies_of_a_batch_can_lose_different_objects(name: str) -> None:
    """What explainers do: many copies at once, each with an object removed, equal to one removal at a time."""
    model, graph = make(name), corridor()
    extraction = model.encoder.extraction
    batch = extract(graph, Visibility(graph, extraction.visibility_m), LABELSPACE, ["p5"], extraction)
    objects = torch.nonzero(batch.is_object).flatten()
    copies, rows = repeat(batch, len(objects))
    keep = torch.ones(copies.n_nodes, dtype=torch.bool)
    keep[rows[torch.arange(len(objects)), objects]] = False
    with torch.inference_mode():
        together = model.encoder(copies, keep)
        for i, o in enumerate(objects.tolist()):
            alone = model.encoder(batch, torch.arange(batch.n_nodes) != o)
            torch.testing.assert_close(together[i : i + 1], alone, atol=1e-5, rtol=0)


def test_embedding_leaves_the_mode_of_the_encoder_as_it_was() -> None:
    model = make("paper")
    arrays = GraphArrays.from_scene_graph(corridor(), LABELSPACE)
    evaluated = embed_graph(model, arrays)
    model.encoder.train()
    np.testing.assert_array_equal(embed_graph(model, arrays), evaluated)
    assert model.encoder.training


def test_weights_too_large_for_an_embedding_are_an_error_not_nan() -> None:
    model = make("paper")
    with torch.no_grad():
        model.encoder.get_parameter("embed.weight").fill_(3e38)
    with pytest.raises(ModelError, match="expected finite embeddings"):
        embed_graph(model, GraphArrays.from_scene_graph(corridor(), LABELSPACE))
