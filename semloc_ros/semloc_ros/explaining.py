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
"""Explanations apart from matches: a thread that keeps a process busy, and answers itself where that takes too long.

No ROS here. Of the answers that are due to be explained only the latest waits; every request waits its turn. An
explainer that is past the deadline is not waited for: attention answers in its place.
"""

from __future__ import annotations

import logging
import pickle
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait

import msgspec

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.errors import SemlocError
from semloc_core.explain import LAYOUT, explain_answer
from semloc_core.matching import Located
from semloc_ros.explain_process import READY, Question, Reply

FALLBACK = "attention"
"""The explainer that needs no further pass of its own, so it is never late."""
PAUSE_S = 5.0
"""A process that ended is not started again sooner."""

logger = logging.getLogger(__name__)


@dataclass(eq=False)
class _Job:
    """A question that is with the process, or waits for it."""

    located: Located
    config: LocaliserConfig
    request: wire.ExplainRequest | None = None
    future: Future[str] | None = None
    asked: float = 0.0
    answered: bool = False


@dataclass(eq=False)
class ExplainCounts:
    """How explanations went.

    Args:
        published: attributions published.
        late: of these, answered by attention because the process was busy or past the deadline.
        skipped: answers due to be explained that a later one overtook.

    """

    published: int = 0
    late: int = 0
    skipped: int = 0


