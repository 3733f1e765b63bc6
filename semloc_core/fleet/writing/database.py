"""A map on a Milvus server, open for changes: what `MapDatabase` is for a map file.

Changes are made in memory and written at the end of the outermost `FleetDatabase.transaction`, which makes them
visible at once. Writers never wait for each other. Of two that replace the same building the later one stays; a change
that builds on what was read (a merge, a single place) is refused where another writer was faster.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from semloc_core.encoding import Model
from semloc_core.errors import MapError
from semloc_core.fleet.milvus import collections as layout
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.milvus.creating import has_map, make_collections
from semloc_core.fleet.milvus.reading import no_map, state_now
from semloc_core.fleet.milvus.server import Server
from semloc_core.fleet.writing.committing import commit
from semloc_core.fleet.writing.conflicts import Draft
from semloc_core.fleet.writing.opened import OpenedMap
from semloc_core.fleet.writing.sweeping import GRACE_S, sweep
from semloc_core.map_database import PlaceRows, StoredBuilding

logger = logging.getLogger(__name__)

WRITE_TIMEOUT_S = 60.0


class FleetDatabase(OpenedMap):
    """A map on a server, open for changes; what each can be is said at `WritableMap`. To localise: `MilvusSource`."""

    def __init__(self, server: Server) -> None:
        super().__init__(server)
        self._tidied = False

    @classmethod
    def create(
        cls,
        address: MilvusAddress,
        model: Model,
        *,
        exist_ok: bool = False,
        index: str = layout.INDEX_KINDS[0],
        timeout_s: float = WRITE_TIMEOUT_S,
    ) -> FleetDatabase:
        """Make a map without buildings, and open it.

        Args:
            address: where.
            model: what makes the embeddings.
            exist_ok: open a map that is there already, if it is of the same model.
            index: kind of index the server is to keep of the embeddings, one of `layout.INDEX_KINDS`.
            timeout_s: how long one call to the server may take.

        Raises:
            MapError: there is a map of that name, or the server does not know the index.

        """
        if index not in layout.INDEX_KINDS:
            raise MapError(f"expected an index of {', '.join(layout.INDEX_KINDS)} (got {index!r})")
        server = Server(address, timeout_s)
        try:
            if has_map(server):
                if not exist_ok:
                    raise MapError(f"expected no map at {address} (got one that is there already)")
                database = cls(server)
                database.require(model.hash, model.labelspace.hash)
                return database
            if index == "DISKANN" and server.is_lite():
                raise MapError(f"expected an index that {address} knows (got {index}, which Milvus Lite does not)")
            make_collections(server, model, index)
            commit(server, address.name, None, {}, model)
            return cls(server)
        except BaseException:
            server.close()
            raise

    @classmethod
    def open(cls, address: MilvusAddress, *, timeout_s: float = WRITE_TIMEOUT_S) -> FleetDatabase:
        """Open a map to change it.

        Raises:
            MapError: no such map, or a damaged one; no server.

        """
        server = Server(address, timeout_s)
        try:
            if not has_map(server):
                raise no_map(server, address.name)
            return cls(server)
        except BaseException:
            server.close()
            raise

    def close(self) -> None:
        self._server.close()

    def refresh(self) -> None:
        """Take in what other writers have done; not inside a transaction."""
        if self._depth:
            raise MapError("expected no running transaction (got one)")
        self._stale = True

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Several changes as one: all of them are visible at the end, or none if an exception leaves the block.

        It begins with the map as it is then, and what other writers do meanwhile is not seen.
        """
        if self._depth:
            kept, kept_model = dict(self._drafts), self._fresh_model
            self._depth += 1
            try:
                yield
            except BaseException:
                self._drafts, self._fresh_model = kept, kept_model
                raise
            finally:
                self._depth -= 1
            return
        self._last, self._stale = state_now(self._server, self.name, self._last), False
        self._depth = 1
        try:
            yield
            if self._drafts or self._fresh_model is not None:
                space = self.model.labelspace if any(self._drafts.values()) else None
                commit(self._server, self.name, self._last, self._drafts, self._fresh_model, space)
        finally:
            self._depth, self._drafts, self._fresh_model, self._stale = 0, {}, None, True
        if not self._tidied:
            self._tidied = True
            self._tidy()

    def _tidy(self) -> None:
        try:
            sweep(self._server, self.name, GRACE_S, self._last)
        except MapError as error:  # the change is made; what is left to tidy the next one finds
            logger.warning("%s: not swept: %s", self._server.address, error)

    def sweep(self, older_than_s: float = GRACE_S) -> int:
        """Delete what nothing points to; see `semloc_core.fleet.writing.sweeping.sweep`."""
        return sweep(self._server, self.name, older_than_s)

    def remove_building(self, name: str) -> None:
        with self.transaction():
            self._check_known(name)
            self._drafts[name] = None

    def reset(self, model: Model) -> None:
        with self.transaction():
            self._drafts = dict.fromkeys(self._state.pointers)
            make_collections(self._server, model, "")
            self._fresh_model = model

    def _write(self, stored: StoredBuilding, places: PlaceRows, *, new: bool, revised: bool) -> None:
        draft, name = self._drafts.get(stored.name), stored.name
        if not revised:  # what was removed in the same transaction may be there still
            self._drafts[name] = Draft(stored, places, new=new and name not in self._drafts)
        elif draft is not None:
            self._drafts[name] = Draft(stored, places, draft.base, draft.new)
        else:  # what was read must be the current one when this is written
            self._drafts[name] = Draft(stored, places, self._state.pointers[name][0])
