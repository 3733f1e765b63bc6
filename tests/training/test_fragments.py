import msgspec
import numpy as np
import pytest
import torch
from buildings import LABELS, building

from semloc_core.encoding.encoder import build_encoder
from semloc_core.errors import ConfigError
from semloc_core.training.config import DEFAULT_ENCODER, NEW_RUN, PerturbConfig, TrainConfig, train_config
from semloc_core.training.loop import train
from semloc_core.training.losses import infonce, mil_nce
from semloc_core.training.views.fragments import draw_fragments, join
from semloc_core.training.views.redecorate import redecorate

ENCODER = build_encoder("geodesic_attention", None, 3)


def test_fragments_hold_less_than_the_whole_and_the_start_only_what_is_in_range() -> None:
    graph = building()
    drawn = draw_fragments(graph, 3, ENCODER.extraction, np.random.default_rng(0), walks=3, stops=5, longest_m=30.0)
    assert drawn is not None
    assert len(drawn.positions) == drawn.batch.n_roots
    assert 3 < drawn.batch.n_roots <= 15
    assert drawn.batch.edge_length.max() > 4.0  # after a walk, farther than one sees at once
    length = torch.zeros(drawn.batch.n_roots).scatter_reduce(
        0, drawn.batch.edge_index[1], drawn.batch.edge_length, "amax"
    )
    assert length[0] <= 4.0
    again = draw_fragments(graph, 3, ENCODER.extraction, np.random.default_rng(0), walks=3, stops=5, longest_m=30.0)
    assert again is not None
    assert torch.equal(drawn.batch.edge_length, again.batch.edge_length)
    joined, positions = join([drawn, again])
    assert joined.n_roots == 2 * drawn.batch.n_roots
    assert len(positions) == 2


def test_nowhere_to_walk_gives_no_fragment_and_message_passing_is_refused() -> None:
    lonely = building(n_places=1)
    rng = np.random.default_rng(0)
    assert draw_fragments(lonely, 3, ENCODER.extraction, rng, walks=1, stops=2, longest_m=5.0) is None
    paper = build_encoder("paper", None, 3).extraction
    with pytest.raises(ConfigError, match=r"expected an encoder that reads stars, .* \(got 'ego'\)"):
        draw_fragments(building(), 3, paper, rng, walks=1, stops=2, longest_m=5.0)


def test_redecoration_keeps_the_floor_plan_and_the_number_of_objects() -> None:
    graph, other = building(), building(seed=5)
    rooms = [redecorate(graph, [graph, other], np.random.default_rng(seed)) for seed in range(12)]
    for room in rooms:
        assert room.place_ids == graph.place_ids
        assert (room.place_edges == graph.place_edges).all()
        assert room.n_objects == graph.n_objects
        assert sorted(room.object_parents[0].tolist()) == list(range(graph.n_objects))
    assert any((room.object_parents[1] != graph.object_parents[1]).any() for room in rooms)
    assert any((room.object_classes != graph.object_classes).any() for room in rooms)


def test_mil_nce_is_content_with_one_positive_where_infonce_wants_all() -> None:
    z_map = torch.eye(3)
    z = torch.tensor([[1.0, 0.0, 0.0]])
    positive = torch.tensor([[True, True, False]])
    one = mil_nce(z, z_map, positive, temperature=0.1)
    assert float(one) == pytest.approx(float(torch.log(1 + torch.exp(torch.tensor(-10.0)))), abs=1e-4)
    assert float(infonce(z, z_map, positive, temperature=0.1)) > 4
    assert float(mil_nce(z, z_map, torch.zeros(1, 3, dtype=torch.bool))) == 0
    only = torch.tensor([[True, False, False]])
    assert float(mil_nce(z, z_map, only, temperature=0.1)) == pytest.approx(
        float(infonce(z, z_map, only, temperature=0.1)), abs=1e-6
    )


CONFIG = TrainConfig(
    encoder="geodesic_attention",
    encoder_options={"dimension": 16},
    loss="mil_nce",
    temperature=0.07,
    learning_rate=1e-3,
    steps=4,
    buildings_per_step=3,
    pool=2,
    refresh_steps=100,
    perturb=PerturbConfig(drop_probability=0.3, resample_probability=1.0),
    perturb_map=PerturbConfig(mobility_scale=0.0),
    redecorated=1,
    fragment_walks=2,
    warm_start_variants=1,
    validate_steps=2,
    validation_pairs=1,
)


def test_training_with_all_of_it_is_the_same_each_time_and_better_than_random() -> None:
    graphs = [building(), building(seed=3)]
    first, second = train(graphs, LABELS, CONFIG), train(graphs, LABELS, CONFIG)
    assert first.model.hash == second.model.hash
    cold = train(graphs, LABELS, msgspec.structs.replace(CONFIG, warm_start_variants=0, steps=1, learning_rate=1e-9))
    assert first.history[-1]["val_pr_auc"] > cold.history[-1]["val_pr_auc"]


def test_an_encoder_has_training_options_of_its_own_which_a_caller_can_change() -> None:
    assert train_config("paper") == TrainConfig()
    assert train_config().encoder == DEFAULT_ENCODER == "geodesic_attention"
    own = train_config("geodesic_attention", steps=7)
    assert (own.encoder, own.steps, own.loss, own.perturb) == ("geodesic_attention", 7, "mil_nce", NEW_RUN)
    with pytest.raises(ConfigError, match="step"):
        train_config("geodesic_attention", stepps=7)
