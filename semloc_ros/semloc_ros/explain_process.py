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
"""The process that explains: `semloc_ros.explaining` starts it, so that no explainer ever holds up a match.

It reads pickled questions from a socket and writes pickled replies, one at a time, until the socket closes. Only its
parent, which is the same program, writes to that socket.
"""

from __future__ import annotations

import os
import pickle
import sys
from dataclasses import dataclass
from multiprocessing.connection import Connection

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.encoding import Query
from semloc_core.errors import SemlocError
from semloc_core.explain import answer_query, explain_answer
from semloc_core.map_database import LoadedMap
from semloc_core.matching import Evidence, Located

READY = -1
NICENESS = 5
"""Matches go first where cores are few."""


@dataclass(frozen=True, eq=False)
class Question:
    """Why this answer, or what a request asks about its query. The map is sent apart, once."""

    number: int
    query: Query
    matches: wire.PlaceMatches
    best_row: int | None
    config: LocaliserConfig
    request: wire.ExplainRequest | None = None
    evidence: Evidence | None = None


@dataclass(frozen=True, eq=False)
class Reply:
    """The message and its text, or one line that says why there is none; or, numbered `READY`, that it can begin."""

    number: int
    message: wire.ClassAttributions | wire.Explanation | None = None
    text: str = ""
    error: str = ""


def reply_to(question: Question, loaded: LoadedMap) -> Reply:
    """Explain."""
    try:
        message: wire.ClassAttributions | wire.Explanation
        located = Located(question.query, question.matches, loaded, question.best_row, question.evidence)
        if question.request is None:
            message = explain_answer(located, question.config)
        else:
            message = answer_query(located, question.request, question.config.accept_probability)
        return Reply(question.number, message, wire.encode(message).decode())
    except SemlocError as error:
        return Reply(question.number, error=str(error))


def serve(connection: Connection) -> None:
    """Answer until the other end closes."""
    loaded: LoadedMap | None = None
    try:
        connection.send_bytes(pickle.dumps(Reply(READY)))
        while True:
            received = pickle.loads(connection.recv_bytes())
            if isinstance(received, LoadedMap):
                loaded = received
                continue
            assert loaded is not None
            connection.send_bytes(pickle.dumps(reply_to(received, loaded)))
    except (EOFError, ConnectionError):
        return


def main() -> None:
    """Serve on the inherited socket whose descriptor is the only argument."""
    import torch

    os.nice(NICENESS)
    torch.set_num_threads(1)
    serve(Connection(int(sys.argv[1])))
