"""What the localiser publishes with its answer: by any explainer, with its own fidelity, the same each time."""

import numpy as np
import pytest
from small_building import building_update, make_map, make_model

from semloc_core import wire
from semloc_core.config import LocaliserConfig, options
from semloc_core.explain import ObjectScores, class_scores
from semloc_core.explain.explainers.by_name import EXPLAINERS
from semloc_core.explain.fidelity import BUDGET
from semloc_core.explain.layout_scores import LAYOUT
from semloc_core.localiser import Localiser


@pytest.fixture(scope="module", params=["paper", "rings"])
def home(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    return make_map(folder / "home.map", make_model(request.param), home=building_update())


def test_every_explainer_can_be_configured():
    (option,) = [option for option in options(LocaliserConfig) if option.name == "explainer"]
    assert set(option.choices) == {*EXPLAINERS, LAYOUT}
    assert option.default == "attention"


SUMS = ("integrated_gradients", "shapley_sampling", "class_shapley", "closed_form")
"""Explainers whose scores should sum to something, and say by how much they miss it."""


@pytest.mark.parametrize("explainer", sorted(EXPLAINERS))
def test_attributions_carry_their_own_fidelity(home, explainer):
    config = LocaliserConfig(explainer=explainer)
    why = Localiser(home, config).update(building_update(seed=3)).attributions
    again = Localiser(home, config).update(building_update(seed=3)).attributions
    assert wire.encode(why) == wire.encode(again)
    assert why.method == (
        explainer if explainer != "attention" or home.model.encoder.name == "paper" else "closed_form"
    )
    assert why.fidelity.budget == BUDGET
    for figure in (why.fidelity.necessity, why.fidelity.sufficiency, why.fidelity.characterisation):
        assert 0 <= figure <= 1
    if why.method in ("attention", "saliency", *SUMS):
        assert (why.completeness_gap is not None) == (why.method in SUMS)


def test_rounding_errors_are_no_shares():
    """At a place of the map itself the gradient is zero; what floats leave of it must not be ranked."""
    noise = ObjectScores("saliency", ("a", "b"), ("chair", "couch"), np.array([3e-8, 1e-9]))
    assert [row.share for row in class_scores(noise)] == [0.5, 0.5]
    small = ObjectScores("saliency", ("a", "b"), ("chair", "couch"), np.array([3e-4, 1e-4]))
    assert [row.share for row in class_scores(small)] == pytest.approx([0.75, 0.25])
