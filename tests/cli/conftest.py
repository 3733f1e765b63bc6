"""Runs the command in this process, and small buildings to run it on."""

import itertools
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from semloc_core.cli import main
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.sources.hydra import write_hydra
from semloc_core.wire import Object, Place, SceneGraphUpdate

KEY = {"p": ord("p") << 56, "O": ord("O") << 56}


@dataclass(frozen=True)
class Said:
    """What a command printed, and its exit status."""

    code: int
    out: str
    err: str


@pytest.fixture
def semloc(capsys, monkeypatch) -> Callable[..., Said]:
    """Run the command and keep what it says."""

    def run(*words: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["semloc", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        out, err = capsys.readouterr()
        return Said(int(stop.value.code or 0), out, err)

    return run


@pytest.fixture
def write_corridor() -> Callable[..., Path]:
    """Write a Hydra file: places one a metre along x, at each in turn an object of the next class."""

    def write(path: Path, classes: list[str], ids: dict[str, tuple[int, ...]] | None = None) -> Path:
        places = [Place(id=str(KEY["p"] | i), position=(float(i), 0.0, 0.0)) for i in range(len(classes))]
        objects = [
            Object(id=str(KEY["O"] | i), class_=name, position=(float(i), 1.0, 0.0)) for i, name in enumerate(classes)
        ]
        update = SceneGraphUpdate(
            schema="semloc/scene_graph_update/1",
            stamp_ns=0,
            frame_id="map",
            seq=0,
            full=True,
            places=places,
            objects=objects,
            edges=[(a.id, b.id) for a, b in itertools.pairwise(places)]
            + [(p.id, o.id) for p, o in zip(places, objects, strict=True)],
            query_place=None,
        )
        names = tuple(dict.fromkeys(classes))
        space = Labelspace("corridor", names, ids or {name: (i,) for i, name in enumerate(names)})
        write_hydra(path, SceneGraph.from_update(update), space)
        return path

    return write
