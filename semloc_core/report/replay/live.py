"""The page that plays a replay, served while the replay runs: frames come as they are answered."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec

from semloc_core.config import LocaliserConfig
from semloc_core.errors import ConfigError, MapError, SemlocError
from semloc_core.graph import Reading
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap
from semloc_core.replay import Answer, replay
from semloc_core.report.replay.gathering import Gathering
from semloc_core.sources import TOLERANCE_S, Truth

LOOPBACK = "127.0.0.1"
MOST_FRAMES = 1_000_000


class Feed:
    """What a live page asks for; written by the replay, read by the server's threads.

    Args:
        loaded: the map.
        tolerance_s: how far apart the stamps of an answer and of its ground truth may be.
        config: the localiser's options.

    """

    def __init__(
        self, loaded: LoadedMap, tolerance_s: float = TOLERANCE_S, config: LocaliserConfig | None = None
    ) -> None:
        self._config = config or LocaliserConfig()
        self._gathering = Gathering(loaded, tolerance_s, MOST_FRAMES)
        self._lock = threading.Lock()
        self._done, self._error = False, ""

    def run(self, run: Path, reading: Reading, *, topic: str | None = None, robot: str | None = None) -> None:
        """Localise along a run to its end; what goes wrong is said on the page, and raised."""
        loaded, config = self._gathering.data.buildings.loaded, self._config
        try:
            localiser = Localiser(loaded, config, reading)
            replay(
                run, localiser, config, topic=topic, robot=robot, on_answer=self._on_answer, on_truth=self._on_truth
            )  # fmt: skip
        except SemlocError as error:
            self._error = str(error)
            raise
        finally:
            with self._lock:
                self._gathering.finish()
                self._done = True

    def _on_answer(self, answer: Answer) -> None:
        with self._lock:
            for said in (answer.attributions, answer.evidence):
                if said is not None:
                    self._gathering.said(said)
            self._gathering.answer(answer.matches.stamp_ns, answer.matches, answer.located)

    def _on_truth(self, truth: Truth) -> None:
        with self._lock:
            self._gathering.truth(truth)

    def frames(self, first: int) -> bytes:
        """JSON of the frames from a number on, and whether more come."""
        with self._lock:
            data = self._gathering.data
            frames = data.frames.since(first)
            rows = data.rows if self._done else []
            return msgspec.json.encode({"frames": frames, "done": self._done, "rows": rows, "error": self._error})

    def building(self, name: str) -> bytes:
        """JSON of one building; MapError where the map has none of that name."""
        with self._lock:
            return msgspec.json.encode(self._gathering.data.buildings.get(name))


@contextmanager
def served(page: str, feed: Feed | None, host: str = LOOPBACK, port: int = 0) -> Iterator[str]:
    """Serve a page, and what it asks for, while the block runs; gives its address.

    Args:
        page: HTML.
        feed: of a live page; None for one that has its data inside.
        host: whose requests are listened to; by default this machine's own.
        port: 0 takes a free one.

    Raises:
        ConfigError: nothing can listen there.

    """
    handler = type("Bound", (_Handler,), {"page": page.encode(), "feed": feed, "host": host})
    try:
        server = ThreadingHTTPServer((host, port), handler)
    except OSError as error:
        raise ConfigError(f"expected an address to listen on (got {host}:{port}: {error.strerror or error})") from error
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield f"http://{host}:{server.server_address[1]}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    page: bytes
    feed: Feed | None
    host: str

    def do_GET(self) -> None:  # of http.server
        """Answer a request."""
        asked = urlsplit(self.path)
        words = {name: values[0] for name, values in parse_qs(asked.query).items()}
        # A page of elsewhere that has its name point here is no reader of this one.
        if self.host == LOOPBACK and self.headers.get("Host", "").rsplit(":", 1)[0] not in (LOOPBACK, "localhost"):
            self.send_error(403)
        elif asked.path == "/":
            self._send(self.page, "text/html; charset=utf-8")
        elif self.feed is not None and asked.path == "/frames" and words.get("from", "").isdecimal():
            self._send(self.feed.frames(int(words["from"])), "application/json")
        elif self.feed is not None and asked.path == "/building":
            try:
                self._send(self.feed.building(words.get("name", "")), "application/json")
            except MapError:
                self.send_error(404)
        else:
            self.send_error(404)

    def _send(self, content: bytes, kind: str) -> None:
        self.send_response(200)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing of each request."""
