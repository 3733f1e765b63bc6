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
import threading
from collections.abc import Callable
from concurrent.futures import Future

from builtin_interfaces.msg import Time

from semloc_core import wire
from semloc_core.errors import SemlocError
from semloc_core.explain import ClassShift
from semloc_core.localiser import Localiser, Located
from semloc_core.map_database import LoadedMap
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
        on_rejected: called with a line for each update that is refused.

    """

    def __init__(
        self,
        localiser: Localiser,
        config: NodeConfig,
        publishing: Publishing,
        on_rejected: Callable[[str], None],
    ) -> None:
        self.config = config
        self._publishing = publishing
        self._diagnostics = Diagnostics()
        self._shift_lock = threading.Lock()
        self._shift = ClassShift(localiser.map)
        self.explaining = Explaining(self._on_attributions, config.explain_deadline_s)
        self.worker = Worker(localiser, self._on_answer, on_rejected)
        self._drawn: LoadedMap | None = None

    def stop(self) -> None:
        """End threads and process; who waits for an answer gets an error."""
        self.worker.stop()
        self.explaining.stop()

    def close(self) -> None:
        """End all, free the publishers."""
        self.stop()
        self._publishing.destroy()

    def configure(self, config: NodeConfig) -> None:
        """Take other options of the node."""
        self.config, self.explaining.deadline_s = config, config.explain_deadline_s

    def replace(self, localiser: Localiser, stamp: Time) -> None:
        """Put another localiser, of another map or with other options, in place of this one, between two updates.

        Raises:
            SemlocError: this one has been stopped; the other one is closed.

        """
        other_map = localiser.map is not self.worker.localiser.map
        try:
            self.worker.replace(localiser)
        except SemlocError:
            localiser.close()
            raise
        if other_map:
            with self._shift_lock:
                self._shift = ClassShift(localiser.map)
        self.draw_map(stamp)

    def reset(self) -> None:
        """Forget the graph."""
        self.worker.reset()

    def draw_map(self, stamp: Time, clear: bool = True) -> None:
        """Publish the map's markers."""
        localiser = self.worker.localiser
        self._drawn = localiser.map
        self._publishing.map(self._drawn, localiser.config.frame_id, stamp, clear)

    def draw_changes(self, stamp: Time) -> None:
        """Publish the map's markers anew, if somebody looks and these are other buildings of a server's map by now."""
        changed = self._drawn is not None and self._drawn is not self.worker.localiser.map
        if changed and self._publishing.map_is_watched():  # takes a while
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
        self._publishing.explanation(text)

    def lines(self, state: str) -> list[Line]:
        """Diagnostics."""
        with self._shift_lock:
            return self._diagnostics.lines(
                self.worker, self.explaining.counts, self._shift, state, self.config.stale_after_s
            )

    def _on_answer(self, answer: Answer) -> None:
        localiser, located = self.worker.localiser, answer.located
        latency_ms = self._publishing.answer(answer, localiser.config, self.config.initialpose_after)
        self._diagnostics.answered(answer, latency_ms)
        self._publishing.query(answer, localiser.stream.graph)
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
