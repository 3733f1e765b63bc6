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
"""ROS parameters out of configuration structs: default, range and description are written once, beside the field."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from semloc_core.config import LocaliserConfig, Option, checked, options

LARGEST = 1e300
"""Upper end of a range that has none: ROS ranges have two ends."""


class NodeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the node itself; those of the localiser are `LocaliserConfig`'s."""

    map: Annotated[
        str,
        Meta(description="map database, a path or milvus+http://host:port/name; setting it swaps maps at run time"),
    ] = ""
    autostart: Annotated[
        bool, Meta(description="configure and activate by itself, for those who have no lifecycle manager")
    ] = True
    exit_on_failure: Annotated[
        bool,
        Meta(description="where autostart fails, end with status 1 instead of trying again, so that others see it"),
    ] = False
    bond: Annotated[
        bool, Meta(description="make the bond that Nav2's lifecycle manager expects of an active node; needs bondpy")
    ] = False
    stale_after_s: Annotated[
        float,
        Meta(ge=0.1, le=3600.0, description="without an update for so long the input is reported as stale, in s"),
    ] = 5.0
    explain_deadline_s: Annotated[
        float,
        Meta(
            ge=0.01,
            le=60.0,
            description="an explainer that takes longer is not waited for: attention answers, in s",
        ),
    ] = 1.0
    publish_tf: Annotated[
        bool,
        Meta(description="send the transform from frame_id to the frame that updates name, as REP-105 has it"),
    ] = False
    transform_tolerance: Annotated[
        float,
        Meta(ge=0.0, le=60.0, description="how far ahead that transform is stamped, as AMCL does it, in s"),
    ] = 1.0
    initialpose_after: Annotated[
        int,
        Meta(ge=0, le=1000, description="publish initialpose (for AMCL) after so many consistent matches; 0: never"),
    ] = 0


READ_ONLY = frozenset({"autostart", "exit_on_failure", "bond"})
"""Parameters that mean nothing once the node runs."""


def descriptor(option: Option, read_only: bool = False) -> ParameterDescriptor:
    """What `ros2 param describe` shows of an option."""
    found = ParameterDescriptor(name=option.name, description=option.description, read_only=read_only)
    if option.choices:
        found.additional_constraints = "one of " + ", ".join(option.choices)
    low, high = option.minimum, option.maximum
    if low is None and high is None:
        return found
    low, high = -LARGEST if low is None else low, LARGEST if high is None else high
    if option.type is int:
        found.integer_range.append(IntegerRange(from_value=int(low), to_value=int(high), step=0))
    elif option.type is float:
        found.floating_point_range.append(FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0))
    return found


def declare(
    node: Node,
    struct: type[msgspec.Struct],
    read_only: Iterable[str] = (),
    defaults: Mapping[str, Any] | None = None,
) -> None:
    """Declare a parameter for each field of a configuration struct.

    Args:
        node: declares them.
        struct: gives names, types, defaults, ranges, descriptions.
        read_only: names that can't be set while the node runs.
        defaults: other defaults than the struct's.

    """
    given = defaults or {}
    for option in options(struct):
        value = given.get(option.name, option.default)
        # Of an empty list ROS can't tell what it is a list of.
        value = list(value) or [""] if option.type is tuple else value
        node.declare_parameter(option.name, value, descriptor(option, option.name in read_only))


def read(node: Node, struct: type[Any], changed: Mapping[str, Any] | None = None) -> Any:
    """The configuration that a node's parameters make.

    Args:
        node: its parameters are read.
        struct: the configuration's type.
        changed: values that take the place of the node's; names that are not the struct's are left out.

    Raises:
        ConfigError: a value is not allowed; the line names it.

    """
    changed = changed or {}
    names = struct.__struct_fields__
    values = {name: changed[name] if name in changed else node.get_parameter(name).value for name in names}
    lists = {option.name for option in options(struct) if option.type is tuple}
    return checked(struct, **{k: [item for item in v if item] if k in lists else v for k, v in values.items()})


LOCALISER_NAMES = frozenset(LocaliserConfig.__struct_fields__)
NODE_NAMES = frozenset(NodeConfig.__struct_fields__)
