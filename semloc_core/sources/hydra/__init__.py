"""Hydra's scene-graph files, in and out."""

from semloc_core.sources.hydra.file import AgentPose, HydraFile
from semloc_core.sources.hydra.read import from_spark_dsg, read_hydra
from semloc_core.sources.hydra.write import Room, node_id, write_hydra

__all__ = ["AgentPose", "HydraFile", "Room", "from_spark_dsg", "node_id", "read_hydra", "write_hydra"]
