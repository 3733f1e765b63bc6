"""A map server to measure: Milvus Lite, started here on loopback, or one that runs already."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from semloc_core.errors import MapUnavailableError
from semloc_core.fleet import FleetDatabase, MilvusAddress, MilvusSource, Server, push
from semloc_core.map_database import load

TIMEOUT_S = 120.0
START_S = 60.0


class FleetServer:
    """Keeps maps, each under the name of its file; those of a server that runs already are dropped in the end.

    Args:
        folder: where Milvus Lite keeps its data.
        address: of any map on a server that runs already; None: Milvus Lite is started.

    Raises:
        MapUnavailableError: it can't be started.

    """

    def __init__(self, folder: Path, address: MilvusAddress | None = None) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._kept: list[str] = []
        self._address = address or self._start(folder)
        self.name = "Milvus Lite" if address is None else "Milvus"

    def __enter__(self) -> FleetServer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            return
        for name in self._kept:
            self._drop(name)

    def keep(self, path: Path) -> None:
        """Put a map file onto the server, at rest: written to its disk, and indexed."""
        address = replace(self._address, name=path.stem)
        self._drop(path.stem)
        loaded = load(path)
        with FleetDatabase.create(address, loaded.model) as database:
            push(loaded, database)
        self._kept.append(path.stem)
        server = Server(address, TIMEOUT_S)
        for collection in self._collections(server, path.stem):
            server.flush(collection)
        server.close()

    def source(self, name: str, timeout_s: float, poll_s: float) -> MilvusSource:
        """A robot's way to a map."""
        return MilvusSource(replace(self._address, name=name), timeout_s, poll_s)

    def cpu_s(self) -> float | None:
        """CPU time that the server has taken so far; None for one that was not started here, or off Linux."""
        if self._process is None:
            return None
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rsplit(")", 1)[1].split()
            return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return None

    def _drop(self, name: str) -> None:
        server = Server(replace(self._address, name=name), TIMEOUT_S)
        for collection in self._collections(server, name):
            server.drop(collection)
        server.close()

    @staticmethod
    def _collections(server: Server, name: str) -> list[str]:
        return [each for each in server.collections() if each.startswith(f"semloc_{name}_")]

    def _start(self, folder: Path) -> MilvusAddress:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port: int = free.getsockname()[1]
        options = ["--host", "127.0.0.1", "--port", str(port), "--data-dir", str(folder)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "milvus_lite", "server", *options],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline and self._process.poll() is None:
            with socket.socket() as probe:
                probe.settimeout(1)
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    return MilvusAddress("127.0.0.1", port, "bench")
            time.sleep(0.05)
        self._process.kill()
        raise MapUnavailableError("expected Milvus Lite, the extra semloc[test], to start (got a process that ended)")
