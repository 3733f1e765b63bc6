"""Extraction: neighbourhoods are exact, trimmed, and the same whatever the order of a message."""

import random
from collections import defaultdict
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from graph_strategies import update, valid_updates
from hypothesis import given, settings
from hypothesis import strategies as st

from semloc_core.encoding.place_graph import (
    Batch,
    ego_batch,
    extract,
    extract_all,
    reach_all_batch,
    reach_batch,
    repeat,
    union,
    whole_graph_batch,
)
from semloc_core.encoding.place_graph.extraction import Extraction
from semloc_core.errors import GraphError, LabelspaceError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.graph.visibility import Visibility, visible_pairs
from semloc_core.sources.hydra import read_hydra
from semloc_core.wire import Object, Place, SceneGraphUpdate

LABELS = Labelspace("test", ("chair", "couch", "box"))
Edges = dict[tuple[str, str], float]


def corridor(class_of_z: str = "box") -> SceneGraph:
    """Places p0 … p3 a metre apart, p4 alone; objects a at p0, z at p1."""
    places = [Place(f"p{i}", (float(i), 0.0, 0.0)) for i in range(4)] + [Place("p4", (9.0, 9.0, 0.0))]
    objects = [Object("a", "couch", (0.0,) * 3), Object("z", class_of_z, (1.0, 0.0, 0.0))]
    edges = [("p0", "p1"), ("p1", "p2"), ("p2", "p3"), ("p0", "a"), ("p1", "z")]
    return SceneGraph.from_update(update(places, objects, edges, full=True))


def ego(graph: SceneGraph, places: list[str], hops: int, radius_m: float = 1.0) -> Batch:
    return ego_batch(graph, Visibility(graph, radius_m), LABELS, places, hops)


def named_edges(batch: Batch) -> list[tuple[str, str, float]]:
    ids = batch.node_ids
    pairs = zip(batch.edge_index.T.tolist(), batch.edge_length.tolist(), strict=True)
    return [(ids[s], ids[t], length) for (s, t), length in pairs]


def check(batch: Batch) -> None:
    """What every batch promises, beyond what it checks itself."""
    hops = len(batch.edges_within)
    assert batch.features.isfinite().all()
    assert batch.edge_length.isfinite().all()
    assert (batch.edge_length >= 0).all()
    assert batch.features[~batch.is_object].abs().sum() == 0
    assert set(batch.features.sum(dim=1).tolist()) <= {0.0, 1.0}
    assert not batch.is_object[: batch.n_roots].any()
    source, target = batch.edge_index
    assert torch.equal(batch.graph[source], batch.graph[target])
    keys = target * batch.n_nodes + source
    assert (keys.diff() > 0).all(), "edges by target, then source, each once"
    for h in range(hops):
        inner = batch.edges_within[h]
        assert (target[:inner] < batch.nodes_within[h]).all()
        assert (target[inner:] >= batch.nodes_within[h]).all()
        assert (source[:inner] < batch.nodes_within[h + 1]).all()


def test_an_ego_graph_by_hand() -> None:
    batch = ego(corridor(), ["p1"], hops=2)
    check(batch)
    assert batch.node_ids == ("p1", "a", "p0", "p2", "z", "p3")
    assert batch.nodes_within == (1, 5, 6)
    assert batch.is_object.tolist() == [False, True, False, False, True, False]
    assert batch.features.tolist() == [[0, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 0]]
    assert named_edges(batch) == [
        *[("a", "p1", 1.0), ("p0", "p1", 1.0), ("p2", "p1", 1.0), ("z", "p1", 0.0)],
        *[("p1", "a", 1.0), ("p0", "a", 0.0)],
        *[("p1", "p0", 1.0), ("a", "p0", 0.0), ("z", "p0", 1.0)],
        *[("p1", "p2", 1.0), ("z", "p2", 1.0), ("p3", "p2", 1.0)],
        *[("p1", "z", 0.0), ("p0", "z", 1.0), ("p2", "z", 1.0)],
    ]
    assert batch.edges_within == (4, 15)


def test_objects_of_a_class_the_labelspace_lacks_are_left_out() -> None:
    """Else they would count as something seen, and be given a part in a match."""
    graph = corridor("unheard-of")
    batch = ego(graph, ["p1"], hops=2)
    check(batch)
    assert batch.node_ids == ("p1", "a", "p0", "p2", "p3")
    assert reach_batch(graph, LABELS, ["p1"], 2.0).node_ids == ("p1", "a")
    arrays = GraphArrays.from_scene_graph(graph, LABELS)
    assert reach_all_batch(arrays, 3, 2.0, np.array([1])).node_ids == ("p1", "a")
    whole = whole_graph_batch(arrays, 3, 2, 1.0)
    assert "z" not in {name for source, target, _ in named_edges(whole) for name in (source, target)}


