"""Training from another model, and how good a model is on held-out places of its own map."""

import msgspec
import numpy as np
import pytest
from buildings import LABELS, building
from test_fragments import CONFIG

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.errors import TrainingError
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.training.held_out import own_validation
from semloc_core.training.loop import train
from semloc_core.training.split import split_places


@pytest.fixture(scope="module")
def begun() -> Model:
    return train([building(seed=3)], LABELS, CONFIG).model


def test_training_goes_on_from_the_start_and_never_ends_worse(begun) -> None:
    result = train([building()], LABELS, CONFIG, start=begun)
    assert result.history[0]["step"] == 0, "the start itself is judged first"
    assert max(row["val_pr_auc"] for row in result.history) >= result.history[0]["val_pr_auc"]
    assert result.model.provenance["start"] == begun.hash
    still = train([building()], LABELS, msgspec.structs.replace(CONFIG, steps=1, learning_rate=1e-9), start=begun)
    for name, tensor in begun.encoder.state_dict().items():
        np.testing.assert_allclose(still.model.encoder.state_dict()[name], tensor, atol=1e-6)


def test_a_start_that_does_not_fit_is_refused(begun) -> None:
    with pytest.raises(TrainingError, match="labelspace"):
        train([building()], Labelspace("other", tuple(reversed(LABELS.classes))), CONFIG, start=begun)
    with pytest.raises(TrainingError, match="options"):
        train([building()], LABELS, msgspec.structs.replace(CONFIG, encoder_options={"dimension": 8}), start=begun)
    rings = Model(build_encoder("rings", None, len(LABELS)), LABELS)
    options = {"encoder": "rings", "encoder_options": {}, "fragment_walks": 0}
    with pytest.raises(TrainingError, match="weights"):
        train([building()], LABELS, msgspec.structs.replace(CONFIG, **options), start=rings)


def test_own_validation_asks_all_models_the_same_and_tells_a_good_one_from_a_blind_one() -> None:
    graphs = [building(n_places=60), building(seed=3, n_places=60)]
    splits = [split_places(graph, 0) for graph in graphs]
    rings = Model(build_encoder("rings", None, len(LABELS)), LABELS)
    blind = build_encoder("geodesic_attention", {"space_weight": 0.0}, len(LABELS))
    blind.value.weight.data.zero_()
    rows = own_validation({"rings": rings, "blind": Model(blind, LABELS)}, graphs, splits, 0)
    found = {(row["method"], row["scope"]): row for row in rows}
    assert set(found) == {(m, s) for m in ("rings", "blind") for s in ("whole", "fragment")}
    for scope in ("whole", "fragment"):
        good, bad = found["rings", scope], found["blind", scope]
        assert good["queries"] == bad["queries"] > 0
        assert good["success@1"] <= good["success@5"] <= good["success@10"] <= 1
        assert good["success@1"] > bad["success@1"]
    told: list[tuple[int, int, str]] = []
    again = own_validation(
        {"rings": rings, "blind": Model(blind, LABELS)}, graphs, splits, 0, lambda *n: told.append(n)
    )
    assert rows == again
    judged = [said for said in told if said[2].partition(",")[0] in ("rings", "blind")]
    assert told[0][0] == 0, "before the first run is made"
    assert [done for done, _, _ in judged] == sorted(done for done, _, _ in judged)
    assert judged[-1][0] == judged[-1][1] > len(graphs)


def test_own_validation_of_message_passing_has_whole_graphs_only() -> None:
    graph = building()
    paper = Model(build_encoder("paper", None, len(LABELS)), LABELS)
    rows = own_validation({"paper": paper}, [graph], [split_places(graph, 0)], 0)
    assert [row["scope"] for row in rows] == ["whole"]
