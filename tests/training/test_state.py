import os
import pickle
from pathlib import Path

import pytest
import torch
from buildings import LABELS, building

from semloc_core.errors import TrainingError
from semloc_core.training.config import TrainConfig
from semloc_core.training.state import Progress, TrainingState, fingerprint, load_state, save_state

STATE = TrainingState(
    progress=Progress(step=3, best_step=2, best_value=0.5, stale=1, history=[{"step": 2.0, "val_loss": 1.0}]),
    encoder={"w": torch.arange(3.0)},
    optimiser={"state": {0: {"step": torch.tensor(1.0)}}, "param_groups": [{"lr": 0.1, "params": [0]}]},
    best={"w": torch.zeros(3)},
)


def test_state_comes_back(tmp_path: Path):
    save_state(tmp_path / "s", STATE, "x")
    again = load_state(tmp_path / "s", "x")
    assert again.progress == STATE.progress
    assert torch.equal(again.encoder["w"], STATE.encoder["w"])
    assert again.optimiser["param_groups"] == STATE.optimiser["param_groups"]
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_a_write_that_fails_leaves_the_old_state(tmp_path: Path, monkeypatch):
    save_state(tmp_path / "s", STATE, "x")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(TrainingError, match="No space left"):
        save_state(tmp_path / "s", STATE, "y")
    assert load_state(tmp_path / "s", "x").progress == STATE.progress
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path):
    with pytest.raises(TrainingError, match="can be written") as error:
        save_state(tmp_path / "no" / "s", STATE, "x")
    assert "\n" not in str(error.value)


class Payload:
    def __reduce__(self):
        return (Path.touch, (Path("executed"),))


@pytest.mark.parametrize(
    "content",
    [b"", b"PK\x03\x04", b"not a state", pickle.dumps(Payload(), 2), pickle.dumps({"format": 1}, 2)],
)
def test_what_is_no_state_is_refused_without_running_it(tmp_path: Path, monkeypatch, content):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s").write_bytes(content)
    with pytest.raises(TrainingError) as error:
        load_state(tmp_path / "s", "x")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "executed").exists()


def test_a_torch_file_with_a_payload_is_refused_without_running_it(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"format": 1, "progress": Payload()}, tmp_path / "s")
    with pytest.raises(TrainingError):
        load_state(tmp_path / "s", "x")
    assert not (tmp_path / "executed").exists()


def test_a_truncated_state_is_refused(tmp_path: Path):
    save_state(tmp_path / "s", STATE, "x")
    content = (tmp_path / "s").read_bytes()
    (tmp_path / "s").write_bytes(content[: len(content) // 2])
    with pytest.raises(TrainingError):
        load_state(tmp_path / "s", "x")


def test_no_file_is_one_line(tmp_path: Path):
    with pytest.raises(TrainingError, match="expected a training state"):
        load_state(tmp_path / "none", "x")


def test_fingerprint_knows_graphs_and_options_but_not_the_time_budget():
    base = fingerprint([building()], LABELS, TrainConfig())
    assert base == fingerprint([building()], LABELS, TrainConfig(max_seconds=5.0))
    assert base != fingerprint([building(1)], LABELS, TrainConfig())
    assert base != fingerprint([building()], LABELS, TrainConfig(seed=1))
