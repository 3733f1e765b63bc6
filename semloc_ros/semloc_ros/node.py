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

import contextlib
import functools
import sys
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future, TimeoutError
from typing import Any

import torch
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.timer import Timer
from std_msgs.msg import Empty, String
from std_srvs.srv import Trigger

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import ConfigError, SemlocError
from semloc_core.fleet import open_localiser
from semloc_core.localiser import Localiser
from semloc_ros import conversions, qos
from semloc_ros.bonding import bonded
from semloc_ros.diagnostics import not_running
from semloc_ros.parameters import READ_ONLY, NodeConfig, declare, read
from semloc_ros.publishing import Publishing
from semloc_ros.running import run
from semloc_ros.session import Session
from semloc_ros.tf import PERIOD_S

DIAGNOSTICS_PERIOD_S = 1.0
ASKED_EVERY_S = 1.0
"""While only a full update can help, it is asked for so often at most."""
EXPLAIN_TIMEOUT_S = 120.0
LISTED = 100
"""Buildings that are logged at most."""

RETRY_S = (1.0, 30.0)
"""After a start that failed it is tried again so soon, then after twice as long each time, up to so late."""
GOALS = {"configure": "inactive", "activate": "active", "deactivate": "inactive", "cleanup": "unconfigured"}
"""Where a transition leads; all others lead to ``finalized``, or back to ``unconfigured`` after an error."""

Step = Callable[[Any, LifecycleState], None]


def transition(step: Step) -> Callable[[LocaliserNode, LifecycleState], TransitionCallbackReturn]:
    """Make a lifecycle callback of a step: rclpy swallows what it raises, so it is logged here, and a failure."""
    name = step.__name__.removeprefix("on_")

    @functools.wraps(step)
    def callback(self: LocaliserNode, state: LifecycleState) -> TransitionCallbackReturn:
        self._failure = ""
        try:
            step(self, state)
        except Exception as error:
            self._failure = f"{name} failed: {_line(error)}"
            self.get_logger().error(self._failure)
            if name == "configure":
                self.free()
            return TransitionCallbackReturn.FAILURE
        self.get_logger().info(f"{name}: {state.label} -> {GOALS.get(name, 'finalized')}")
        return TransitionCallbackReturn.SUCCESS

    return callback


Answering = Callable[[Any, Session], tuple[bool, str]]