class Explaining:
    """The thread, and the process that it starts when there is something to explain.

    Args:
        on_attributions: called in the thread with an answer, its attributions and their JSON text.
        deadline_s: how long the process may take over the attributions of an answer; change it at any time.

    """

    def __init__(
        self, on_attributions: Callable[[Located, wire.ClassAttributions, str], None], deadline_s: float
    ) -> None:
        self.deadline_s = deadline_s
        self.counts = ExplainCounts()
        self._on_attributions = on_attributions
        self._lock = threading.Lock()
        self._latest: _Job | None = None
        self._requests: deque[_Job] = deque()
        self._stopped = False
        self._wake_read, self._wake_write = socket.socketpair()
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._ended = -PAUSE_S
        self._ready = False
        self._map_sent = ""
        self._job: _Job | None = None
        self._numbers = 0
        self._thread = threading.Thread(target=self._run, name="explaining", daemon=True)
        self._thread.start()

    # -- for any thread ----------------------------------------------------------------------------------------

    def explain(self, located: Located, config: LocaliserConfig) -> None:
        """Have an answer explained; if an earlier one still waits, this one takes its place."""
        with self._lock:
            if self._stopped:
                return
            self.counts.skipped += self._latest is not None
            self._latest = _Job(located, config)
            self._wake()

    def ask(self, located: Located, config: LocaliserConfig, request: wire.ExplainRequest) -> Future[str]:
        """Have a request answered about an embedded query.

        Returns:
            The `wire.Explanation` as JSON text, when it is there.

        """
        job = _Job(located, config, request, Future())
        assert job.future is not None
        with self._lock:
            if self._stopped:
                job.future.set_exception(SemlocError("expected a running localiser (got one that was stopped)"))
                return job.future
            self._requests.append(job)
            self._wake()
        return job.future

    def stop(self) -> None:
        """End the process and the thread; what waits is not answered. Does nothing the second time."""
        with self._lock:
            if self._stopped:
                return
            self._stopped = True
            self._wake()
        self._thread.join()
        self._end_process()
        for job in [self._job, *self._requests]:
            if job is not None and job.future is not None:
                job.future.set_exception(SemlocError("expected a running localiser (got one that was stopped)"))
        self._wake_read.close()
        self._wake_write.close()

    def _wake(self) -> None:
        self._wake_write.send(b"!")

    # -- the thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            sources = [self._wake_read] + ([self._connection] if self._connection is not None else [])
            readable = wait(sources, self._patience())
            if self._wake_read in readable:
                self._wake_read.recv(4096)
            if self._stopped:
                return
            try:
                if self._connection is not None and self._connection in readable:
                    self._receive()
                self._hand_out()
            except Exception:
                # A bug in an explainer or a publisher costs this explanation, not those to come.
                logger.exception("an explanation failed")
                job, self._job = self._job, None
                if job is not None and job.future is not None:
                    job.future.set_exception(
                        SemlocError("expected an explanation (got an internal error, see the log)")
                    )

    def _patience(self) -> float | None:
        """Seconds until the process is past the deadline; None where nothing is at stake."""
        job = self._job
        if self._connection is None and self._requests:
            return max(0.0, self._ended + PAUSE_S - time.monotonic())
        if job is None or job.request is not None or job.answered:
            return None
        return max(0.0, job.asked + self.deadline_s - time.monotonic())

    def _late(self, job: _Job) -> bool:
        return job.request is None and not job.answered and time.monotonic() >= job.asked + self.deadline_s

    def _hand_out(self) -> None:
        """Give the process its next question, or answer without it."""
        job = self._job
        if job is not None and self._late(job):
            self._fall_back(job)
        with self._lock:
            due, waiting = self._latest, bool(self._requests)
            made = due is not None and due.config.explainer == LAYOUT  # when the place was put to the test
            self._latest = None if made else due
        if made and due is not None:
            self._say(due, due.config)
            due = None
        if due is None and not waiting:
            return
        if self._connection is None:
            self._start_process()
        idle = self._ready and self._job is None
        if due is not None:
            # An answer waits for the one before it, but for no other question, nor for one that is late.
            if not idle and job is not None and job.request is None and not job.answered:
                return
            with self._lock:
                due, self._latest = self._latest, None
            assert due is not None
            if idle:
                self._send(due)
            else:
                self._fall_back(due)
        elif idle:
            with self._lock:
                job = self._requests.popleft()
            self._send(job)

    def _fall_back(self, job: _Job) -> None:
        self.counts.late += 1
        self._say(job, msgspec.structs.replace(job.config, explainer=FALLBACK))

    def _say(self, job: _Job, config: LocaliserConfig) -> None:
        """Explain in this thread."""
        message = explain_answer(job.located, config)
        self._publish(job, message, wire.encode(message).decode())

    def _publish(self, job: _Job, message: wire.ClassAttributions, text: str) -> None:
        job.answered = True
        self.counts.published += 1
        self._on_attributions(job.located, message, text)

    # -- the process -------------------------------------------------------------------------------------------

    def _start_process(self) -> None:
        if time.monotonic() < self._ended + PAUSE_S:
            return
        ours, theirs = socket.socketpair()
        # Not `-m`, which would name the classes that are pickled after `__main__`.
        command = [sys.executable, "-c", "from semloc_ros.explain_process import main; main()", str(theirs.fileno())]
        # In a session of its own, so that Ctrl-C reaches this process only, which ends the other in order.
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, start_new_session=True
        )
        theirs.close()
        self._connection = Connection(ours.detach())
        self._ready, self._map_sent = False, ""

    def _end_process(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        self._ready, self._ended = False, time.monotonic()

    def _send(self, job: _Job) -> None:
        assert self._connection is not None
        self._numbers += 1
        job.asked, self._job = time.monotonic(), job
        located = job.located
        question = Question(
            self._numbers,
            located.query,
            located.matches,
            located.best_row,
            job.config,
            job.request,
            located.evidence,
        )
        try:
            if self._map_sent != located.map.hash:
                self._connection.send_bytes(pickle.dumps(located.map))
                self._map_sent = located.map.hash
            self._connection.send_bytes(pickle.dumps(question))
        except OSError:
            self._lost()

    def _receive(self) -> None:
        assert self._connection is not None
        try:
            reply: Reply = pickle.loads(self._connection.recv_bytes())
        except (EOFError, OSError):
            self._lost()
            return
        if reply.number == READY:
            self._ready = True
            return
        job, self._job = self._job, None
        if job is None:
            return
        if job.future is not None:
            if reply.error:
                job.future.set_exception(SemlocError(reply.error))
            else:
                job.future.set_result(reply.text)
        elif reply.error:
            logger.warning("an answer could not be explained: %s", reply.error)
        elif not job.answered:
            assert isinstance(reply.message, wire.ClassAttributions)
            self._publish(job, reply.message, reply.text)

    def _lost(self) -> None:
        """The process ended: its question is answered without it, and it is started again for the next one."""
        self._end_process()
        logger.warning("the explaining process ended; it is started again when it is needed")
        job, self._job = self._job, None
        if job is None:
            return
        if job.future is not None:
            job.future.set_exception(SemlocError("expected an explanation (got none: the explaining process ended)"))
        elif not job.answered:
            self._fall_back(job)