def test_edges_into_the_outermost_nodes_are_left_out() -> None:
    batch = ego(corridor(), ["p1"], hops=1)
    assert batch.node_ids == ("p1", "a", "p0", "p2", "z")
    assert {target for _, target, _ in named_edges(batch)} == {"p1"}


def test_several_roots_do_not_touch_each_other() -> None:
    batch = ego(corridor(), ["p1", "p4", "p1", "p0"], hops=1)
    check(batch)
    assert batch.n_roots == 4
    assert batch.node_ids[:4] == ("p1", "p4", "p1", "p0")
    assert batch.graph.tolist() == [0, 1, 2, 3, 0, 0, 0, 0, 2, 2, 2, 2, 3, 3, 3]
    assert batch.nodes_within == (4, 15)


def test_no_hops_is_the_roots() -> None:
    batch = ego(corridor(), ["p1", "p0"], hops=0)
    assert batch.node_ids == ("p1", "p0")
    assert (batch.nodes_within, batch.edges_within) == ((2,), ())
    whole = whole_graph_batch(GraphArrays.from_scene_graph(corridor(), LABELS), 3, 0, 1.0)
    assert (whole.nodes_within, whole.edges_within) == ((5,), ())


@pytest.mark.parametrize("make", [lambda g: ego(g, ["a"], 2), lambda g: reach_batch(g, LABELS, ["zz"], 1.0)])
def test_a_root_must_be_a_place(make) -> None:
    with pytest.raises(GraphError, match=r"expected a place of the graph \(got '(a|zz)'\)"):
        make(corridor())


def test_a_reach_batch_by_hand() -> None:
    graph = corridor()
    graph.apply(update(edges=[("p3", "a")], sightings=[("p4", "z")]))
    batch = reach_batch(graph, LABELS, ["p2", "p4", "p0"], 1.0)
    check(batch)
    assert batch.node_ids == ("p2", "p4", "p0", "a", "z", "a", "z")
    assert named_edges(batch) == [("a", "p2", 1.0), ("z", "p2", 1.0), ("a", "p0", 0.0), ("z", "p0", 1.0)]
    assert batch.graph.tolist() == [0, 1, 2, 0, 0, 2, 2]
    assert (batch.nodes_within, batch.edges_within) == ((3, 7), (4,))


def test_a_class_index_beyond_the_labelspace_is_refused() -> None:
    arrays = GraphArrays.from_scene_graph(corridor(), LABELS)
    with pytest.raises(LabelspaceError, match=r"expected class indices below 1 \(got 2\)"):
        whole_graph_batch(arrays, 1, 2, 1.0)


EXTRACTIONS = [Extraction("ego", 2, 1.0), Extraction("ego", 1, 1.0), Extraction("reach", 1, 2.0)]


@pytest.mark.parametrize("extraction", EXTRACTIONS)
@pytest.mark.parametrize("places", [[], ["p0"]])
def test_hardly_anything_is_a_batch_too(extraction: Extraction, places: list[str]) -> None:
    graph = SceneGraph.from_update(update([Place(p, (0.0,) * 3) for p in places], full=True))
    batch = extract(graph, Visibility(graph, 1.0), LABELS, places, extraction)
    whole = extract_all(GraphArrays.from_scene_graph(graph, LABELS), len(LABELS), extraction)
    for each in (batch, whole):
        check(each)
        assert each.node_ids == tuple(places)
        assert each.features.shape == (len(places), 3)
        assert each.nodes_within == (len(places),) * (extraction.hops + 1)
        check(repeat(each, 3)[0])
        check(union([each, each])[0])


def in_hops(whole: Batch, root: int, hops: int) -> set[str]:
    """Reference: breadth first over the whole-graph batch's edges."""
    targets = defaultdict(set)
    for source, target in whole.edge_index.T.tolist():
        targets[target].add(source)
    reached = {root}
    for _ in range(hops):
        reached |= {source for target in reached for source in targets[target]}
    return {whole.node_ids[i] for i in reached}


