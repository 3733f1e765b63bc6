import pytest
import torch
from graph_batches import ego_batch, random_world
from torch import Tensor

from semloc_core.encoding import PaperEncoder, build_encoder
from semloc_core.encoding.encoder.paper.encoder import PaperConfig
from semloc_core.errors import ConfigError, ModelError

CONFIGS = [
    PaperConfig(),
    PaperConfig(layers=1),
    PaperConfig(layers=3, hidden=32, heads=1),
    PaperConfig(heads=2, self_loops=False),
    PaperConfig(gat=False),
    PaperConfig(layers=3, gat=False, hidden=128),
]


def lived_in(config: PaperConfig, n_classes: int = 4) -> PaperEncoder:
    """An encoder whose batch norms have seen data, in eval mode."""
    encoder = PaperEncoder(config, n_classes, torch.Generator().manual_seed(3))
    generator = torch.Generator().manual_seed(4)
    for layer in encoder.layers:
        layer.norm.running_mean.uniform_(-0.5, 0.5, generator=generator)
        layer.norm.running_var.uniform_(0.3, 2.0, generator=generator)
    return encoder.eval()


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_ego_graph_embedding_equals_the_whole_graph_one(config: PaperConfig) -> None:
    encoder = lived_in(config)
    classes, edges, places = random_world(0)
    hops = encoder.extraction.hops
    whole = encoder(ego_batch(classes, edges, places, hops, 4, whole=True))
    torch.testing.assert_close(encoder(ego_batch(classes, edges, places, hops, 4)), whole, atol=1e-5, rtol=0)
    for i in (0, 7, len(places) - 1):  # the last place is isolated
        single = encoder(ego_batch(classes, edges, [places[i]], hops, 4))
        torch.testing.assert_close(single[0], whole[i], atol=1e-5, rtol=0)
    torch.testing.assert_close(whole.norm(dim=1), torch.ones(len(places)))


def test_one_hop_less_would_not_do() -> None:
    """The hop count is what equality needs, no more: cutting the world at one hop less changes embeddings."""
    encoder = lived_in(PaperConfig())
    classes, edges, _ = random_world(0)
    batch = ego_batch(classes, edges, ["p5"], 3, 4)
    near = {name for name, i in zip(batch.node_ids, range(batch.nodes_within[2]), strict=False)}
    cut = [(a, b) for a, b in edges if a in near and b in near]
    assert not torch.allclose(encoder(batch), encoder(ego_batch(classes, cut, ["p5"], 3, 4)), atol=1e-4)


def test_a_batch_of_more_hops_gives_the_same() -> None:
    encoder = lived_in(PaperConfig(layers=1))
    classes, edges, _ = random_world(2)
    torch.testing.assert_close(
        encoder(ego_batch(classes, edges, ["p3"], 2, 4)), encoder(ego_batch(classes, edges, ["p3"], 4, 4))
    )


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_removed_nodes_equal_a_graph_without_them(config: PaperConfig) -> None:
    encoder = lived_in(config)
    classes, edges, _ = random_world(3)
    gone = {"o1", "o4", "o5", "p2"}
    batch = ego_batch(classes, edges, ["p0", "p9"], encoder.extraction.hops, 4)
    keep = torch.tensor([name not in gone for name in batch.node_ids])
    rest = ego_batch(
        {o: c for o, c in classes.items() if o not in gone},
        [(a, b) for a, b in edges if a not in gone and b not in gone],
        ["p0", "p9"],
        encoder.extraction.hops,
        4,
    )
    torch.testing.assert_close(encoder(batch, keep), encoder(rest), atol=1e-5, rtol=0)
    assert not torch.allclose(encoder(batch, keep), encoder(batch), atol=1e-4)


def test_gradient_reaches_every_object_and_is_finite() -> None:
    encoder = lived_in(PaperConfig())
    classes, edges, _ = random_world(0)
    batch = ego_batch(classes, edges, ["p5"], 3, 4)
    features = batch.features.clone().requires_grad_()
    encoder(batch.with_features(features))[0, 0].backward()
    assert features.grad is not None
    assert torch.isfinite(features.grad).all()
    assert (features.grad.abs().sum(1) > 0).all()


def test_training_takes_a_step_and_fills_batch_norm_statistics() -> None:
    encoder = PaperEncoder(PaperConfig(), 4).train()
    classes, edges, places = random_world(0)
    encoder(ego_batch(classes, edges, places, 3, 4, whole=True)).square().sum().backward()
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in encoder.parameters())
    assert all(float(layer.norm.running_mean.abs().sum()) > 0 for layer in encoder.layers)


# Credit, on graphs small enough for paper and pencil. With the attention vector at zero every input of GATv2
# has the same logit, so that attention is uniform and the numbers below follow from counting.


def uniform(config: PaperConfig) -> PaperEncoder:
    encoder = lived_in(config, n_classes=2)
    assert encoder.gat is not None
    torch.nn.init.zeros_(encoder.gat.attention)
    return encoder


def credits(encoder: PaperEncoder, classes: dict[str, int], edges: list[tuple[str, str]]) -> dict[str, float]:
    batch = ego_batch(classes, edges, ["r"], encoder.extraction.hops, 2)
    encoded = encoder.encode(batch)
    assert encoded.credit is not None
    assert encoded.self_share is not None
    torch.testing.assert_close(encoded.embedding, encoder(batch))
    found = {name: c for name, c in zip(batch.node_ids, encoded.credit.tolist(), strict=True) if c > 0}
    return found | {"self": float(encoded.self_share[0])}


