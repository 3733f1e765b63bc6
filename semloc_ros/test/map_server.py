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
"""A real map server on loopback, Milvus Lite in a process of its own, and a line to it that can be cut."""

import contextlib
import os
import selectors
import socket
import subprocess
import sys
import threading
import time

from semloc_core.fleet import FileSource, FleetDatabase, MilvusAddress


class MapServer:
    """Milvus Lite, serving a folder."""

    def __init__(self, folder):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        command = ["-m", "milvus_lite", "server", "--host", "127.0.0.1", "--port", str(self.port), "--max-workers", "1"]
        self._process = subprocess.Popen(
            [sys.executable, *command, "--data-dir", str(folder)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        deadline = time.monotonic() + 60
        while not self._listens():
            assert time.monotonic() < deadline, "Milvus Lite did not start"
            assert self._process.poll() is None, "Milvus Lite ended"
            time.sleep(0.05)

    def _listens(self):
        with socket.socket() as probe:
            probe.settimeout(1)
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def keep(self, name, path):
        """Keep the buildings of a map file under a name; what was there goes."""
        source = FileSource(path)
        with FleetDatabase.create(MilvusAddress("127.0.0.1", self.port, name), source.model()) as database:
            for building in source.catalogue().buildings:
                fetched = source.fetch(building)
                database.copy_building(fetched.stored, fetched.places)

    def change(self, name):
        """The map, open for changes."""
        return FleetDatabase.open(MilvusAddress("127.0.0.1", self.port, name))

    def stop(self):
        self._process.kill()
        self._process.wait(30)


class Line:
    """A TCP proxy: while it is cut, connections are refused, and those there are end; while silent, nothing comes."""

    def __init__(self, port, up=True):
        self._target = port
        self._pairs = {}
        self._lock = threading.Lock()
        self._listener = None
        self._stopped = self.silent = False
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self._thread = threading.Thread(target=self._run, daemon=True)
        if up:
            self.restore()
        self._thread.start()

    def restore(self):
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", self.port))
        listener.listen(16)
        with self._lock:
            self._listener = listener

    def cut(self):
        with self._lock:
            ends = [self._listener, *self._pairs]
            self._listener = None
            self._pairs.clear()
        for end in ends:
            if end is not None:
                end.close()

    def stop(self):
        self._stopped = True
        self._thread.join(5)
        self.cut()

    def _run(self):
        while not self._stopped:
            with self._lock:
                ends = [end for end in (self._listener, *self._pairs) if end is not None]
            with contextlib.suppress(OSError, ValueError), selectors.DefaultSelector() as selector:
                for end in ends:
                    selector.register(end, selectors.EVENT_READ)
                for key, _ in selector.select(0.02) if ends else ():
                    self._serve(key.fileobj)
            if not ends or self.silent:
                time.sleep(0.02)

    def _serve(self, end):
        if self.silent:
            return
        if end is self._listener:
            ours = end.accept()[0]
            theirs = socket.create_connection(("127.0.0.1", self._target), 5)
            with self._lock:
                self._pairs |= {ours: theirs, theirs: ours}
            return
        other = self._pairs.get(end)
        data = b""
        with contextlib.suppress(OSError):
            data = end.recv(1 << 16)
        if other is None:
            return
        if data:
            other.sendall(data)
            return
        with self._lock:
            self._pairs.pop(end, None), self._pairs.pop(other, None)
        end.close(), other.close()
