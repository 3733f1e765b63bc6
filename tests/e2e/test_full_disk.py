"""A disk that is full, a real one: one line, what was there before is kept, nothing is left beside it."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch

from semloc_core.cli import main
from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.errors import ModelError, TrainingError
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.map_database import load
from semloc_core.sources.bag import read_messages
from semloc_core.sources.world import OfficeConfig, make_office, write_world
from semloc_core.training.state import Progress, TrainingState, load_state, save_state

OFFICE = OfficeConfig(darts_per_m2=8.0, spacing_m=(0.7, 1.0), max_edge_m=2.2)
DISK_BYTES = 1 << 20
FREE_BYTES = (0, 4096, 16384, 40960, 65536, 131072, 262144, DISK_BYTES)
"""What is left free: a write fails at its beginning, in its middle, at its end, and at last not at all."""


class Ran(NamedTuple):
    code: int
    err: str


@pytest.fixture
def semloc(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Ran]:
    """Run a command line in this process."""

    def run(*words: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["semloc", *map(str, words)])
        code = 0
        try:
            main()
        except SystemExit as exit_:
            code = int(exit_.code or 0)
        return Ran(code, capsys.readouterr().err)

    return run


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of one MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if sys.platform != "linux":
        pytest.skip("a small file system is mounted on Linux only")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, f"size={DISK_BYTES}".encode()):
        pytest.skip(f"mounting a small file system is not permitted here ({os.strerror(ctypes.get_errno())})")
    try:
        yield folder
    finally:
        libc.umount2(os.fsencode(folder), 2)  # MNT_DETACH


def fill(disk: Path, free: int) -> None:
    """Leave so many bytes of the disk free."""
    filler = disk / "filler"
    filler.unlink(missing_ok=True)
    left = os.statvfs(disk)
    filler.write_bytes(bytes(max(left.f_bavail * left.f_frsize - free, 0)))


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("house")
    for seed, name in enumerate(("office", "other")):
        world = make_office(OFFICE, np.random.default_rng(seed))
        write_world(folder / f"{name}.json", world)
    rings(world.labelspace).save(folder / "office.model")
    return folder


def rings(space: Labelspace) -> Model:
    return Model(build_encoder("rings", None, len(space)), space)


@pytest.fixture
def made(house: Path, semloc: Callable[..., Ran]) -> Path:
    """The same folder with a model, a map, a run and its replay."""
    if not (house / "results.mcap").exists():
        for words in (
            ("map", "build", house / "office.json", "--model", house / "office.model", "-o", house / "office.map"),
            ("bag", "simulate", house / "office.json", "-o", house / "run.mcap", "--distance", "60"),
            ("replay", house / "run.mcap", "--map", house / "office.map", "-o", house / "results.mcap", "-q"),
        ):
            assert semloc(*words).code == 0
    return house


def refused_until_there_is_room(
    disk: Path, run: Callable[[], Ran], check: Callable[[], None], free_bytes: Sequence[int] = FREE_BYTES
) -> None:
    """Run with more and more room; whenever it is refused, in one line, ``check`` looks at what is left."""
    refused = 0
    for free in free_bytes:
        before = {each.name for each in disk.iterdir()} | {"filler"}
        fill(disk, free)
        code, err = run()
        if code == 0:
            break
        assert code == 2
        assert err.startswith("semloc: ")
        assert err.count("\n") == 1, err
        assert "Traceback" not in err
        assert {each.name for each in disk.iterdir()} == before
        check()
        refused += 1
    assert refused, "there was room for all of it"
    assert code == 0, "there was never room for it"


def test_map_build(made, semloc, disk):
    words = ("map", "build", made / "office.json", "--model", made / "office.model", "-o", disk / "new.map")
    refused_until_there_is_room(disk, lambda: semloc(*words), lambda: None)
    assert load(disk / "new.map").hash == load(made / "office.map").hash


@pytest.mark.parametrize(
    "words",
    [
        ("map", "add", "MAP", "other.json"),
        ("map", "merge", "MAP", "run.mcap"),
        ("map", "replace", "MAP", "other.json", "--name", "office"),
        ("map", "build", "other.json", "--model", "office.model", "--force", "-o", "MAP"),
    ],
    ids=["add", "merge", "replace", "build over it"],
)
def test_map_changes(words, made, semloc, disk):
    path = Path(shutil.copy(made / "office.map", disk / "office.map"))
    before = load(path).hash
    line = [path if word == "MAP" else made / word if "." in word else word for word in words]

    def kept() -> None:
        assert load(path).hash == before

    refused_until_there_is_room(disk, lambda: semloc(*line), kept)
    assert load(path).hash != before


def test_results_of_a_replay_stay_readable(made, semloc, disk):
    """A bag is a log: what was written before the disk was full is in it."""
    whole = [message.data for message in read_messages(made / "results.mcap")]
    out, found = disk / "results.mcap", []
    for free in (65536, 131072, 262144):
        out.unlink(missing_ok=True)
        fill(disk, free)
        code, err = semloc("replay", made / "run.mcap", "--map", made / "office.map", "-o", out, "-q")
        if code == 0:
            break
        assert code == 2
        assert err.splitlines()[-1].startswith("semloc: expected room for a bag at ")
        assert "Traceback" not in err
        if out.exists() and out.stat().st_size:
            messages = [message.data for message in read_messages(out)]
            assert messages == whole[: len(messages)]
            found.append(len(messages))
    assert found, "the disk was never full"
    assert {each.name for each in disk.iterdir()} <= {"filler", "results.mcap"}


@pytest.mark.parametrize(
    "words",
    [
        ("report", "replay", "results.mcap", "--map", "office.map", "-o", "OUT"),
        ("report", "picture", "results.mcap", "--map", "office.map", "-o", "OUT"),
        ("explain", "office.map", "office.json", "--near", "3,3", "--methods", "class_shapley", "--json", "OUT"),
        ("map", "info", "office.map", "--no-aliasing", "--json", "OUT"),
        ("world", "home", "-o", "OUT"),
    ],
    ids=["page", "picture", "explanation", "figures", "graph"],
)
def test_reports_figures_and_graphs(words, made, semloc, disk):
    out = disk / "out"
    out.touch()
    line = [out if word == "OUT" else made / word if "." in word else word for word in words]

    def kept() -> None:
        assert out.read_bytes() == b""

    refused_until_there_is_room(disk, lambda: semloc(*line, "--force"), kept, (0, DISK_BYTES))
    assert out.stat().st_size > 100


def test_a_model_and_the_state_of_a_training(disk):
    space = Labelspace("test", ("chair", "table"))
    rings(space).save(disk / "office.model")
    fill(disk, 0)
    with pytest.raises(ModelError, match="No space"):
        rings(Labelspace("test", ("chair", "plant"))).save(disk / "office.model")
    assert Model.load(disk / "office.model").labelspace.classes == space.classes

    def state(step: int) -> TrainingState:
        weights = {"w": torch.full((30_000,), float(step))}
        return TrainingState(Progress(step=step), weights, {"state": {}, "param_groups": []}, weights)

    path = disk / "office.state"
    fill(disk, DISK_BYTES)
    save_state(path, state(1), "x")
    fill(disk, 65536)
    with pytest.raises(TrainingError, match="No space") as refused:
        save_state(path, state(2), "x")
    assert "\n" not in str(refused.value)
    assert load_state(path, "x").progress.step == 1
    assert {each.name for each in disk.iterdir()} == {"filler", path.name, "office.model"}
