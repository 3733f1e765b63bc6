from dataclasses import replace

import pytest
import torch
from graph_batches import star_batch

from semloc_core.encoding.encoder import discriminant
from semloc_core.encoding.encoder.discriminant import Discriminant, Pairs
from semloc_core.encoding.encoder.geodesic_attention import GeodesicAttentionConfig, GeodesicAttentionEncoder
from semloc_core.encoding.place_graph import Batch, repeat, take_stars, union
from semloc_core.errors import ConfigError, ModelError

STARS = [
    [("a", 0, 0.5), ("b", 0, 3.0), ("c", 2, 6.2), ("x", -1, 1.0)],
    [("d", 1, 12.0), ("e", 2, 2.5), ("f", 1, 20.0), ("g", 0, 4.4), ("h", 0, 4.9)],
    [],
]
CONFIG = GeodesicAttentionConfig(dimension=6)


def batch_of(stars: list[list[tuple[str, int, float]]] = STARS, seed: int = 0) -> Batch:
    space = 50 * torch.rand(len(stars), len(CONFIG.centres), generator=torch.Generator().manual_seed(seed))
    return replace(star_batch(stars, 3), free_space=space)


def encoder_of(**options: float) -> GeodesicAttentionEncoder:
    made = GeodesicAttentionEncoder(
        GeodesicAttentionConfig(dimension=6, **options), 3, torch.Generator().manual_seed(3)
    )
    with torch.no_grad():  # scores that differ, as after training
        made.score.copy_(torch.randn(made.score.shape, generator=torch.Generator().manual_seed(4)))
    return made.eval()


def test_the_formula_written_out_for_one_star() -> None:
    encoder, batch = encoder_of(), batch_of(STARS[:1])
    a, s = encoder.score.detach(), CONFIG.sink
    found = torch.zeros(len(CONFIG.centres), 3)
    for _, class_, d in STARS[0][:3]:
        for r, (centre, width) in enumerate(zip(CONFIG.centres, CONFIG.widths, strict=True)):
            found[r, class_] += torch.exp(torch.tensor(-0.5 * ((d - centre) / width) ** 2))
    x = (a.exp() * ((found + s).sqrt() - s**0.5)).flatten()
    x = x / (1 + x @ x).sqrt()
    assert batch.free_space is not None
    z = encoder.value(torch.cat([x, CONFIG.space_weight * batch.free_space[0].sqrt()]))
    torch.testing.assert_close(encoder(batch)[0], z / z.norm(), atol=1e-5, rtol=1e-5)


def test_a_place_embeds_alike_alone_in_a_union_and_among_copies() -> None:
    encoder, batch = encoder_of(), batch_of()
    whole = encoder(batch)
    torch.testing.assert_close(encoder(union([batch, batch])[0]), torch.cat([whole, whole]))
    torch.testing.assert_close(encoder(repeat(batch, 2)[0]), torch.cat([whole, whole]))
    torch.testing.assert_close(encoder(take_stars(batch, torch.tensor([1, 0]).numpy())), whole[[1, 0]])


def test_counts_by_class_and_counts_that_carry_a_gradient_are_the_same() -> None:
    encoder, batch = encoder_of(), batch_of()
    wanted = batch.with_features(batch.features.clone().requires_grad_())
    torch.testing.assert_close(encoder(wanted), encoder(batch))


def test_removal_is_absence_and_a_zero_row_is_no_class() -> None:
    encoder, batch = encoder_of(), batch_of()
    keep = torch.ones(batch.n_nodes, dtype=torch.bool)
    keep[3] = False  # object a
    without = replace(star_batch([STARS[0][1:], *STARS[1:]], 3), free_space=batch.free_space)
    torch.testing.assert_close(encoder(batch, keep=keep), encoder(without))
    features = batch.features.clone()
    features[3] = 0
    torch.testing.assert_close(encoder(batch.with_features(features)), encoder(without))


