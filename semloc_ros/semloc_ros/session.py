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
"""All that runs between configure and cleanup: the localiser's thread, the explanations, and what they publish."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from concurrent.futures import Future

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped

from semloc_core import wire
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.errors import SemlocError
from semloc_core.explain import ClassShift
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.matching import Located
from semloc_core.tracking import Hint
from semloc_ros.diagnostics import Diagnostics, Line
from semloc_ros.explaining import Explaining
from semloc_ros.parameters import NodeConfig
from semloc_ros.publishing import Publishing
from semloc_ros.worker import Answer, Worker

logger = logging.getLogger(__name__)


class Session:
    """One configured localiser.

    Args:
        localiser: as the parameters say.
        config: the node's own options; change ``config`` to change them.
        publishing: what answers go to; freed with the session.
        on_lost: see `Worker`.

    """

    def __init__(
        self,
        localiser: Localiser,
        config: NodeConfig,
        publishing: Publishing,
        on_lost: Callable[[str, bool], None],
    ) -> None:
        self.config = config
        self._publishing = publishing
        self._diagnostics = Diagnostics()
        self._shift_lock = threading.Lock()
        self._shift = ClassShift(localiser.map)
        self.explaining = Explaining(self._on_attributions, config.explain_deadline_s)
        self.worker = Worker(localiser, self._on_answer, on_lost)
        self._drawn: LoadedMap | None = None
        self._closing = threading.RLock()
        """Held while others than worker and explainer, which end first, publish; and while publishers are freed."""
        self._closed = False

    def stop(self) -> None:
        """End threads and process; who waits for an answer gets an error."""
        self.worker.stop()
        self.explaining.stop()

    def close(self) -> None:
        """End all, free the publishers."""
        self.stop()
        with self._closing:
            self._closed = True
            self._publishing.destroy()

    def configure(self, config: NodeConfig) -> None:
        """Take other options of the node."""
        if not config.publish_tf:
            self._publishing.forget()
        self.config, self.explaining.deadline_s = config, config.explain_deadline_s

    def replace(self, localiser: Localiser, stamp: Time) -> None:
        """Put another localiser, of another map or with other options, in place of this one, between two updates.

        Raises:
            SemlocError: this one has been stopped; the other one is closed.

        """
        before = self.worker.localiser
        other_map = localiser.map is not before.map
        try:
            self.worker.replace(localiser)
        except SemlocError:
            localiser.close()
            raise
        if other_map or localiser.config.frame_id != before.config.frame_id:
            self._publishing.forget()
        if other_map:
            with self._shift_lock:
                self._shift = ClassShift(localiser.map)
        self.draw_map(stamp)

    def reset(self) -> None:
        """Forget the graph."""
        self.worker.reset()
        self._publishing.forget()

    def hint(self, message: PoseWithCovarianceStamped) -> str:
        """Take a person's word for about where the robot is.

        Returns:
            Why it could not be taken; empty if it was.

        Raises:
            SemlocError: the session has been stopped.

        """
        if self._publishing.told(message):
            return ""
        frame_id, at = message.header.frame_id, message.pose.pose.position
        variance = max(message.pose.covariance[0], message.pose.covariance[7])
        radius_m = max(MATCH_RADIUS_M, 3.0 * math.sqrt(max(variance, 0.0)))

        def narrow(localiser: Localiser) -> str:
            frames = {name: localiser.frame_of(name) for name in localiser.buildings}
            meant = [name for name, frame in frames.items() if frame == frame_id.strip("/")]
            if not meant:
                return f"expected initialpose in a building's frame (got {frame_id!r})"
            localiser.hint(Hint(meant, (at.x, at.y), radius_m))
            return ""

        return self.worker.call(narrow)

    def send_again(self) -> None:
        """Send again what has to be said again and again: the transform."""
        if self.worker.answering:
            self._publishing.again(self.config)
        else:  # what comes meanwhile is not answered, and may change all
            self._publishing.forget()

    def draw_map(self, stamp: Time, clear: bool = True) -> None:
        """Publish the map's markers."""
        with self._closing:
            if self._closed:
                return
            localiser = self.worker.localiser
            self._drawn = localiser.map
            self._publishing.map(localiser, stamp, clear)

    def draw_changes(self, stamp: Time) -> None:
        """Publish the map's markers anew, if somebody looks and these are other buildings of a server's map by now."""
        with self._closing:
            changed = self._drawn is not None and self._drawn is not self.worker.localiser.map
            if changed and not self._closed and self._publishing.map_is_watched():  # takes a while
                self.draw_map(stamp, clear=False)

    def ask(self, request: wire.ExplainRequest | None) -> Future[str]:
        """Have a request answered about the graph as it is now; None: the last query, by every explainer."""
        asked = request.query_place if request is not None else None

        try:
            located = self.worker.call(lambda localiser: localiser.ask(asked))
        except SemlocError:
            raise
        except Exception as error:  # a bug costs who asks an answer, not the robot its localiser
            logger.exception("a question could not be answered")
            raise SemlocError("expected an answer (got an internal error, see the log)") from error
        if request is None:
            query, frame_id = located.query, located.matches.frame_id
            request = wire.ExplainRequest("semloc/explain_request/1", query.stamp_ns, frame_id, query.seq)
        return self.explaining.ask(located, self.worker.localiser.config, request)

    def publish_explanation(self, text: str) -> None:
        """Publish the answer to a request that came by topic."""
        with self._closing:
            if not self._closed:
                self._publishing.explanation(text)

    def lines(self, state: str, failure: str) -> list[Line]:
        """Diagnostics, see `semloc_ros.diagnostics.Diagnostics.lines`."""
        with self._shift_lock:
            return self._diagnostics.lines(
                self.worker, self.explaining.counts, self._shift, state, self.config.stale_after_s, failure
            )

    def _on_answer(self, answer: Answer) -> None:
        localiser, located = self.worker.localiser, answer.located
        latency_ms = self._publishing.answer(answer, localiser, self.config)
        self._diagnostics.answered(answer, latency_ms)
        evidence = localiser.evidence(located)
        if evidence is not None:
            self._publishing.evidence(evidence, answer, localiser.live.stream.graph)
        self._publishing.query(answer, localiser.live.stream.graph)
        if answer.explain:
            self.explaining.explain(located, localiser.config)
        if located.best_row is not None and self._shift_lock.acquire(blocking=False):
            # Skipped while diagnostics are made: a window can spare an answer, an answer can't wait.
            self._shift.follow(located.map)
            self._shift.see(located.matches.matches[0].map, filter(None, located.query.class_names))
            self._shift_lock.release()

    def _on_attributions(self, located: Located, message: wire.ClassAttributions, text: str) -> None:
        self._publishing.attributions(located, message, text)
        if message.match_map is not None:
            shares = {part.class_: part.share for part in message.classes}
            with self._shift_lock:
                self._shift.explain(message.match_map, shares)
