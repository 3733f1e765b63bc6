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
"""Starting a node, spinning it, and ending it in order: what every executable of the package does."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable
from typing import TypeVar

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException, ParameterException
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from semloc_core.errors import SemlocError

N = TypeVar("N", bound=Node)
THREADS = 6
"""Updates, questions, diagnostics, parameters and transitions each may wait for something; one to spare."""
SPIN_S = 0.2
"""How often the executor looks whether it is to end: `Executor.shutdown` frees what a spinning thread still uses."""


def run(
    make: Callable[[], N],
    start: Callable[[N], None] | None = None,
    free: Callable[[N], None] | None = None,
) -> int:
    """Run a node until SIGINT or SIGTERM.

    Args:
        make: makes the node.
        start: called once it exists, before it spins.
        free: called before it is destroyed, while it can still publish.

    Returns:
        The exit status: 0 after a signal, 1 after a failure while it ran, 2 where its parameters are not allowed.

    """
    # Our own handlers: rclpy's end the context at once, while threads still publish.
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = make()
    except (ParameterException, InvalidParameterTypeException, InvalidParameterValueException, SemlocError) as error:
        sys.stderr.write(f"{error}\n")
        rclpy.try_shutdown()
        return 2
    executor = MultiThreadedExecutor(THREADS)
    executor.add_node(node)
    failed: list[BaseException] = []

    def spin() -> None:
        try:
            while not stop.is_set():
                executor.spin_once(timeout_sec=SPIN_S)
        except BaseException as error:
            failed.append(error)
        finally:
            stop.set()

    try:
        if start is not None:
            start(node)
        spinning = threading.Thread(target=spin, name="executor", daemon=True)
        spinning.start()
        stop.wait()
        spinning.join()
        for error in failed:
            node.get_logger().fatal(f"the node failed: {type(error).__name__}: {error}")
    finally:
        if free is not None:
            free(node)
        executor.shutdown(timeout_sec=5.0)
        node.destroy_node()
        rclpy.try_shutdown()
    return 1 if failed else 0
