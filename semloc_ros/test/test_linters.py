# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The ament linters, as far as they are installed."""

import ast
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from ament_index_python import get_packages_with_prefixes

PACKAGE = Path(__file__).resolve().parents[1]
PROJECT = PACKAGE.parent
SOURCES = [str(PACKAGE / name) for name in ("semloc_ros", "launch", "test", "setup.py")]


def test_flake8():
    main = pytest.importorskip("ament_flake8.main")
    code, errors = main.main_with_errors(argv=["--config", str(PACKAGE / "test" / "flake8.ini"), *SOURCES])
    assert code == 0, "\n".join(errors)


def test_pep257():
    main = pytest.importorskip("ament_pep257.main")
    # Imperative mood and blank lines are ruff's business, whose rules the project follows; D1xx as ament_flake8's.
    ignored = [f"D{n}" for n in range(100, 108)] + [
        "D202",
        "D203",
        "D205",
        "D212",
        "D213",
        "D400",
        "D401",
        "D402",
        "D404",
        "D406",
        "D407",
        "D413",
        "D415",
        "D416",
    ]
    assert main.main(argv=["--ignore", *ignored, "--", *SOURCES]) == 0


def test_copyright():
    main = pytest.importorskip("ament_copyright.main")
    assert main.main(argv=SOURCES) == 0


def test_xmllint():
    main = pytest.importorskip("ament_xmllint.main")
    assert main.main(argv=[str(PROJECT / name / "package.xml") for name in ("semloc_ros", "semloc_msgs")]) == 0


def test_the_manifest_names_every_ros_package_that_is_imported_or_launched():
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    named = {item.text for item in manifest if item.tag in ("depend", "exec_depend")}
    trees = [ast.parse(path.read_text()) for name in ("semloc_ros", "launch") for path in (PACKAGE / name).glob("*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    imported = {node.module.split(".")[0] for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    imported |= {item.name.split(".")[0] for node in nodes if isinstance(node, ast.Import) for item in node.names}
    given = set(get_packages_with_prefixes())
    assert {"rclpy", "std_msgs", "launch_ros"} <= imported & given
    optional = {"hydra_msgs", "bondpy"}  # used where they are installed
    assert (imported & given) - {"semloc_ros"} - optional <= named
    assert {"ros2bag", "rosbag2_storage_mcap", "rviz2"} <= named  # launched, and read by what is launched


def program(name):
    """Where a program is, beside the interpreter or on the path."""
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    return found or pytest.skip(f"{name} is not installed")


def test_hadolint():
    done = subprocess.run(
        [program("hadolint"), str(PROJECT / "Dockerfile")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_shellcheck():
    scripts = [*sorted((PROJECT / "tools").glob("*.sh")), PROJECT / ".ci" / "run"]
    # SC1091: what is sourced is built first, or is ROS's.
    command = [program("shellcheck"), "--exclude=SC1091", *map(str, scripts)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
