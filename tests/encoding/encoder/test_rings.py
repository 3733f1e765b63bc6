import math

import numpy as np
import pytest
import torch
from graph_batches import star_batch

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.encoder.rings import RingsConfig, RingsEncoder
from semloc_core.errors import ConfigError

STARS = [
    [("a", 0, 0.5), ("b", 0, 3.0), ("c", 2, 6.2), ("x", -1, 1.0)],
    [("a", 0, 12.0), ("c", 2, 2.5), ("d", 1, 20.0), ("b", 0, 4.4)],
    [],
]


def by_formula(star: list[tuple[str, int, float]], config: RingsConfig, n_classes: int) -> np.ndarray:
    z = np.zeros((len(config.centres), n_classes))
    for _, class_, d in star:
        if class_ >= 0:
            for r, (centre, width) in enumerate(zip(config.centres, config.widths, strict=True)):
                z[r, class_] += math.exp(-0.5 * ((d - centre) / width) ** 2)
    z = np.sqrt(z).ravel()
    return z / np.linalg.norm(z) if z.any() else z


def test_rows_follow_the_formula_and_an_empty_place_is_exactly_zero() -> None:
    encoder = RingsEncoder(None, 3)
    z = encoder(star_batch(STARS, 3))
    assert z.shape == (3, encoder.dimension) == (3, 18)
    for row, star in zip(z, STARS, strict=True):
        np.testing.assert_allclose(row.numpy(), by_formula(star, encoder.config, 3), atol=1e-6)
    assert torch.equal(z[2], torch.zeros(18))


def test_reach_is_where_the_outermost_ring_has_faded() -> None:
    assert RingsEncoder(None, 3).extraction.radius_m == 28.0
    assert RingsEncoder(None, 3).extraction.kind == "reach"


def test_removing_an_object_equals_a_place_without_it() -> None:
    encoder = RingsEncoder(None, 3)
    batch = star_batch(STARS, 3)
    keep = torch.tensor([name != "b" for name in batch.node_ids])
    rest = star_batch([[entry for entry in star if entry[0] != "b"] for star in STARS], 3)
    torch.testing.assert_close(encoder(batch, keep), encoder(rest))


def test_contributions_sum_to_the_similarity_and_an_object_alone_in_its_class_takes_its_whole_term() -> None:
    encoder = RingsEncoder(None, 3)
    batch = star_batch(STARS, 3)
    z_map = encoder(star_batch([STARS[1], STARS[0], STARS[0]], 3))
    parts = encoder.contributions(batch, z_map)
    sums = torch.zeros(3).index_add_(0, batch.graph, parts)
    torch.testing.assert_close(sums, (encoder(batch) * z_map).sum(1), atol=1e-6, rtol=0)
    by_name = dict(zip(batch.node_ids[3:7], parts[3:7].tolist(), strict=True))
    class_2 = (encoder(batch)[0] * z_map[0]).view(6, 3)[:, 2].sum()
    assert by_name["c"] == pytest.approx(float(class_2), abs=1e-6)
    assert by_name["x"] == 0.0
    assert sums[2] == 0.0


def test_contributions_share_a_dimension_by_weight() -> None:
    """One ring, one class: objects at the centre and one width away share the similarity 1 : exp(-1/2)."""
    encoder = RingsEncoder(RingsConfig(centres=(0.0,), widths=(2.0,)), 1)
    batch = star_batch([[("a", 0, 0.0), ("b", 0, 2.0)]], 1)
    parts = encoder.contributions(batch, torch.ones(1))
    weight = math.exp(-0.5)
    assert parts.tolist() == pytest.approx([0.0, 1 / (1 + weight), weight / (1 + weight)])


def test_gradient_is_finite_everywhere_and_right_where_it_has_a_value() -> None:
    encoder = RingsEncoder(None, 3)
    batch = star_batch(STARS, 3)
    features = batch.features.clone().requires_grad_()
    z_map = encoder(star_batch([STARS[1]] * 3, 3)).detach()
    (encoder(batch.with_features(features)) * z_map).sum().backward()
    assert features.grad is not None
    assert torch.isfinite(features.grad).all()
    a, step = batch.node_ids.index("a"), 1e-2
    up, down = batch.features.clone(), batch.features.clone()
    up[a, 0] += step
    down[a, 0] -= step
    change = ((encoder(batch.with_features(up)) - encoder(batch.with_features(down))) * z_map).sum() / (2 * step)
    assert float(features.grad[a, 0]) == pytest.approx(float(change), abs=1e-3)


def test_gradient_of_zero_features_is_finite() -> None:
    encoder = RingsEncoder(None, 3)
    batch = star_batch(STARS, 3)
    features = torch.zeros_like(batch.features).requires_grad_()
    encoder(batch.with_features(features)).sum().backward()
    assert features.grad is not None
    assert torch.isfinite(features.grad).all()


@pytest.mark.parametrize(
    "options", [{"centres": [0, 1]}, {"widths": [0.0] * 6}, {"centres": [], "widths": []}], ids=str
)
def test_bad_rings_are_refused(options: dict[str, list[float]]) -> None:
    with pytest.raises(ConfigError, match=r"^expected .*got"):
        build_encoder("rings", options, 3)
