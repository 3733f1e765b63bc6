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
"""The bond by which Nav2's lifecycle manager sees that an active node lives: needs `bondpy`, which is not required."""

from collections.abc import Callable

from rclpy.node import Node

from semloc_core.errors import ConfigError

TOPIC, PERIOD_S = "bond", 0.1
"""As `nav2_util::LifecycleNode` has it."""
PATIENCE_S = 60.0
"""How long the manager may be silent: a map that is being loaded keeps its heartbeats waiting."""


def bonded(node: Node) -> Callable[[], None]:
    """Make the bond of a node that becomes active.

    Returns:
        What ends it.

    Raises:
        ConfigError: `bondpy` is not installed.

    """
    try:
        from bondpy.bondpy import Bond
    except ImportError as error:
        raise ConfigError(f"expected bondpy to be installed, since parameter 'bond' is true (got: {error})") from error
    bond = Bond(node, TOPIC, node.get_name())
    bond.heartbeat_period, bond.heartbeat_timeout = PERIOD_S, PATIENCE_S
    bond.start()
    shutdown: Callable[[], None] = bond.shutdown
    return shutdown
