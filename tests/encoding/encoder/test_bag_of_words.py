import math

import torch
from graph_batches import ego_batch, star_batch

from semloc_core.encoding.encoder.bag_of_words import BagOfWordsEncoder, HistogramEncoder, TfidfEncoder

CLASSES = {"a": 0, "b": 0, "c": 2, "x": -1}
EDGES = [("r", "a"), ("r", "b"), ("r", "c"), ("r", "x"), ("r", "s"), ("s", "c"), ("s", "t")]


def test_counts_what_the_place_sees_and_nothing_else() -> None:
    z = BagOfWordsEncoder(None, 3)(ego_batch(CLASSES, EDGES, ["r", "s", "t"], 1, 3))
    root5 = math.sqrt(5)
    torch.testing.assert_close(z, torch.tensor([[2 / root5, 0, 1 / root5], [0, 0, 1], [0, 0, 0]]))


def test_more_hops_in_the_batch_change_nothing() -> None:
    encoder = BagOfWordsEncoder(None, 3)
    one, three = (encoder(ego_batch(CLASSES, EDGES, ["r", "s", "t"], hops, 3)) for hops in (1, 3))
    torch.testing.assert_close(one, three)
    whole = encoder(ego_batch(CLASSES, EDGES, ["r", "s", "t"], 2, 3, whole=True))
    torch.testing.assert_close(one, whole)


def test_removed_objects_do_not_count() -> None:
    batch = ego_batch(CLASSES, EDGES, ["r"], 1, 3)
    keep = torch.tensor([name not in ("a", "b") for name in batch.node_ids])
    torch.testing.assert_close(BagOfWordsEncoder(None, 3)(batch, keep), torch.tensor([[0.0, 0.0, 1.0]]))


def test_idf_counts_places_over_all_batches_and_forgets_an_earlier_fit() -> None:
    encoder = TfidfEncoder(None, 3)
    assert torch.equal(encoder.idf, torch.ones(3))
    encoder.fit([ego_batch({"z": 1}, [("q", "z")], ["q"], 1, 3)])
    encoder.fit(ego_batch(CLASSES, EDGES, roots, 1, 3) for roots in (["r", "s"], ["t"]))
    expected = [math.log(4 / (1 + seen)) + 1 for seen in (1, 0, 2)]  # 3 places; class 0 from r; class 2 from r and s
    torch.testing.assert_close(encoder.idf, torch.tensor(expected))
    z = encoder(ego_batch(CLASSES, EDGES, ["r"], 1, 3))[0]
    torch.testing.assert_close(z[0] / z[2], torch.tensor(2 * expected[0] / expected[2]))
    torch.testing.assert_close(z.norm(), torch.tensor(1.0))


def test_histogram_counts_a_radius_hard() -> None:
    encoder = HistogramEncoder(None, 2)
    assert (encoder.extraction.kind, encoder.extraction.radius_m) == ("reach", 13.0)
    z = encoder(star_batch([[("a", 0, 12.9), ("b", 1, 0.1), ("c", 1, 5.0)], []], 2))
    torch.testing.assert_close(z, torch.tensor([[1.0, 2.0], [0.0, 0.0]]) / math.sqrt(5))


def test_contributions_sum_to_the_similarity() -> None:
    encoder = TfidfEncoder(None, 3)
    batch = ego_batch(CLASSES, EDGES, ["r", "s", "t"], 1, 3)
    encoder.fit([batch])
    z_map = torch.tensor([0.6, 0.0, 0.8])
    parts = encoder.contributions(batch, z_map)
    sums = torch.zeros(3).index_add_(0, batch.graph, parts)
    torch.testing.assert_close(sums, encoder(batch) @ z_map)
    assert (parts[~batch.is_object] == 0).all()


def test_gradients_are_finite_where_nothing_is_seen() -> None:
    batch = ego_batch(CLASSES, EDGES, ["r", "t"], 1, 3)
    features = batch.features.clone().requires_grad_()
    BagOfWordsEncoder(None, 3)(batch.with_features(features)).sum().backward()
    assert features.grad is not None
    assert torch.isfinite(features.grad).all()
