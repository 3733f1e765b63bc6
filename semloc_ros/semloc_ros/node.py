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
"""`ros2 run semloc_ros localiser`: the localiser as a lifecycle node."""

from __future__ import annotations

import functools
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, TimeoutError
from typing import Any

import torch
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import ConfigError, SemlocError
from semloc_core.fleet import open_localiser
from semloc_core.localiser import Localiser
from semloc_ros import conversions, qos
from semloc_ros.parameters import READ_ONLY, NodeConfig, declare, read
from semloc_ros.publishing import Publishing
from semloc_ros.running import run
from semloc_ros.session import Session

DIAGNOSTICS_PERIOD_S = 1.0
EXPLAIN_TIMEOUT_S = 120.0
LISTED = 100
"""Buildings that are logged at most."""

Transition = Callable[[Any, LifecycleState], None]


def transition(
    step: Transition,
) -> Callable[[LocaliserNode, LifecycleState], TransitionCallbackReturn]:
    """Make a lifecycle callback of a step: rclpy swallows what it raises, so it is logged here, and a failure."""

    @functools.wraps(step)
    def callback(self: LocaliserNode, state: LifecycleState) -> TransitionCallbackReturn:
        name = step.__name__.removeprefix("on_")
        try:
            step(self, state)
        except Exception as error:
            kind = "" if isinstance(error, SemlocError) else f"{type(error).__name__}: "
            self.get_logger().error(f"{name} failed: {kind}{error}")
            if name == "configure":
                self.free()
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    return callback


