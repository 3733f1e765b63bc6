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
"""One thread owns the localiser: every update is applied in order, and only the latest query is answered.

No ROS here. The thread takes all that has come in since it last looked, applies it, and answers once; so it never
starves, however fast updates come. Work that needs the localiser (another map, a reset, a question about some place)
waits in the same queue, so nothing in the localiser needs a lock.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, TypeVar

from semloc_core.errors import GraphError, MessageError, SemlocError
from semloc_core.graph import Outcome
from semloc_core.localiser import Localiser
from semloc_core.matching import Located
from semloc_core.wire import SceneGraphUpdate, decode_update

T = TypeVar("T")
INBOX = 1000
"""Updates that wait here at most; more wait in the middleware, which holds them back at the publisher."""
WAIT_S = 0.2
IDLE_S = 1.0
"""How often the map is looked after while no update comes."""
LOSSES = 1000
"""Losses kept: the latest."""
LOST = {
    Outcome.GAP: "updates lost: {seq} came after {last}; there is no graph until the next full update",
    Outcome.WAITING: "update not used: {seq} is a change of a graph that is not there; a full update is needed",
    Outcome.REPEATED: "update not used: {seq} is not newer than {last}; a mapper that starts again must begin with a "
    "full update",
}
"""What is said of an update that comes to nothing."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Answer:
    """An answer, and what goes with it.

    Args:
        located: the core's answer.
        update: the update that was the latest when it was given.
        received_ns: when that update came in, by the steady clock.
        explain: whether an explanation is due.

    """

    located: Located
    update: SceneGraphUpdate
    received_ns: int
    explain: bool


@dataclass(eq=False)
class Counts:
    """What became of the updates, since the node was configured.

    Args:
        received: updates that came in.
        answered: answers given.
        skipped: updates that were applied but not answered for themselves, because later ones had come.
        malformed: updates that were no valid message.
        missed: updates whose numbers were skipped: they never came, or were overwritten while too many waited.
        last_rejection: why the latest was refused.

    """

    received: int = 0
    answered: int = 0
    skipped: int = 0
    malformed: int = 0
    missed: int = 0
    last_rejection: str = ""


@dataclass(frozen=True, eq=False)
class _Task:
    function: Callable[[Localiser], Any]
    future: Future[Any]

    def run(self, localiser: Localiser) -> None:
        try:
            self.future.set_result(self.function(localiser))
        except BaseException as error:  # the caller's work, and the caller's error
            self.future.set_exception(error)


