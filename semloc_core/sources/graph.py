"""A building's graph, whatever it was kept as."""

from __future__ import annotations

from pathlib import Path

from semloc_core.graph import Reading, SceneGraph
from semloc_core.sources.hydra import read_hydra
from semloc_core.sources.run import graph_at_end, is_run


def read_graph(path: str | Path, reading: Reading | None = None) -> SceneGraph:
    """Read a Hydra file, or a recorded run to its end.

    Args:
        path: the file, or a rosbag2 folder.
        reading: what is said of the labels in it.

    Raises:
        FileFormatError: no file, or not a scene graph.
        BagError: the run can't be read, or has no update that could be applied.

    """
    path = Path(path)
    if not is_run(path):
        return read_hydra(path, reading).graph
    graph = graph_at_end(path, reading=reading)
    return graph if reading is None else reading.labels().graph(graph)