def test_credit_of_one_object() -> None:
    """Attention 1/2 on a and 1/2 on r itself; r's half: the sum layer read {a, r}, so half of it to each."""
    found = credits(uniform(PaperConfig(layers=1)), {"a": 0}, [("r", "a")])
    assert found == pytest.approx({"a": 3 / 4, "self": 1 / 4})


def test_credit_without_self_loops_is_all_the_objects() -> None:
    found = credits(uniform(PaperConfig(layers=1, self_loops=False)), {"a": 0}, [("r", "a")])
    assert found == pytest.approx({"a": 1.0, "self": 0.0})


def test_credit_flows_through_a_place_between() -> None:
    """r sees a and is beside p, which sees b; one sum layer.

    Attention: a, p, r 1/3 each. a stops. p read {r, b, p}: 1/9 to b, 2/9 stay on places. r read {a, p, r}: 1/9
    to a, 2/9 stay on places. a: 1/3 + 1/9 = 4/9; b: 1/9; places: 4/9.
    """
    found = credits(uniform(PaperConfig(layers=1)), {"a": 0, "b": 1}, [("r", "a"), ("r", "p"), ("p", "b")])
    assert found == pytest.approx({"a": 4 / 9, "b": 1 / 9, "self": 4 / 9})


def test_credit_through_two_layers() -> None:
    """r – p – q, q sees b, r sees nothing; two sum layers.

    Attention: p 1/2, r 1/2. Layer 2: p read {r, q, p}: 1/6 each; r read {p, r}: 1/4 each. Now p 5/12, r 5/12,
    q 1/6. Layer 1: only q sees b, and q read {p, b, q}: b gets 1/18. Places keep 17/18.
    """
    found = credits(uniform(PaperConfig(layers=2)), {"b": 1}, [("r", "p"), ("p", "q"), ("q", "b")])
    assert found == pytest.approx({"b": 1 / 18, "self": 17 / 18})


def test_credit_is_the_attention_where_it_is_not_uniform() -> None:
    """A star seen by one sum layer: an object's credit is its attention plus its share of the root's own."""
    encoder = lived_in(PaperConfig(layers=1), n_classes=2)
    batch = ego_batch({"a": 0, "b": 1}, [("r", "a"), ("r", "b")], ["r"], 2, 2)
    assert encoder.gat is not None
    seen: list[tuple[Tensor, Tensor]] = []
    encoder.gat.register_forward_hook(lambda *args: seen.append((args[2][1].edges, args[2][1].self_loops)))
    with torch.no_grad():
        encoded = encoder.encode(batch)
    to_edges, to_self = seen[0][0].mean(1), float(seen[0][1].mean())
    assert encoded.credit is not None
    expected = [0.0, 0.0, 0.0]
    for source, weight in zip(batch.edge_index[0, :2].tolist(), to_edges.tolist(), strict=True):
        expected[source] = weight + to_self / 3
    assert encoded.credit.tolist() == pytest.approx(expected)
    assert expected[1] != pytest.approx(expected[2], abs=1e-3)


@pytest.mark.parametrize("self_loops", [True, False])
@pytest.mark.parametrize("edges", [[], [("r", "p"), ("p", "q")]], ids=["isolated", "no object in reach"])
def test_a_place_without_objects_keeps_all_credit_itself(self_loops: bool, edges: list[tuple[str, str]]) -> None:
    assert credits(uniform(PaperConfig(self_loops=self_loops)), {}, edges) == pytest.approx({"self": 1.0})


@pytest.mark.parametrize("config", [c for c in CONFIGS if c.gat], ids=str)
def test_credit_of_each_root_sums_to_one(config: PaperConfig) -> None:
    encoder = lived_in(config)
    classes, edges, places = random_world(0)
    batch = ego_batch(classes, edges, places, encoder.extraction.hops, 4)
    encoded = encoder.encode(batch)
    assert encoded.credit is not None
    assert encoded.self_share is not None
    total = torch.zeros(len(places)).index_add_(0, batch.graph, encoded.credit) + encoded.self_share
    torch.testing.assert_close(total, torch.ones(len(places)))
    assert (encoded.credit >= 0).all()
    assert (encoded.credit[~batch.is_object] == 0).all()
    single = encoder.encode(ego_batch(classes, edges, ["p7"], encoder.extraction.hops, 4))
    torch.testing.assert_close(single.self_share, encoded.self_share[7:8])


def test_no_credit_without_gat_nor_where_roots_share_a_graph() -> None:
    classes, edges, places = random_world(0)
    assert lived_in(PaperConfig(gat=False)).encode(ego_batch(classes, edges, ["p0"], 2, 4)).credit is None
    assert lived_in(PaperConfig()).encode(ego_batch(classes, edges, places, 3, 4, whole=True)).credit is None


@pytest.mark.parametrize(
    "options",
    [
        {"layers": 0},
        {"layers": 4},
        {"heads": 0},
        {"hidden": 2.5},
        {"visibility_radius_m": float("nan")},
        {"head": 3},
    ],
    ids=str,
)
def test_a_bad_configuration_is_one_line(options: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="expected a valid configuration of encoder 'paper'") as caught:
        build_encoder("paper", options, 4)
    assert "\n" not in str(caught.value)


def test_a_struct_made_out_of_range_is_refused_too() -> None:
    with pytest.raises(ConfigError):
        PaperEncoder(PaperConfig(layers=9), 4)


def test_features_of_another_labelspace_are_refused() -> None:
    classes, edges, _ = random_world(0)
    with pytest.raises(ModelError, match=r"expected features of 5 classes \(got 4\)"):
        PaperEncoder(PaperConfig(), 5)(ego_batch(classes, edges, ["p0"], 3, 4))
