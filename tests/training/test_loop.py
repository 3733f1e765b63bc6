import os
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from buildings import LABELS, building

from semloc_core.errors import ConfigError, SemlocError, TrainingError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.training.config import PerturbConfig, TrainConfig
from semloc_core.training.loop import train
from semloc_core.training.steps import Report

SMALL = TrainConfig(
    encoder_options={"hidden": 8, "heads": 2, "dimension": 8},
    steps=12,
    warmup_steps=2,
    validate_steps=4,
    pool=3,
    refresh_steps=2,
    seed=3,
)


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def replace(config: TrainConfig, **changes) -> TrainConfig:
    return msgspec.structs.replace(config, **changes)


def same_weights(a: torch.nn.Module, b: torch.nn.Module) -> bool:
    one, two = a.state_dict(), b.state_dict()
    return one.keys() == two.keys() and all(torch.equal(one[k], two[k]) for k in one)


class Stop(Exception):
    """Stands for whatever ends a process in mid-training."""


def stop_at(step: int):
    def progress(report: Report) -> None:
        if report.step == step:
            raise Stop

    return progress


@pytest.mark.parametrize("loss", ["infonce", "triplet", "contrastive"])
def test_training_learns(loss):
    config = replace(SMALL, loss=loss, steps=40, validate_steps=10, encoder_options={"hidden": 32})
    result = train([building()], LABELS, config)
    first, best = result.history[0]["val_pr_auc"], max(row["val_pr_auc"] for row in result.history)
    assert result.history[-1]["train_loss"] < result.history[0]["train_loss"]
    assert best >= first
    assert best > 0.5


def test_two_runs_give_the_same_bits_and_another_seed_does_not():
    one, two = (train([building()], LABELS, SMALL) for _ in range(2))
    other = train([building()], LABELS, replace(SMALL, seed=4))
    assert same_weights(one.model.encoder, two.model.encoder)
    assert one.model.temperature == two.model.temperature
    assert one.model.hash == two.model.hash
    assert one.history == two.history
    assert not same_weights(one.model.encoder, other.model.encoder)


def test_global_random_state_is_neither_used_nor_changed():
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002 - the legacy state is what is under test
    before = torch.get_rng_state()
    one = train([building()], LABELS, SMALL)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(2)
    two = train([building()], LABELS, SMALL)
    assert same_weights(one.model.encoder, two.model.encoder)


@pytest.mark.parametrize("stop", [5, 8, 11])
def test_a_resumed_training_equals_one_that_was_never_interrupted(tmp_path: Path, stop: int):
    state = tmp_path / "state.pt"
    config = replace(SMALL, perturb=PerturbConfig(resample_probability=0.5, drop_probability=0.1))
    graphs = [building(), building(1, name="c")]
    with pytest.raises(Stop):
        train(graphs, LABELS, config, progress=stop_at(stop), checkpoint=state)
    resumed = train(graphs, LABELS, config, resume=state, checkpoint=state)
    whole = train(graphs, LABELS, config)
    assert same_weights(resumed.model.encoder, whole.model.encoder)
    assert resumed.history == whole.history
    assert resumed.model.temperature == whole.model.temperature


def test_a_finished_training_resumes_to_itself(tmp_path: Path):
    state = tmp_path / "state.pt"
    done = train([building()], LABELS, SMALL, checkpoint=state)
    again = train([building()], LABELS, SMALL, resume=state)
    assert same_weights(done.model.encoder, again.model.encoder)
    assert again.history == done.history


