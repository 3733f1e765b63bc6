"""A building's graph, whatever it was kept as."""

from __future__ import annotations

from pathlib import Path

from semloc_core.graph import Labelspace, SceneGraph
from semloc_core.sources.hydra import read_hydra
from semloc_core.sources.run import graph_at_end, is_run


def read_graph(path: str | Path, labelspace: Labelspace | None = None) -> SceneGraph:
    """Read a Hydra file, or a recorded run to its end.

    Args:
        path: the file, or a rosbag2 folder.
        labelspace: what class numbers mean in a file without names.

    Raises:
        FileFormatError: no file, or not a scene graph.
        BagError: the run can't be read, or has no update that could be applied.

    """
    return graph_at_end(path) if is_run(path) else read_hydra(path, labelspace).graph