def test_credit_of_a_place_and_what_went_to_free_space_sum_to_one_and_are_never_negative() -> None:
    encoder, batch = encoder_of(), batch_of()
    encoded = encoder.encode(batch)
    assert encoded.credit is not None
    assert encoded.self_share is not None
    torch.testing.assert_close(encoded.embedding, encoder(batch))
    total = encoded.self_share.index_add(0, batch.graph, encoded.credit)
    torch.testing.assert_close(total, torch.ones(3))
    assert (encoded.credit >= 0).all()
    assert encoded.credit[: batch.n_roots].abs().max() == 0
    assert float(encoded.self_share[2]) == pytest.approx(1.0)  # no object: all is free space
    assert float(encoded.credit[batch.node_ids.index("x")]) == 0  # no class: no attention


def test_contributions_sum_to_the_similarity() -> None:
    encoder, batch = encoder_of(), batch_of()
    target = torch.nn.functional.normalize(torch.randn(3, 6, generator=torch.Generator().manual_seed(1)), dim=1)
    with torch.no_grad():
        parts = encoder.contributions(batch, target)
        sums = torch.zeros(3).index_add(0, batch.graph, parts)
        torch.testing.assert_close(sums, (encoder(batch) * target).sum(1), atol=1e-5, rtol=1e-5)


def test_gradients_are_right_and_finite_at_zero_features() -> None:
    encoder, batch = encoder_of(), batch_of(STARS[:2])

    def similarity(features: torch.Tensor) -> torch.Tensor:
        return encoder(batch.with_features(features))[:, 0].sum()

    features = torch.zeros_like(batch.features).requires_grad_()
    similarity(features).backward()
    assert features.grad is not None
    assert torch.isfinite(features.grad).all()
    at = batch.features.clone().requires_grad_()
    similarity(at).backward()
    assert at.grad is not None
    step = 1e-2
    up, down = batch.features.clone(), batch.features.clone()
    up[2, 0] += step
    down[2, 0] -= step
    change = ((similarity(up) - similarity(down)) / (2 * step)).detach()
    assert float(at.grad[2, 0]) == pytest.approx(float(change), abs=2e-3)


def test_without_free_space_it_wants_none_and_with_it_it_says_so() -> None:
    blind = encoder_of(space_weight=0.0)
    assert blind.extraction.bands == ()
    assert blind(star_batch(STARS, 3)).shape == (3, 6)
    with pytest.raises(ModelError, match=r"expected free space in 8 bands \(got none\)"):
        encoder_of()(star_batch(STARS, 3))


def test_centres_and_widths_must_pair() -> None:
    with pytest.raises(ConfigError, match=r"expected as many widths as centres \(got 1 and 2\)"):
        GeodesicAttentionConfig(centres=(0.0, 1.0), widths=(1.0,))


def test_the_discriminant_finds_the_direction_that_tells_places_apart(monkeypatch) -> None:
    """Signal along the first axis, noise along the second, both of the same variance over places."""
    monkeypatch.setattr(discriminant, "SHRINKAGE", 1.0)
    generator = torch.Generator().manual_seed(0)
    places = torch.randn(400, 4, generator=generator)
    noise = torch.randn(400, 4, generator=generator) * torch.tensor([0.01, 3.0, 1.0, 1.0])
    found = Discriminant()
    found.add(places + noise, places, torch.arange(400))
    found.add(places + 100, places, torch.full((400,), -1))  # no pair: no noise
    weight, bias = found.directions(2)
    assert weight.shape == (2, 4)
    assert int(weight[0].abs().argmax()) == 0
    assert weight[0].abs()[1] < 0.1 * weight[0].abs()[0]
    torch.testing.assert_close(bias, -(weight @ places.mean(0)), atol=1e-4, rtol=1e-4)


def test_a_warm_start_needs_no_gradient_and_tells_views_of_places_apart() -> None:
    generator = torch.Generator().manual_seed(0)
    stars = [
        [(f"o{i}", int(torch.randint(3, (1,), generator=generator)), 25 * float(torch.rand(1, generator=generator)))]
        * 3
        for i in range(40)
    ]
    moved = [[(name, class_, d + 0.3) for name, class_, d in star] for star in stars]
    places, queries = batch_of(stars), batch_of(moved)
    encoder = GeodesicAttentionEncoder(GeodesicAttentionConfig(dimension=16), 3)
    encoder.warm_start([Pairs(queries, places, torch.arange(40))])
    with torch.no_grad():
        best = (encoder(queries) @ encoder(places).T).argmax(1)
    assert (best == torch.arange(40)).float().mean() > 0.9