def test_killed_at_any_moment_the_state_can_be_resumed(tmp_path: Path):
    state = tmp_path / "state.pt"
    script = (
        "import sys; sys.path.insert(0, sys.argv[2]); from pathlib import Path; import torch; import msgspec\n"
        "from buildings import LABELS, building; from semloc_core.training import loop; import test_loop as t\n"
        "torch.set_num_threads(1)\n"
        "loop.train([building()], LABELS, t.replace(t.SMALL, steps=100000, validate_steps=1, patience=100000),"
        " checkpoint=Path(sys.argv[1]), progress=lambda report: print(report.step, flush=True))\n"
    )
    here = str(Path(__file__).parent)
    with subprocess.Popen([sys.executable, "-c", script, str(state), here], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        for _ in range(3):  # it says each step, and keeps its state at each
            assert process.stdout.readline()
        process.send_signal(signal.SIGKILL)
    config = replace(SMALL, steps=100000, validate_steps=1, patience=100000)
    seen: list[int] = []

    def progress(report: Report) -> None:
        seen.append(report.step)
        raise Stop

    with pytest.raises(Stop):
        train([building()], LABELS, config, progress=progress, resume=state)
    assert seen[0] > 1


def test_a_state_of_other_options_or_graphs_is_refused(tmp_path: Path):
    state = tmp_path / "state.pt"
    train([building()], LABELS, SMALL, checkpoint=state)
    for graph, config in [(building(), replace(SMALL, learning_rate=0.02)), (building(9), SMALL)]:
        with pytest.raises(TrainingError, match="same graphs, labelspace and options"):
            train([graph], LABELS, config, resume=state)


def test_a_time_budget_ends_training_with_a_judged_model():
    result = train([building()], LABELS, replace(SMALL, steps=100000, patience=100000, max_seconds=0.2))
    assert result.stopped == "time"
    assert result.history


def test_patience_ends_training_and_the_best_weights_are_kept():
    result = train([building()], LABELS, replace(SMALL, steps=4000, validate_steps=1, patience=5, learning_rate=0.5))
    assert result.stopped == "patience"
    best = max(result.history, key=lambda row: row["val_pr_auc"])
    assert result.best_step == best["step"]
    assert result.model.provenance["val_pr_auc"] == best["val_pr_auc"]
    assert result.history[-1]["step"] == result.best_step + 5


def test_several_buildings_and_all_perturbations():
    hard = PerturbConfig(
        jitter_m=0.3,
        drop_probability=0.2,
        false_ratio=0.2,
        mislabel_probability=0.1,
        resample_probability=1.0,
    )
    graphs = [building(seed, name=f"b{seed}") for seed in range(3)]
    result = train(graphs, LABELS, replace(SMALL, perturb=hard, validate=hard, buildings_per_step=2))
    assert np.isfinite([row["train_loss"] for row in result.history]).all()
    assert len(result.splits) == 3


@pytest.mark.parametrize(
    "options",
    [
        {"layers": 1},
        {"layers": 3},
        {"hidden": 32},
        {"hidden": 128},
        {"heads": 1},
        {"heads": 2},
        {"gat": False},
        {"gat": False, "layers": 3},
    ],
    ids=str,
)
def test_every_row_of_the_papers_ablation_can_be_trained(options):
    result = train([building()], LABELS, replace(SMALL, encoder_options=options, steps=2, validate_steps=2))
    assert np.isfinite(result.history[-1]["train_loss"])
    for name, value in options.items():
        assert getattr(result.model.encoder.config, name) == value


@pytest.mark.parametrize("encoder", ["rings", "bag_of_words", "tfidf", "histogram"])
def test_encoders_without_weights_are_fitted_only(encoder):
    result = train([building()], LABELS, replace(SMALL, encoder=encoder, encoder_options={}))
    assert result.stopped == "nothing to train"
    assert len(result.history) == 1
    assert 0 < result.model.temperature < 1


def test_a_model_comes_back_from_its_bytes():
    model = train([building()], LABELS, SMALL).model
    again = type(model).from_bytes(model.to_bytes())
    assert again.hash == model.hash
    assert again.temperature == model.temperature
    assert same_weights(again.encoder, model.encoder)


def test_unknown_and_missing_classes_are_no_obstacle():
    """Some objects are of a class that the labelspace lacks, and the labelspace has one that no object is of."""
    graph = building()
    classes = graph.object_classes.copy()
    classes[::3] = -1
    graph = GraphArrays(**{**vars(graph), "object_classes": classes})
    wide = Labelspace("w", (*LABELS.classes, "piano"))
    assert train([graph], wide, replace(SMALL, steps=2)).model.labelspace == wide


def unknown_only() -> GraphArrays:
    graph = building()
    return GraphArrays(**{**vars(graph), "object_classes": np.full(graph.n_objects, -1)})


@pytest.mark.parametrize(
    ("graphs", "message"),
    [
        ([], "at least one graph"),
        ([building(n_objects=0)], "at least one object"),
        ([unknown_only()], "at least one object .*got none of 30"),
        ([building(), building(n_places=1, name="hut")], "at least 2 places .*got 1 in hut"),
        ([building(), building(n_places=0, name="void")], "at least 2 places .*got 0 in void"),
    ],
)
def test_nothing_to_learn_from_is_said_in_one_line(graphs, message):
    with pytest.raises(SemlocError, match=message) as error:
        train(graphs, LABELS, SMALL)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("change", [{"encoder": "oracle"}, {"encoder_options": {"layers": 9}}])
def test_an_encoder_that_does_not_exist_is_refused(change):
    with pytest.raises(ConfigError):
        train([building()], LABELS, replace(SMALL, **change))


@pytest.mark.parametrize("n_places", [2, 3, 5])
def test_the_smallest_graphs_train(n_places):
    """A split may then have no validation place: the latest weights are kept."""
    result = train([building(n_places=n_places, n_objects=4)], LABELS, replace(SMALL, steps=4))
    assert all(torch.isfinite(v).all() for v in result.model.encoder.state_dict().values())
    assert result.model.temperature > 0


@pytest.mark.data
@pytest.mark.skipif(not os.environ.get("SEMLOC_SLOW"), reason="takes a minute (set SEMLOC_SLOW)")
def test_the_office_trains_within_a_minute(data_root: Path):
    from semloc_core.sources.hydra import read_hydra

    file = read_hydra(data_root / "goseek" / "office.json")
    assert file.labelspace is not None
    graph = GraphArrays.from_scene_graph(file.graph, file.labelspace, "office")
    result = train([graph], file.labelspace, TrainConfig(max_seconds=60.0))
    assert max(row["val_pr_auc"] for row in result.history) > 0.75
