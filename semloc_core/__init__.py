"""semloc: tells a robot where it is, and why it thinks so, from the semantics of a 3D scene graph.

What stands here is the public face (`docs/python.md`); everything else may change without notice. Read
`semloc_core.localiser` first: it is the whole pipeline in one file. Nothing here imports ROS, and nothing is imported
until it is asked for.
"""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.config import LocaliserConfig
    from semloc_core.encoding import Model, general_model, load_model
    from semloc_core.errors import SemlocError
    from semloc_core.explain import explain_pair
    from semloc_core.fleet import open_localiser
    from semloc_core.graph import SceneGraph
    from semloc_core.localiser import Localiser
    from semloc_core.map_database import LoadedMap, MapDatabase
    from semloc_core.map_database import load as load_map
    from semloc_core.map_merge import put_building
    from semloc_core.matching import Localisation, Located
    from semloc_core.sources import read_graph, read_run, write_run
    from semloc_core.wire import Object, Place, SceneGraphUpdate, encode
else:
    __getattr__ = exports(__name__)

__all__ = [
    "Localisation", "LoadedMap", "Localiser", "LocaliserConfig", "Located", "MapDatabase", "Model", "Object", "Place",
    "SceneGraph", "SceneGraphUpdate", "SemlocError", "encode", "explain_pair", "general_model", "load_map",
    "load_model", "open_localiser", "put_building", "read_graph", "read_run", "write_run",
]  # fmt: skip
__version__ = "0.1.0"
