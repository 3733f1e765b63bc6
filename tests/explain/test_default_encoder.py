"""Explainers on the default encoder, as shipped: what they name must matter more than what chance names."""

import numpy as np
import pytest

from semloc_core.encoding.general import general_model
from semloc_core.explain.explainers.by_name import EXPLAINERS
from semloc_core.graph.arrays import GraphArrays
from semloc_core.introspection.whole_map import introspect_map
from semloc_core.sources.world import KINDS, draw_pair
from semloc_core.training.config import PerturbConfig
from semloc_core.training.views.perturb import perturb


@pytest.fixture(scope="module")
def study():
    world, _ = draw_pair(KINDS["home"], np.random.default_rng(50))
    mapped = GraphArrays.from_scene_graph(world.graph, world.labelspace, "home")
    model = general_model([mapped], world.labelspace)
    seen = perturb(mapped, model.labelspace, PerturbConfig(), np.random.default_rng(1))
    places = np.random.default_rng(2).choice(mapped.n_places, 12, replace=False).tolist()
    return introspect_map(model, seen, mapped, places=places, budgets=(0.1, 0.3))


@pytest.mark.parametrize("method", sorted(EXPLAINERS))
def test_an_explainer_is_better_than_chance(study, method) -> None:
    found, chance = study.fidelity[method], study.fidelity["random"]
    assert (found.characterisation > chance.characterisation).all()


def test_attention_tells_objects_apart_and_sums_to_one(study) -> None:
    shares = study.shares["attention"]
    np.testing.assert_allclose(shares.sum(1), 1.0, atol=1e-5)
    assert (shares.max(1) > 1.5 / study.seen.sum(1)).all(), "it is no uniform one"