def served(answer: Answering) -> Callable[[LocaliserNode, Trigger.Request, Trigger.Response], Trigger.Response]:
    """Make a service of what answers it: whatever it raises, or whatever state the node is in, is an answer too."""

    @functools.wraps(answer)
    def callback(self: LocaliserNode, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        session = self._session
        if session is None:
            response.success, response.message = False, "expected a configured localiser (got an unconfigured one)"
            return response
        try:
            response.success, response.message = answer(self, session)
        except Exception as error:
            response.success, response.message = False, _line(error)
            if not isinstance(error, SemlocError):
                self.get_logger().error(f"{answer.__name__.removeprefix('_on_')} failed: {response.message}")
        return response

    return callback


class LocaliserNode(LifecycleNode):
    """Subscribes to scene-graph updates, publishes matches and attributions; all else is in `Session`."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("localiser", **kwargs)
        declare(self, NodeConfig, READ_ONLY)
        declare(self, LocaliserConfig)
        read(self, NodeConfig), read(self, LocaliserConfig)  # refuses what a range can't say, such as an unknown name
        self._session: Session | None = None  # what configure made
        self._failure = ""  # why the last transition failed, if it did
        self._self_started = False
        self._retry: Timer | None = None
        self._retry_s = RETRY_S[0]
        self._entities: list[Callable[[], object]] = []
        self._bonds: list[Callable[[], None]] = []  # what ends the bond, where there is one
        self._map_lock = threading.Lock()
        self._prepared: Localiser | None = None
        # Parameters and transitions use the default group, so that loading a map there holds up nothing else.
        self._update_group, self._question_group, self._timer_group, self._tf_group = (
            MutuallyExclusiveCallbackGroup() for _ in range(4)
        )
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)  # a simulated clock may stand still
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        # These live as long as the node: who asks an unconfigured one is told so, and an answer that comes after
        # a cleanup still finds its service (rclpy ends a node whose service is gone when it answers).
        serve = functools.partial(self.create_service, Trigger, callback_group=self._question_group)
        serve("~/explain", self._on_explain)
        serve("~/reset", self._on_reset)
        serve("~/reload_map", self._on_reload)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.LATEST)
        self._full_requests = self.create_publisher(Empty, qos.full_request_topic(self), qos.LATEST)
        self._asked = -ASKED_EVERY_S
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._on_timer, callback_group=self._timer_group, clock=self._steady)

    @property
    def state(self) -> str:
        """The lifecycle's: unconfigured, inactive, active, finalized, or the name of a transition."""
        return str(self._state_machine.current_state[1])

    def begin(self) -> None:
        """Have the executor call `start`, so that a map that takes long to load holds up nothing else."""
        self._start_after(0.0)

    def start(self) -> None:
        """Configure and activate, if ``autostart`` says so; where that fails, it is tried again later.

        Raises:
            ConfigError: it failed, and ``exit_on_failure`` says that it is not tried again.

        """
        if self._retry is not None:
            self.destroy_timer(self._retry)
            self._retry = None
        if not self.get_parameter("autostart").value or self.state not in ("unconfigured", "inactive"):
            return
        if self.state == "unconfigured":
            self.trigger_configure()
        if self.state == "inactive":
            self.trigger_activate()
        if not self._failure:
            self._self_started = self.state == "active"
        elif self.get_parameter("exit_on_failure").value:
            raise ConfigError(self._failure)
        else:
            self.get_logger().warning(f"not started: tried again in {self._retry_s:.0f} s")
            self._start_after(self._retry_s)
            self._retry_s = min(2 * self._retry_s, RETRY_S[1])

    def _start_after(self, seconds: float) -> None:
        self._retry = self.create_timer(seconds, self.start, clock=self._steady)  # the group of transitions

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Refuse a transition that the state does not allow: left to rclpy, it would end the node (rclpy#1209)."""
        wanted, state = request.transition, self.state
        name = wanted.label or str(wanted.id)
        possible = {item[1] if wanted.label else str(item[0]) for item in self._state_machine.available_transitions}
        if name in possible:
            self._taken_over()
            return self._change_state(request, response)
        if self._self_started and name in ("configure", str(Transition.TRANSITION_CONFIGURE)):
            # A manager's first configure: it expects an inactive node, and activates it next.
            self._taken_over()
            self.get_logger().info("a lifecycle manager takes over from autostart: inactive until it activates")
            response.success = state == "inactive" or self.trigger_deactivate() == TransitionCallbackReturn.SUCCESS
            return response
        self.get_logger().warning(f"transition {name} refused: expected one that {state} allows ({_listed(possible)})")
        response.success = False
        return response

    def _taken_over(self) -> None:
        """Leave transitions to who asks for them."""
        self._self_started = False
        if self._retry is not None:
            self.destroy_timer(self._retry)
            self._retry = None

    # -- lifecycle --------------------------------------------------------------------------------------------

    @transition
    def on_configure(self, state: LifecycleState) -> None:
        """Load the map, make publishers, threads and subscriptions; updates are applied from now on."""
        config, options = read(self, NodeConfig), read(self, LocaliserConfig)
        localiser = self._open(config.map, options, wait=True)
        self._session = Session(localiser, config, Publishing(self), self._on_lost)
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
        if self._session.config.bond:
            self._bonds.append(bonded(self))
        super().on_activate(state)
        self._session.draw_map(self.get_clock().now().to_msg())
        self._session.worker.answering = True

    @transition
    def on_deactivate(self, state: LifecycleState) -> None:
        """Answer no more; updates are still applied."""
        assert self._session is not None
        self._session.worker.answering = False
        self._end_bond()
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
        self._end_bond()
        session, self._session = self._session, None
        for destroy in self._entities:
            destroy()
        self._entities.clear()
        if session is not None:
            session.close()

    def _end_bond(self) -> None:
        while self._bonds:
            self._bonds.pop()()

    def _make_entities(self) -> None:
        def keep(make: Callable[..., Any], destroy: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
            entity = make(*args, **kwargs)
            self._entities.append(functools.partial(destroy, entity))
            return entity

        subscribe = functools.partial(keep, self.create_subscription, self.destroy_subscription, String)
        subscribe("scene_graph", self._on_update, qos.UPDATES, callback_group=self._update_group)
        subscribe("~/explain_request", self._on_request, qos.ANSWERS, callback_group=self._question_group)
        keep(
            self.create_subscription,
            self.destroy_subscription,
            PoseWithCovarianceStamped,
            "initialpose",
            self._on_hint,
            qos.LATEST,
            callback_group=self._question_group,
        )
        keep(self.create_timer, self.destroy_timer, PERIOD_S, self._on_tf_timer, callback_group=self._tf_group)

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

    def _on_lost(self, line: str, full_needed: bool) -> None:
        self.get_logger().warning(line, throttle_duration_sec=1.0)
        now = time.monotonic()
        if full_needed and now >= self._asked + ASKED_EVERY_S:
            self._asked = now
            self._full_requests.publish(Empty())

    def _on_hint(self, message: PoseWithCovarianceStamped) -> None:
        session = self._session
        if session is None:
            return
        try:
            refused = session.hint(message)
        except Exception as error:  # a hint that can't be taken ends nothing
            refused = _line(error)
        if refused:
            self.get_logger().warning(f"initialpose not taken as a hint: {refused}")

    def _on_timer(self) -> None:
        session, state, stamp = self._session, self.state, self.get_clock().now().to_msg()
        try:
            lines = [not_running(state, self._failure)] if session is None else session.lines(state, self._failure)
            if session is not None:
                session.draw_changes(stamp)
        except Exception as error:  # what watches the localiser must not end it
            self.get_logger().error(f"diagnostics failed: {type(error).__name__}: {error}", throttle_duration_sec=60.0)
            return
        self._diagnostics.publish(conversions.diagnostics_msg(lines, self.get_fully_qualified_name(), stamp))

    def _on_tf_timer(self) -> None:
        session = self._session
        if session is not None:
            with contextlib.suppress(InvalidHandle):  # cleaned up meanwhile; drawing a map may not hold this up
                session.send_again()

    # -- services ----------------------------------------------------------------------------------------------

    @served
    def _on_explain(self, session: Session) -> tuple[bool, str]:
        if not session.worker.answering:
            return False, "expected an active localiser (got an inactive one)"
        try:
            text = session.ask(None).result(EXPLAIN_TIMEOUT_S)
        except TimeoutError:
            return False, f"no explanation within {EXPLAIN_TIMEOUT_S:.0f} s"
        return wire.decode(text, wire.Explanation).error is None, text

    @served
    def _on_reset(self, session: Session) -> tuple[bool, str]:
        session.reset()
        return True, "the graph is forgotten until the next full update"

    @served
    def _on_reload(self, session: Session) -> tuple[bool, str]:
        try:
            with self._map_lock:
                localiser = self._open(session.config.map, session.worker.localiser.config)
                session.replace(localiser, self.get_clock().now().to_msg())
        except SemlocError as error:
            self.get_logger().error(f"map not reloaded, the old one serves on: {error}")
            raise
        return True, _told(localiser)

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
        except Exception as error:  # rclpy would end the node
            return SetParametersResult(successful=False, reason=_line(error))
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
            try:
                with self._map_lock:
                    session.replace(prepared, self.get_clock().now().to_msg())
            except SemlocError as error:  # it was stopped meanwhile
                self.get_logger().warning(f"not served: {error}")
                return
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


def _line(error: Exception) -> str:
    """What went wrong, in a line; of what is no error of ours also its kind."""
    return str(error) if isinstance(error, SemlocError) else f"{type(error).__name__}: {error}"


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    torch.set_num_threads(1)  # the same figures on every machine, and cores left for the robot
    return run(LocaliserNode, LocaliserNode.begin, LocaliserNode.stop, LocaliserNode.free)


if __name__ == "__main__":
    sys.exit(main())
