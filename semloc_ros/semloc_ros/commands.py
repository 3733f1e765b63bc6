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
"""What `ros2 run` starts: each function leaves quietly on a signal that comes while its imports take their time."""

import logging
import os
import signal
import sys
from typing import NoReturn


def _leave_on_signals() -> None:
    """Until `semloc_ros.running.run` sets handlers of its own: nothing has begun yet that would have to be ended."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))


def _leave(status: int) -> NoReturn:
    """Leave without taking the interpreter apart, which takes longer than the node's own end, which came before."""
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def localiser() -> NoReturn:
    """Run the localiser."""
    _leave_on_signals()
    from semloc_ros.node import main

    _leave(main())


def scene_graph_player() -> NoReturn:
    """Run the player."""
    _leave_on_signals()
    from semloc_ros.player import main

    _leave(main())


def hydra_bridge() -> NoReturn:
    """Run the bridge."""
    _leave_on_signals()
    from semloc_ros.hydra_bridge import main

    _leave(main())


def detections_bridge() -> NoReturn:
    """Run the bridge for detections."""
    _leave_on_signals()
    from semloc_ros.detections_bridge import main

    _leave(main())
