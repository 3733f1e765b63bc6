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
"""The ament_python package of semloc's ROS 2 node."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "semloc_ros"


def files(folder: str) -> list[str]:
    """Give the files of a folder, to be installed."""
    return sorted(str(path) for path in Path(folder).iterdir() if path.is_file())


setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(include=[NAME]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "LICENSE", "README.md", "CHANGELOG.rst", "QUALITY_DECLARATION.md"]),
        (f"share/{NAME}/launch", files("launch")),
        (f"share/{NAME}/config", files("config")),
        (f"share/{NAME}/rviz", files("rviz")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    author="The semloc maintainers",
    maintainer="The semloc maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-df0a80c2.example",
    description="Tells a robot where it is, and why it thinks so, from the semantics of its 3D scene graph.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            f"localiser = {NAME}.commands:localiser",
            f"scene_graph_player = {NAME}.commands:scene_graph_player",
            f"hydra_bridge = {NAME}.commands:hydra_bridge",
            f"detections_bridge = {NAME}.commands:detections_bridge",
        ]
    },
)