@given(valid_updates(full=True), st.integers(1, 3), st.sampled_from([0.0, 1.0, 2.5]))
@settings(max_examples=50)
def test_ego_graphs_agree_with_the_whole_graph(message: SceneGraphUpdate, hops: int, radius_m: float) -> None:
    graph = SceneGraph.from_update(message)
    whole = whole_graph_batch(GraphArrays.from_scene_graph(graph, LABELS), len(LABELS), hops, radius_m)
    check(whole)
    features = dict(zip(whole.node_ids, whole.features.tolist(), strict=True))
    for row, place in enumerate(sorted(graph.places)):
        batch = ego(graph, [place], hops, radius_m)
        check(batch)
        assert whole.node_ids[row] == place
        for h in range(hops + 1):
            near = in_hops(whole, row, h)
            assert len(batch.node_ids[: batch.nodes_within[h]]) == len(near)
            assert set(batch.node_ids[: batch.nodes_within[h]]) == near
        inner = in_hops(whole, row, hops - 1)
        assert set(named_edges(batch)) == {edge for edge in named_edges(whole) if edge[1] in inner}
        assert {n: f for n, f in features.items() if n in batch.node_ids} == dict(
            zip(batch.node_ids, batch.features.tolist(), strict=True)
        )


def assert_equal(a: Batch, b: Batch) -> None:
    for name in ("features", "edge_index", "edge_length", "is_object", "graph"):
        assert torch.equal(getattr(a, name), getattr(b, name)), name
    for name in ("n_roots", "nodes_within", "edges_within", "node_ids"):
        assert getattr(a, name) == getattr(b, name), name


@given(valid_updates(full=True), st.sampled_from([0.0, 1.0, 2.5]), st.randoms(use_true_random=False))
@settings(max_examples=50)
def test_all_stars_at_once_are_the_stars_one_by_one(
    message: SceneGraphUpdate, radius_m: float, order: random.Random
) -> None:
    graph = SceneGraph.from_update(message)
    arrays = GraphArrays.from_scene_graph(graph, LABELS)
    whole = reach_all_batch(arrays, len(LABELS), radius_m)
    check(whole)
    assert_equal(whole, reach_batch(graph, LABELS, arrays.place_ids, radius_m))
    some = order.choices(range(arrays.n_places), k=3)
    chosen = reach_all_batch(arrays, len(LABELS), radius_m, np.array(some))
    assert_equal(chosen, reach_batch(graph, LABELS, [arrays.place_ids[i] for i in some], radius_m))


@given(valid_updates(full=True), st.randoms(use_true_random=False))
@settings(max_examples=50)
def test_the_order_of_a_message_does_not_matter(message: SceneGraphUpdate, order: random.Random) -> None:
    def shuffled(items: list) -> list:
        return order.sample(items, len(items))

    other = msgspec.structs.replace(
        message,
        places=shuffled(message.places),
        objects=shuffled(message.objects),
        edges=[(b, a) for a, b in shuffled(message.edges)],
        sightings=shuffled(message.sightings),
    )
    graphs = [SceneGraph.from_update(m) for m in (message, other)]
    roots = sorted(graphs[0].places)
    for extraction in EXTRACTIONS:
        a, b = (extract(g, Visibility(g, 1.0), LABELS, roots, extraction) for g in graphs)
        assert_equal(a, b)
        a, b = (extract_all(GraphArrays.from_scene_graph(g, LABELS), 3, extraction) for g in graphs)
        assert_equal(a, b)


def part(batch: Batch, rows: torch.Tensor) -> tuple:
    """What of a union lies on these rows: edges as (source, target, length) in the rows' own numbering."""
    number = {row: i for i, row in enumerate(rows.tolist())}
    edges = [
        (number[s], number[t], length)
        for (s, t), length in zip(batch.edge_index.T.tolist(), batch.edge_length.tolist(), strict=True)
        if s in number
    ]
    ids = [batch.node_ids[row] for row in rows.tolist()]
    return sorted(edges), ids, batch.features[rows].tolist(), batch.is_object[rows].tolist()


def all_rows(batch: Batch) -> torch.Tensor:
    return torch.arange(batch.n_nodes)


BATCHES = {
    "ego": lambda: ego(corridor(), ["p1", "p4"], 3),
    "star": lambda: reach_batch(corridor(), LABELS, ["p0", "p3"], 2.0),
    "whole": lambda: whole_graph_batch(GraphArrays.from_scene_graph(corridor(), LABELS), 3, 2, 1.0),
}


