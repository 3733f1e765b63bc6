"""Colours of places: what message passing can't tell apart has one colour, what it can has two; the ceiling by hand."""

import numpy as np
import pytest
import torch
from small_building import SPACE, building_update, make_model

from semloc_core.encoding.model import embed_graph
from semloc_core.encoding.place_graph import extract_all
from semloc_core.evaluate.aliasing import aliasing, colour_refinement, map_aliasing
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph


def building(**options) -> GraphArrays:
    graph = SceneGraph()
    graph.apply(building_update(**options))
    return GraphArrays.from_scene_graph(graph, SPACE, "home")


@pytest.mark.parametrize("name", ["paper", "histogram"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_places_of_one_colour_have_one_embedding_and_others_do_not(name: str, seed: int) -> None:
    """Random weights tell apart whatever can be told apart, so the two agree in both directions."""
    model, arrays = make_model(name, seed=seed), building(length=40, objects=8, seed=seed)
    found = map_aliasing(model.encoder, [arrays], len(SPACE))
    assert found is not None
    z = embed_graph(model, arrays)
    same_colour = found.colours[:, None] == found.colours
    gap = np.linalg.norm(z[:, None] - z[None], axis=2)
    assert 1 < found.colours.max() + 1 < arrays.n_places  # the case has both
    assert gap[same_colour].max() < 1e-5
    if name == "paper":  # counts scaled to unit length may coincide where multisets differ
        assert gap[~same_colour].min() > 1e-5


def test_the_ceiling_by_hand() -> None:
    at = np.array([[0.0, 0, 0], [3, 0, 0], [20, 0, 0], [50, 0, 0], [90, 0, 0]])
    found = aliasing(np.array([7, 7, 7, 3, 5]), [at])
    assert found.colours.tolist() == [0, 0, 0, 1, 2]
    assert found.alone == 2
    assert found.spread_m.tolist() == [20, 17, 20, 0, 0]
    assert found.ceiling == pytest.approx((2 + 1 + 1) / 5)  # of the three alike, one answer serves two
    assert found.by_chance == pytest.approx(((2 + 2 + 1) / 3 + 1 + 1) / 5)
    row = found.row("paper", "all")
    assert (row["colours"], row["far_aliases"], row["spread_p50_m"], row["spread_max_m"]) == (3, 3, 20, 20)


def test_buildings_with_equal_places_alias_each_other() -> None:
    arrays = building()
    model = make_model("paper")
    one = map_aliasing(model.encoder, [arrays], len(SPACE))
    two = map_aliasing(model.encoder, [arrays, arrays], len(SPACE))
    assert one is not None
    assert two is not None
    assert two.ceiling == pytest.approx(one.ceiling / 2)
    assert two.alone == 0
    assert np.isinf(two.spread_m).all()


def test_more_rounds_tell_more_apart() -> None:
    model, arrays = make_model("paper"), building(length=60, objects=6)
    batch = extract_all(arrays, len(SPACE), model.encoder.extraction)
    counts = [len(np.unique(colour_refinement([batch], rounds)[0][: batch.n_roots])) for rounds in range(4)]
    assert counts == sorted(counts)
    assert counts[0] == 1
    assert counts[3] > counts[1] > 1


def test_an_encoder_that_reads_distances_has_no_such_ceiling() -> None:
    assert map_aliasing(make_model("rings").encoder, [building()], len(SPACE)) is None
    assert map_aliasing(make_model("paper").encoder, [], len(SPACE)).ceiling == 0


def test_a_trained_encoder_is_not_above_the_ceiling() -> None:
    model, arrays = make_model("paper", seed=5), building(length=50, objects=5, seed=3)
    found = map_aliasing(model.encoder, [arrays], len(SPACE))
    assert found is not None
    z = torch.from_numpy(embed_graph(model, arrays)).round(decimals=4)
    answer = torch.cdist(z, z).argmin(1).numpy()
    apart = np.linalg.norm(arrays.place_positions[answer] - arrays.place_positions, axis=1)
    assert (apart <= found.NEAR_M).mean() <= found.ceiling + 1e-9
