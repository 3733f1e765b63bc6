import itertools
from dataclasses import replace

import pytest
import torch
from graph_batches import ego_batch, random_world
from torch_geometric.nn import GraphConv

from semloc_core.encoding.encoder.layers import Linear, SumLayer, sum_by_target, trim
from semloc_core.errors import ModelError


def test_sum_layer_is_graph_conv_then_tanh_then_batch_norm() -> None:
    layer = SumLayer(5, 7, torch.Generator().manual_seed(0)).eval()
    with torch.no_grad():
        layer.norm.running_mean.uniform_(-1, 1, generator=torch.Generator().manual_seed(1))
        layer.norm.running_var.uniform_(0.5, 2, generator=torch.Generator().manual_seed(2))
    peer = GraphConv(5, 7, aggr="sum")
    with torch.no_grad():
        peer.lin_rel.weight.copy_(layer.message.weight)
        peer.lin_rel.bias.copy_(layer.message.bias)
        peer.lin_root.weight.copy_(layer.root.weight)
    x = torch.randn(6, 5, generator=torch.Generator().manual_seed(3))
    edges = torch.tensor([[1, 2, 3, 4, 0], [0, 0, 1, 5, 5]])
    torch.testing.assert_close(layer(x, *edges, 6), layer.norm(torch.tanh(peer(x, edges))))


def test_trim_without_keep_takes_prefixes() -> None:
    classes, edges, _ = random_world(0)
    batch = ego_batch(classes, edges, ["p0", "p9"], hops=3, n_classes=4)
    trimmed = trim(batch, 2)
    assert trimmed.within == batch.edges_within[:2]
    source, target = trimmed.reaching(0)
    assert source.shape == target.shape == (batch.edges_within[0],)
    assert (target < 2).all()


def test_trim_with_keep_equals_filtering_each_prefix() -> None:
    classes, edges, _ = random_world(1)
    batch = ego_batch(classes, edges, ["p0", "p9", "p4"], hops=3, n_classes=4)
    keep = torch.rand(batch.n_nodes, generator=torch.Generator().manual_seed(0)) < 0.6
    keep[:3] = True
    trimmed = trim(batch, 3, keep)
    for hops in range(3):
        source, target = batch.edge_index[:, : batch.edges_within[hops]]
        stays = keep[source] & keep[target]
        assert torch.equal(torch.stack(trimmed.reaching(hops)), torch.stack([source[stays], target[stays]]))


def test_edges_in_any_order_are_sorted_within_their_hop() -> None:
    """The kernel that sums needs ascending targets; a batch promises only that hops ascend."""
    classes, edges, _ = random_world(1)
    batch = ego_batch(classes, edges, ["p0", "p9"], hops=3, n_classes=4)
    starts = (0, *batch.edges_within)
    generator = torch.Generator().manual_seed(0)
    order = torch.cat([a + torch.randperm(b - a, generator=generator) for a, b in itertools.pairwise(starts)])
    shuffled = replace(batch, edge_index=batch.edge_index[:, order])
    expected, found = trim(batch, 3), trim(shuffled, 3)
    assert (found.target[1:] >= found.target[:-1]).all()
    for hops in range(3):
        pairs = [sorted(zip(*(row.tolist() for row in t.reaching(hops)), strict=True)) for t in (expected, found)]
        assert pairs[0] == pairs[1]
    x = torch.randn(batch.n_nodes, 5, generator=generator)
    sums = x.new_zeros(batch.nodes_within[2], 5).index_add_(0, batch.edge_index[1], x[batch.edge_index[0]])
    torch.testing.assert_close(sum_by_target(x, *found.reaching(2), batch.nodes_within[2]), sums)


def test_targets_without_edges_sum_to_zero() -> None:
    none = torch.zeros(0, dtype=torch.int64)
    assert torch.equal(sum_by_target(torch.ones(2, 3), none, none, 2), torch.zeros(2, 3))
    some = sum_by_target(torch.ones(4, 1), torch.tensor([3, 3]), torch.tensor([1, 1]), 3)
    assert some.flatten().tolist() == [0.0, 2.0, 0.0]


def test_trim_refuses_a_batch_of_too_few_hops() -> None:
    classes, edges, _ = random_world(1)
    with pytest.raises(ModelError, match=r"expected a batch of at least 3 hops \(got 2\)"):
        trim(ego_batch(classes, edges, ["p0"], hops=2, n_classes=4), 3)


def test_initial_weights_come_from_the_generator_alone() -> None:
    state = torch.get_rng_state()
    first, second = Linear(3, 4), Linear(3, 4)
    first.reset_parameters(torch.Generator().manual_seed(7))
    second.reset_parameters(torch.Generator().manual_seed(7))
    assert torch.equal(first.weight, second.weight)
    assert torch.equal(first.bias, second.bias)
    assert torch.equal(torch.get_rng_state(), state)