class Worker:
    """The thread and its inbox.

    Args:
        localiser: owned from now on; reach it through `call`.
        on_answer: called in the thread with each answer.
        on_lost: called in the thread for each update that is refused, or that comes to nothing: with a line, and
            whether only a full update can mend it.

    """

    def __init__(
        self,
        localiser: Localiser,
        on_answer: Callable[[Answer], None],
        on_lost: Callable[[str, bool], None],
    ) -> None:
        self._localiser = localiser
        self._on_answer = on_answer
        self._on_lost = on_lost
        self._inbox: deque[tuple[int, str] | _Task] = deque()
        self._changed = threading.Condition()
        self._stopped = False
        self._answering = False
        self.counts = Counts()
        self.updated_ns: int | None = None
        """When the latest update came in, by the steady clock."""
        self.applied_ns: int | None = None
        """When the latest update was applied."""
        self.answered_ns: int | None = None
        """When the latest answer was given, or answering began, if that is later."""
        self.losses: deque[tuple[int, str]] = deque(maxlen=LOSSES)
        """When updates came to nothing, and how: malformed, rejected, repeated, gap, waiting."""
        self._seq = -1
        self._thread = threading.Thread(target=self._run, name="localiser", daemon=True)
        self._thread.start()

    @property
    def answering(self) -> bool:
        """Whether answers are given; updates are applied in any case."""
        return self._answering

    @answering.setter
    def answering(self, value: bool) -> None:
        self._answering, self.answered_ns = value, time.monotonic_ns()

    # -- for any thread -------------------------------------------------------------------------------------

    def put(self, text: str) -> None:
        """Hand over an update's text; waits while too many wait already."""
        received_ns = time.monotonic_ns()
        with self._changed:
            while len(self._inbox) >= INBOX and not self._stopped:
                self._changed.wait(WAIT_S)
            self._inbox.append((received_ns, text))
            self._changed.notify_all()

    def call(self, function: Callable[[Localiser], T], timeout_s: float | None = None) -> T:
        """Run a function on the localiser between two updates, and wait for what it returns or raises."""
        task = _Task(function, Future())
        with self._changed:
            if self._stopped:
                raise SemlocError("expected a running localiser (got one that has been stopped)")
            self._inbox.append(task)
            self._changed.notify_all()
        result: T = task.future.result(timeout_s)
        return result

    def replace(self, new: Localiser) -> None:
        """Put another localiser in place of this one; it goes on with the stream. Waits until it is done."""

        def swap(old: Localiser) -> None:
            new.take_over(old)
            self._localiser = new
            old.close()

        self.call(swap)

    def reset(self) -> None:
        """Forget the graph: there is none until the next full update."""
        self.call(self._forget)

    def stream_counts(self) -> Counter[str]:
        """How many updates had which outcome, see `semloc_core.graph.changes.stream.UpdateStream.counts`."""
        return Counter(self._localiser.live.stream.counts)

    @property
    def localiser(self) -> Localiser:
        """To read map and options from; what is in the stream belongs to the thread."""
        return self._localiser

    def stop(self) -> None:
        """End the thread; what still waits is dropped."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        self._thread.join()
        self._localiser.close()
        while self._inbox:
            item = self._inbox.popleft()
            if isinstance(item, _Task):
                item.future.set_exception(SemlocError("expected a running localiser (got one that was stopped)"))

    # -- the thread ------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            with self._changed:
                if not self._inbox and not self._stopped:
                    self._changed.wait(IDLE_S)
                if self._stopped:
                    return
                items = list(self._inbox)
                self._inbox.clear()
                self._changed.notify_all()
            try:
                self._work(items)
            except Exception:
                # A bug in the core or in a publisher must not end the stream: the next full update starts afresh.
                logger.exception("the localiser failed on an update")
                self._forget(self._localiser)

    def _forget(self, old: Localiser) -> None:
        new = old.renewed()
        new.live.count_on(old.live)
        self._localiser = new
        old.close()

    def _work(self, items: list[tuple[int, str] | _Task]) -> None:
        due: tuple[int, SceneGraphUpdate] | None = None
        for item in items:
            if isinstance(item, _Task):
                item.run(self._localiser)
                continue
            received_ns, text = item
            update = self._apply(text)
            if update is not None:
                self.counts.skipped += due is not None and self.answering
                due = received_ns, update
        if due is not None and self.answering:
            located = self._localiser.locate()
            explain = self._localiser.due(located)
            self.counts.answered += 1
            self.answered_ns = time.monotonic_ns()
            self._on_answer(Answer(located, due[1], due[0], explain))
        else:
            self._localiser.keep_up()

    def _apply(self, text: str) -> SceneGraphUpdate | None:
        """Apply an update; it is returned if there is an answer to it."""
        self.counts.received += 1
        self.updated_ns = time.monotonic_ns()
        try:
            update = decode_update(text, self._localiser.config.max_update_bytes)
        except MessageError as error:
            self.counts.malformed += 1
            return self._reject("malformed", error)
        try:
            outcome = self._localiser.apply(update)
        except GraphError as error:  # the stream has counted it
            return self._reject("rejected", error)
        if outcome is Outcome.APPLIED:
            self.applied_ns = time.monotonic_ns()
            if self._seq >= 0:
                self.counts.missed += max(0, update.seq - self._seq - 1)
            self._seq = update.seq
            return update
        self._lose(outcome.value, LOST[outcome].format(seq=update.seq, last=self._seq), True)
        return update if outcome is not Outcome.REPEATED else None

    def _reject(self, kind: str, error: SemlocError) -> None:
        self.counts.last_rejection = str(error)
        self._lose(kind, f"update rejected: {error}", False)

    def _lose(self, kind: str, line: str, full_needed: bool) -> None:
        self.losses.append((time.monotonic_ns(), kind))
        self._on_lost(line, full_needed)
