"""A building's graph, whatever it was kept as."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from semloc_core.graph import Reading, SceneGraph, labelspace_from_hydra
from semloc_core.sources.hydra import HydraFile, read_hydra
from semloc_core.sources.runs.kind import is_run
from semloc_core.sources.runs.read import graph_at_end


def read_building(path: str | Path, reading: Reading | None = None) -> HydraFile:
    """Read a Hydra file, or a recorded run to its end: the graph, and what came with it.

    Args:
        path: the file, or a rosbag2 folder.
        reading: what is said of the labels in it.

    Raises:
        FileFormatError: no file, or not a scene graph.
        BagError: the run can't be read, or has no update that could be applied.

    """
    path = Path(path)
    return next(read for is_one, read in READERS if is_one(path))(path, reading)


def read_graph(path: str | Path, reading: Reading | None = None) -> SceneGraph:
    """The graph alone; arguments and errors are those of `read_building`."""
    return read_building(path, reading).graph


def _read_run(path: Path, reading: Reading | None) -> HydraFile:
    graph, told = graph_at_end(path, reading=reading), list[str]()
    if reading is not None:
        labels = reading.labels()
        graph, told = labels.graph(graph), labels.told()
    classes = sorted({thing.class_ for thing in graph.objects.values()})
    return HydraFile(graph, labelspace_from_hydra(path.name, enumerate(classes), ()), decided=tuple(told))


READERS: tuple[tuple[Callable[[Path], bool], Callable[[Path, Reading | None], HydraFile]], ...] = (
    (is_run, _read_run),
    (lambda path: True, read_hydra),
)
"""How each kind of file is told and read: the first that says yes reads it."""