class LocaliserNode(LifecycleNode):
    """Subscribes to scene-graph updates, publishes matches and attributions; all else is in `Session`."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("localiser", **kwargs)
        declare(self, NodeConfig, READ_ONLY)
        declare(self, LocaliserConfig)
        read(self, NodeConfig), read(self, LocaliserConfig)  # refuses what a range can't say, such as an unknown name
        self._session: Session | None = None
        self._entities: list[Callable[[], object]] = []
        self._map_lock = threading.Lock()
        self._prepared: Localiser | None = None
        # Parameters and transitions use the default group, so that loading a map there holds up nothing else.
        self._update_group, self._question_group, self._timer_group = (
            MutuallyExclusiveCallbackGroup() for _ in range(3)
        )
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)  # a simulated clock may stand still
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)

    def start(self) -> None:
        """Configure and activate, if ``autostart`` says so."""
        if not self.get_parameter("autostart").value:
            return
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    # -- lifecycle --------------------------------------------------------------------------------------------

    @transition
    def on_configure(self, state: LifecycleState) -> None:
        """Load the map, make publishers, threads and subscriptions; updates are applied from now on."""
        config, options = read(self, NodeConfig), read(self, LocaliserConfig)
        localiser = self._open(config.map, options, wait=True)
        self._session = Session(localiser, config, Publishing(self), self._log_rejected)
        self._make_entities()
        super().on_configure(state)
        if localiser.map_info is None:
            self.get_logger().warning(f"no map yet: {_told(localiser)}")
        else:
            self.get_logger().info(f"{_told(localiser)}, {localiser.buildings[:LISTED]}")

    @transition
    def on_activate(self, state: LifecycleState) -> None:
        """Answer from now on."""
        assert self._session is not None
        super().on_activate(state)
        self._session.draw_map(self.get_clock().now().to_msg())
        self._session.worker.answering = True

    @transition
    def on_deactivate(self, state: LifecycleState) -> None:
        """Answer no more; updates are still applied."""
        assert self._session is not None
        self._session.worker.answering = False
        super().on_deactivate(state)

    @transition
    def on_cleanup(self, state: LifecycleState) -> None:
        """Free all that configure made."""
        self.free()

    @transition
    def on_shutdown(self, state: LifecycleState) -> None:
        """Free all."""
        self.free()

    @transition
    def on_error(self, state: LifecycleState) -> None:
        """Free all, so that the node can be configured again."""
        self.free()

    def stop(self) -> None:
        """End what callbacks may be waiting for; the node can only be freed after this."""
        if self._session is not None:
            self._session.stop()

    def free(self) -> None:
        """Free all that configure made; does nothing where nothing is configured."""
        self.stop()
        session, self._session = self._session, None
        for destroy in self._entities:
            destroy()
        self._entities.clear()
        if session is not None:
            session.close()

    def _make_entities(self) -> None:
        def keep(make: Callable[..., Any], destroy: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
            entity = make(*args, **kwargs)
            self._entities.append(functools.partial(destroy, entity))
            return entity

        subscribe = functools.partial(keep, self.create_subscription, self.destroy_subscription, String)
        serve = functools.partial(keep, self.create_service, self.destroy_service, Trigger)
        subscribe("scene_graph", self._on_update, qos.UPDATES, callback_group=self._update_group)
        subscribe("~/explain_request", self._on_request, qos.ANSWERS, callback_group=self._question_group)
        serve("~/explain", self._on_explain, callback_group=self._question_group)
        serve("~/reset", self._on_reset, callback_group=self._question_group)
        serve("~/reload_map", self._on_reload, callback_group=self._question_group)
        # Not managed by the lifecycle: that a node is inactive is worth knowing too.
        self._diagnostics = keep(
            self.create_publisher, self.destroy_publisher, DiagnosticArray, "/diagnostics", qos.LATEST
        )
        keep(
            self.create_timer,
            self.destroy_timer,
            DIAGNOSTICS_PERIOD_S,
            self._on_timer,
            callback_group=self._timer_group,
            clock=self._steady,
        )

    # -- topics ------------------------------------------------------------------------------------------------

    def _on_update(self, message: String) -> None:
        session = self._session
        if session is not None:
            session.worker.put(message.data)

    def _on_request(self, message: String) -> None:
        session = self._session
        if session is None or not session.worker.answering:
            return
        try:
            request = wire.decode(message.data, wire.ExplainRequest)
            future = session.ask(request)
        except SemlocError as error:
            self.get_logger().warning(f"explain request refused: {error}", throttle_duration_sec=1.0)
            return
        future.add_done_callback(functools.partial(self._publish_explanation, session))

    def _publish_explanation(self, session: Session, future: Future[str]) -> None:
        error = future.exception()
        if error is not None:
            self.get_logger().warning(f"explain request not answered: {error}", throttle_duration_sec=1.0)
        else:
            session.publish_explanation(future.result())

    def _log_rejected(self, line: str) -> None:
        self.get_logger().warning(f"update rejected: {line}", throttle_duration_sec=1.0)

    def _on_timer(self) -> None:
        session = self._session
        if session is None:
            return
        state = "active" if session.worker.answering else "inactive"
        try:
            lines, stamp = session.lines(state), self.get_clock().now().to_msg()
            session.draw_changes(stamp)
        except Exception as error:  # what watches the localiser must not end it
            self.get_logger().error(f"diagnostics failed: {type(error).__name__}: {error}", throttle_duration_sec=60.0)
            return
        self._diagnostics.publish(conversions.diagnostics_msg(lines, self.get_fully_qualified_name(), stamp))

    # -- services ----------------------------------------------------------------------------------------------

    def _on_explain(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        session = self._session
        if session is None or not session.worker.answering:
            return _refused(response, "expected an active localiser (got an inactive one)")
        try:
            response.message = session.ask(None).result(EXPLAIN_TIMEOUT_S)
            response.success = wire.decode(response.message, wire.Explanation).error is None
        except (SemlocError, TimeoutError) as error:
            return _refused(response, str(error) or f"no explanation within {EXPLAIN_TIMEOUT_S:.0f} s")
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        session = self._session
        if session is None:
            return _refused(response, "expected a configured localiser (got an unconfigured one)")
        session.reset()
        response.success, response.message = True, "the graph is forgotten until the next full update"
        return response

    def _on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        session = self._session
        if session is None:
            return _refused(response, "expected a configured localiser (got an unconfigured one)")
        try:
            with self._map_lock:
                localiser = self._open(session.config.map, session.worker.localiser.config)
                session.replace(localiser, self.get_clock().now().to_msg())
        except SemlocError as error:
            self.get_logger().error(f"map not reloaded, the old one serves on: {error}")
            return _refused(response, str(error))
        response.success, response.message = True, _told(localiser)
        return response

    # -- parameters --------------------------------------------------------------------------------------------

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse values that are not allowed; a map is loaded here already, so that a bad one changes nothing."""
        changed = {parameter.name: parameter.value for parameter in parameters}
        try:
            config, options = read(self, NodeConfig, changed), read(self, LocaliserConfig, changed)
            unused, self._prepared = self._prepared, None
            if unused is not None:  # what another callback refused
                unused.close()
            self._prepared = self._prepare(config, options)
        except SemlocError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _prepare(self, config: NodeConfig, options: LocaliserConfig) -> Localiser | None:
        """The localiser that these options make; None where it would be the one there is."""
        session = self._session
        if session is None:
            return None
        old = session.worker.localiser
        if config.map != session.config.map or options.buildings != old.config.buildings:
            return self._open(config.map, options)
        return old.renewed(options) if options != old.config else None

    def _take_parameters(self, _: list[Parameter]) -> None:
        session = self._session
        prepared, self._prepared = self._prepared, None
        if session is None:
            return
        session.configure(read(self, NodeConfig))
        if prepared is not None:
            with self._map_lock:
                session.replace(prepared, self.get_clock().now().to_msg())
            self.get_logger().info(f"serving {_told(prepared)}")

    def _open(self, map_: str, options: LocaliserConfig, wait: bool = False) -> Localiser:
        if not map_:
            raise ConfigError("expected parameter 'map' to name a map database (got none)")
        return open_localiser(map_, options, wait=wait, patience_s=options.server_timeout_s)


def _told(localiser: Localiser) -> str:
    """Which map it is, in a line."""
    info, server = localiser.map_info, localiser.server()
    if info is None:
        return server.line if server is not None else f"map {localiser.map.name}"
    return f"map {info.name} {info.hash[:12]}: {info.places} places"


def _refused(response: Trigger.Response, line: str) -> Trigger.Response:
    response.success, response.message = False, line
    return response


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    torch.set_num_threads(1)  # the same figures on every machine, and cores left for the robot
    return run(LocaliserNode, LocaliserNode.start, LocaliserNode.stop, LocaliserNode.free)


if __name__ == "__main__":
    sys.exit(main())