@pytest.mark.parametrize("kind", BATCHES)
def test_copies_are_whole_apart_and_sorted(kind: str) -> None:
    batch = BATCHES[kind]()
    copies, rows = repeat(batch, 4)
    check(copies)
    assert rows.shape == (4, batch.n_nodes)
    assert sorted(rows.flatten().tolist()) == list(range(4 * batch.n_nodes))
    assert rows[:, : batch.n_roots].flatten().tolist() == list(range(4 * batch.n_roots)), "root b of copy c: c·B + b"
    for row in rows:
        assert part(copies, row) == part(batch, all_rows(batch))
    graphs = [set(copies.graph[row].tolist()) for row in rows]
    assert sum(map(len, graphs)) == len(set.union(*graphs)), "no two copies share a graph"
    assert_equal(repeat(batch, 1)[0], batch)


def test_features_of_copies_carry_gradients() -> None:
    batch = BATCHES["ego"]()
    features = batch.features.clone().requires_grad_()
    copies, rows = repeat(batch.with_features(features), 3)
    copies.features[rows[1]].sum().backward()
    assert torch.equal(features.grad, torch.ones_like(features))


@pytest.mark.parametrize("kind", BATCHES)
def test_a_union_holds_its_parts(kind: str) -> None:
    batch = BATCHES[kind]()
    other = repeat(batch, 2)[0]
    joined, rows = union([batch, other])
    check(joined)
    assert part(joined, rows[0]) == part(batch, all_rows(batch))
    assert part(joined, rows[1]) == part(other, all_rows(other))
    assert joined.n_roots == 3 * batch.n_roots
    assert rows[0][: batch.n_roots].tolist() == list(range(batch.n_roots))
    assert_equal(joined, repeat(batch, 3)[0])


def test_the_union_of_one_by_one_is_extraction_at_once() -> None:
    graph = corridor()
    singles = [ego(graph, [p], 2) for p in ("p1", "p4", "p0")]
    assert_equal(union(singles)[0], ego(graph, ["p1", "p4", "p0"], 2))


def test_unions_that_make_no_sense_are_refused() -> None:
    with pytest.raises(GraphError, match="same hops and classes"):
        union([BATCHES["ego"](), BATCHES["star"]()])
    with pytest.raises(GraphError, match="same hops and classes"):
        union([])
    with pytest.raises(GraphError, match=r"at least one copy of a batch \(got 0\)"):
        repeat(BATCHES["ego"](), 0)


@pytest.mark.data
@pytest.mark.parametrize("file", ["goseek/office.json", "hydra/apartment_long.json"])
def test_a_real_building_fed_bit_by_bit_equals_the_whole(data_root: Path, file: str) -> None:
    """What is kept up to date update by update gives the batches of the building frozen at once."""
    hydra = read_hydra(data_root / file)
    space = Labelspace("all", tuple(sorted({o.class_ for o in hydra.graph.objects.values()})))
    message = hydra.graph.to_update(0, 0, "map")
    graph = SceneGraph()
    visibility = Visibility(graph, 4.0)
    known: set[str] = set()
    for start in range(0, len(message.places), 150):
        places = message.places[start : start + 150]
        known |= {p.id for p in places}
        edges = [e for e in message.edges if known.issuperset(n for n in e if n in hydra.graph.places)]
        ends = {n for e in edges for n in e}
        objects = [o for o in message.objects if o.id in ends]
        visibility.update(graph.apply(update(places, objects, edges)))
        reach_batch(graph, space, [places[0].id], 30.0)
    arrays = GraphArrays.from_scene_graph(hydra.graph, space)
    pairs, distances = visible_pairs(arrays, 4.0)
    kept = {(p, o): d for p in graph.places for o, d in visibility.objects_of(p).items()}
    named = [(arrays.place_ids[p], arrays.object_ids[o]) for p, o in pairs.T.tolist()]
    assert kept == dict(zip(named, distances.tolist(), strict=True))
    rows = list(range(0, arrays.n_places, 100))
    roots = [arrays.place_ids[i] for i in rows]
    stars = reach_all_batch(arrays, len(space), 30.0, np.array(rows))
    assert_equal(reach_batch(graph, space, roots, 30.0), stars)
    whole = whole_graph_batch(arrays, len(space), 2, 4.0)
    for row, root in zip(rows[:4], roots[:4], strict=True):
        batch = ego_batch(graph, visibility, space, [root], 2)
        check(batch)
        assert set(batch.node_ids) == in_hops(whole, row, 2)
