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

import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from typing import TypeVar

import rclpy
from rclpy.exceptions import (
    InvalidHandle,
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterException,
)
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from semloc_core.errors import SemlocError

N = TypeVar("N", bound=Node)
SIGNALS = (signal.SIGINT, signal.SIGTERM)
THREADS = 6
"""Updates, questions, diagnostics, parameters and transitions each may wait for something; one to spare."""
GRACE_S = 1.0
"""So long may what was begun before a signal take to end in order; `ros2 launch` sends SIGTERM after 5 s."""
SPIN_S = 0.2
"""How often the executor looks whether it is to end: `Executor.shutdown` frees what a spinning thread still uses."""


class RosLog(logging.Handler):
    """What the core says goes where the node's own lines go: to the console, the log file and /rosout."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        self._logger = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        """Say a line; each severity has a line of its own here, as rclpy wants it."""
        try:
            line = self.format(record)
            if record.levelno >= logging.ERROR:
                self._logger.error(line)
            elif record.levelno >= logging.WARNING:
                self._logger.warning(line)
            elif record.levelno >= logging.INFO:
                self._logger.info(line)
            else:
                self._logger.debug(line)
        except Exception:  # as logging has it: a line that can't be said ends nothing
            self.handleError(record)


def of_callback(error: BaseException) -> bool:
    """Whether an error came out of a callback, rather than of the executor itself."""
    return any(frame.f_code.co_name == "handler" for frame, _ in traceback.walk_tb(error.__traceback__))


def run(
    make: Callable[[], N],
    start: Callable[[N], None] | None = None,
    stop: Callable[[N], None] | None = None,
    free: Callable[[N], None] | None = None,
) -> int:
    """Run a node until SIGINT or SIGTERM.

    Args:
        make: makes the node.
        start: called once it exists, before it spins.
        stop: called when no more callbacks begin: those that still run are to find an end.
        free: called when none runs any more, before the node is destroyed, while it can still publish.

    Returns:
        The exit status: 0 after a signal, 1 after a failure while it ran, 2 where its parameters are not allowed.

    """
    # Our own handlers: rclpy's end the context at once, while threads still publish.
    ended = threading.Event()

    def end(*_: object) -> None:
        # Ctrl-C under `ros2 launch` comes twice, from the terminal and from launch: once is enough.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        ended.set()

    for number in SIGNALS:
        signal.signal(number, end)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = make()
    except (ParameterException, InvalidParameterTypeException, InvalidParameterValueException, SemlocError) as error:
        sys.stderr.write(f"{error}\n")
        rclpy.try_shutdown()
        return 2
    for package in ("semloc_core", "semloc_ros"):
        logging.getLogger(package).addHandler(RosLog(node))
    executor = MultiThreadedExecutor(THREADS)
    executor.add_node(node)
    failed: list[BaseException] = []

    def spin() -> None:
        try:
            while not ended.is_set():
                try:
                    executor.spin_once(timeout_sec=SPIN_S)
                except InvalidHandle as error:
                    # Something was destroyed, in order, while its callback ran: that ends the callback, not the node.
                    node.get_logger().debug(f"a callback outlived what it belongs to: {error}")
                except SemlocError:
                    raise
                except Exception as error:
                    if not of_callback(error):
                        raise
                    # Such as rclpy's own, of a /clock before 1970: it costs the message, not the node.
                    line = f"a callback failed: {type(error).__name__}: {error}"
                    node.get_logger().error(line, throttle_duration_sec=1.0)
        except BaseException as error:
            failed.append(error)
        finally:
            ended.set()

    try:
        if start is not None:
            start(node)
        spinning = threading.Thread(target=spin, name="executor", daemon=True)
        spinning.start()
        # A signal that another thread is given wakes nobody: Python's handlers run in this one, when it runs.
        while not ended.wait(SPIN_S):
            pass
        # Whatever a callback is busy with, such as reading a map: the end does not wait for it any longer than this.
        patience = threading.Timer(GRACE_S, lambda: os._exit(1 if failed else 0))
        patience.daemon = True
        patience.start()
        executor.wake()
        spinning.join()
        for error in failed:
            node.get_logger().fatal(f"the node failed: {type(error).__name__}: {error}")
    finally:
        if stop is not None:
            stop(node)
        # rclpy's own shutdown waits for no callback, and one that outlives the context ends the process.
        executor._executor.shutdown(wait=True, cancel_futures=True)
        if free is not None:
            free(node)
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    patience.cancel()
    return 1 if failed else 0
