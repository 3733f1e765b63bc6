import pytest
import torch
from torch_geometric.nn import GATv2Conv

from semloc_core.encoding.encoder.paper.gatv2 import GATv2


def random_edges(n: int, seed: int) -> torch.Tensor:
    """Directed edges without repeats or self-loops; node n-1 receives nothing."""
    adjacency = torch.rand(n, n, generator=torch.Generator().manual_seed(seed)) < 0.25
    adjacency.fill_diagonal_(False)
    adjacency[:, n - 1] = False
    return adjacency.nonzero().T.contiguous()


def same_weights(ours: GATv2, theirs: GATv2Conv) -> None:
    with torch.no_grad():
        for parameter in ours.parameters():  # biases too, which start at zero
            parameter.copy_(torch.randn(parameter.shape, generator=torch.Generator().manual_seed(parameter.numel())))
        theirs.lin_l.weight.copy_(ours.source.weight)
        theirs.lin_l.bias.copy_(ours.source.bias)
        theirs.lin_r.weight.copy_(ours.target.weight)
        theirs.lin_r.bias.copy_(ours.target.bias)
        theirs.att.copy_(ours.attention[None])
        theirs.bias.copy_(ours.bias)


@pytest.mark.parametrize("heads", [1, 2, 3])
@pytest.mark.parametrize("self_loops", [True, False])
def test_outputs_attention_and_gradients_equal_those_of_pyg(heads: int, self_loops: bool) -> None:
    ours = GATv2(16, 8, heads, torch.Generator().manual_seed(0), self_loops)
    theirs = GATv2Conv(16, 8, heads=heads, add_self_loops=self_loops)
    same_weights(ours, theirs)
    n = 20
    edges = random_edges(n, seed=heads)
    x1 = torch.randn(n, 16, generator=torch.Generator().manual_seed(1)).requires_grad_()
    x2 = x1.detach().clone().requires_grad_()
    y1, attention = ours(x1, edges[0], edges[1], n)
    y2, (edges2, alpha2) = theirs(x2, edges, return_attention_weights=True)
    torch.testing.assert_close(y1, y2, atol=1e-5, rtol=1e-5)
    alpha1 = attention.edges if attention.self_loops is None else torch.cat([attention.edges, attention.self_loops])
    assert torch.equal(edges2[:, : edges.shape[1]], edges)  # PyG appends self-loops, node by node
    torch.testing.assert_close(alpha1, alpha2, atol=1e-5, rtol=1e-5)
    weights = torch.randn(y1.shape, generator=torch.Generator().manual_seed(2))
    (y1 * weights).sum().backward()
    (y2 * weights).sum().backward()
    torch.testing.assert_close(x1.grad, x2.grad, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(ours.attention.grad, theirs.att.grad[0], atol=1e-4, rtol=1e-4)


def test_trimmed_targets_equal_the_rows_of_the_whole() -> None:
    layer = GATv2(16, 8, 3, torch.Generator().manual_seed(0))
    edges = random_edges(20, seed=5)
    edges = edges[:, edges[1].argsort(stable=True)]
    x = torch.randn(20, 16, generator=torch.Generator().manual_seed(1))
    count = int((edges[1] < 4).sum())
    y, attention = layer(x, *edges[:, :count], 4)
    whole, whole_attention = layer(x, *edges, 20)
    torch.testing.assert_close(y, whole[:4])
    torch.testing.assert_close(attention.edges, whole_attention.edges[:count])


@pytest.mark.parametrize("self_loops", [True, False])
def test_huge_and_far_apart_logits_stay_finite_in_value_and_gradient(self_loops: bool) -> None:
    layer = GATv2(4, 4, 2, torch.Generator().manual_seed(0), self_loops)
    x = (torch.randn(6, 4, generator=torch.Generator().manual_seed(1)) * 1e6).requires_grad_()
    edges = torch.tensor([[1, 2, 3, 4, 5], [0, 0, 0, 1, 1]])
    y, attention = layer(x, *edges, 6)
    y.sum().backward()
    assert torch.isfinite(y).all()
    assert torch.isfinite(attention.edges).all()
    assert x.grad is not None
    assert torch.isfinite(x.grad).all()


def test_a_target_that_nothing_sends_to_gets_the_bias() -> None:
    layer = GATv2(4, 4, 2, torch.Generator().manual_seed(0), self_loops=False)
    with torch.no_grad():
        layer.bias.fill_(0.25)
    none = torch.zeros(0, dtype=torch.int64)
    y, attention = layer(torch.ones(1, 4), none, none, 1)
    assert torch.equal(y, torch.full((1, 8), 0.25))
    assert attention.self_loops is None
