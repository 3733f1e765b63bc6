"""What may import what: the robot runs without ROS's Python in the core, and without the evaluation libraries."""

import subprocess
import sys

import pytest
from small_building import building_update, make_map, make_model

from semloc_core import wire

TOOLS = (
    *("scipy", "sklearn", "matplotlib", "typer", "rich", "rosbags", "mcap", "torch_geometric", "captum", "spark_dsg"),
    *("pymilvus", "grpc", "milvus_lite"),
)

PROGRAM = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {absent!r}:
            raise ImportError(f"{{name}} must not be needed here")

sys.meta_path.insert(0, Absent())
{program}
"""


def run(program: str, *absent: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(absent=absent, program=program)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "module",
    ["semloc_core.localiser", "semloc_core.map_database", "semloc_core.explain.pair", "semloc_core.fleet.open_map"],
)
def test_what_the_node_runs_needs_no_tools(module):
    run(f"import {module}", "rclpy", *TOOLS)


def test_a_map_is_loaded_and_asked_without_the_tools(tmp_path):
    """Imports inside functions count too: from a map file to an explained answer as the node goes."""
    path = tmp_path / "home.map"
    make_map(path, make_model("paper"), home=building_update())
    (tmp_path / "update.json").write_bytes(wire.encode(building_update()))
    run(
        f"""
from semloc_core.fleet.open_map import open_localiser
result = open_localiser({str(path)!r}).update(open({str(tmp_path / "update.json")!r}).read())
assert result.matches.matches and result.attributions.classes
""",
        "rclpy",
        *TOOLS,
    )


def test_every_module_imports_without_ros():
    run(
        """
import importlib, pkgutil
import semloc_core
for module in pkgutil.walk_packages(semloc_core.__path__, "semloc_core."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
""",
        "rclpy",
        "hydra_msgs",
    )


def test_the_wire_and_the_graph_need_no_torch():
    run("import semloc_core.wire, semloc_core.graph.scene_graph, semloc_core.graph.visibility", "torch", "rclpy")
    run("import semloc_core.wire.codec, semloc_core.sources.hydra", "torch", "rclpy")
