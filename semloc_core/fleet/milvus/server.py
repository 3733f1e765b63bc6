"""The connection to a Milvus server: made when first needed, made anew after it was lost, every call with a timeout.

pymilvus is imported by the first call: who uses map files does without it.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from semloc_core.errors import MapError, MapUnavailableError
from semloc_core.fleet.milvus.address import CERTIFICATE_VARIABLE, TOKEN_VARIABLE, MilvusAddress

if TYPE_CHECKING:
    from pymilvus import MilvusClient

Row = dict[str, Any]

DEFAULT_TIMEOUT_S = 5.0
MAX_MESSAGE_BYTES = 64 * 2**20  # what a server in its default settings takes; more than this is not received either
MAX_ROWS = 16_384  # the most that a server gives to one query
_OPTIONS = {
    "grpc.max_receive_message_length": MAX_MESSAGE_BYTES,
    "grpc.use_local_subchannel_pool": 1,  # a connection made anew does not wait out an older one's back-off
    "grpc.max_reconnect_backoff_ms": 2000,
}
_CONNECT_FAILED = 2
_RATE_LIMIT = 8
_NO_COLLECTION = 100
_NOT_LOADED = 101


class Server:
    """A Milvus server, for one map; may be used by several threads.

    Args:
        address: where.
        timeout_s: how long a call may take; a call that had to wait for a connection may take twice as long.

    """

    def __init__(self, address: MilvusAddress, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        if not 0 < timeout_s < float("inf"):
            raise MapError(f"expected a timeout above 0 s (got {timeout_s})")
        self.address = address
        self.timeout_s = timeout_s
        self._client: MilvusClient | None = None
        self._lock = threading.Lock()

    def close(self) -> None:
        """Close the connection; the next call makes another one."""
        with self._lock:
            client, self._client = self._client, None
        if client is not None:
            client.close()

    # -- reading --------------------------------------------------------------------------------------------------

    def collections(self) -> tuple[str, ...]:
        """Names of all collections on the server, sorted."""
        found = self._call("list_collections")
        return tuple(sorted(name for name in found if isinstance(name, str)))

    def is_lite(self) -> bool:
        """Whether the server is Milvus Lite."""
        return str(self._call("get_server_version")).startswith("milvus_lite")

    def query(
        self, collection: str, condition: str, fields: Sequence[str], limit: int, consistency: str = "Strong"
    ) -> list[Row]:
        """Rows that fulfil a condition, in no particular order.

        Raises:
            MapError: the server refuses, or sends more than was asked for or something else.

        """
        assert 0 < limit <= MAX_ROWS, limit
        found = self._loaded(
            "query",
            collection,
            filter=condition,
            output_fields=list(fields),
            limit=limit,
            consistency_level=consistency,
        )
        rows = list(found)
        if len(rows) > limit or not all(isinstance(row, dict) for row in rows):
            raise MapError(f"expected at most {limit} rows of {collection} (got something else from {self.address})")
        return rows

    def query_all(self, collection: str, condition: str, fields: Sequence[str], most: int) -> list[Row]:
        """Like `query`, but as many rows as there are, in several messages where need be.

        Raises:
            MapError: as `query`, or more than ``most``.

        """
        rows = self.query(collection, condition, fields, MAX_ROWS)
        if len(rows) == MAX_ROWS:
            iterator = self._loaded(
                "query_iterator",
                collection,
                batch_size=MAX_ROWS // 2,
                filter=condition,
                output_fields=list(fields),
                consistency_level="Strong",
            )
            rows = []
            while batch := self._guarded(iterator.next):
                rows.extend(batch)
                if len(rows) > most:
                    break
            self._guarded(iterator.close)
        if len(rows) > most:
            raise MapError(f"expected at most {most} rows of {collection} (got more from {self.address})")
        return rows

    def search(
        self,
        collection: str,
        z: Sequence[float],
        k: int,
        condition: str,
        fields: Sequence[str],
        parameters: Mapping[str, Any],
    ) -> list[Row]:
        """The k rows nearest to a vector by inner product, each with its ``distance``."""
        assert 0 < k <= MAX_ROWS, k
        found = self._loaded(
            "search",
            collection,
            data=[list(z)],
            anns_field="embedding",
            limit=k,
            filter=condition,
            output_fields=list(fields),
            search_params={"metric_type": "IP", "params": dict(parameters)},
            consistency_level="Bounded",
        )
        hits = list(found[0]) if len(found) else []
        if len(hits) > k:
            raise MapError(f"expected at most {k} places (got {len(hits)} from {self.address})")
        try:
            return [{**hit["entity"], "distance": hit["distance"]} for hit in hits]
        except (KeyError, TypeError):
            raise MapError(f"expected places with similarities (got something else from {self.address})") from None

    def index_type(self, collection: str) -> str:
        """Which kind of index the embeddings of a collection have; empty where the server does not say."""
        try:
            found = self._call("describe_index", collection, "embedding")
        except MapUnavailableError:
            raise
        except MapError:  # a user who may search need not be one who may look at indexes
            return ""
        return str(found.get("index_type", "")) if isinstance(found, dict) else ""

    # -- writing --------------------------------------------------------------------------------------------------

    def create(self, collection: str, fields: Sequence[tuple[str, str, Mapping[str, Any]]], index: str) -> None:
        """Make a collection, unless there is one of that name.

        Args:
            collection: its name.
            fields: name, type and further arguments of each field; the first is the primary key. ``embedding`` is
                the vector.
            index: kind of index of the vectors.

        """
        from pymilvus import DataType, MilvusClient

        if collection in self.collections():
            return
        schema = MilvusClient.create_schema(auto_id=False, enable_dynamic_field=False)
        for i, (name, type_, more) in enumerate(fields):
            schema.add_field(name, DataType[type_], is_primary=i == 0, **more)
        indices = MilvusClient.prepare_index_params()
        build = {"M": 16, "efConstruction": 200} if index == "HNSW" else {}
        indices.add_index("embedding", index_type=index, metric_type="IP", params=build)
        if any(name == "generation" for name, _, _ in fields[1:]):
            indices.add_index("generation", index_type="INVERTED")
        try:
            # One shard: the rows of one request become visible at one time.
            options = {"num_shards": 1, "consistency_level": "Strong"}
            self._call("create_collection", collection, schema=schema, index_params=indices, **options)
        except MapUnavailableError:
            raise
        except MapError:
            if collection not in self.collections():  # else another writer was faster
                raise

    def drop(self, collection: str) -> None:
        """Remove a collection."""
        self._call("drop_collection", collection)

    def insert(self, collection: str, rows: list[Row]) -> None:
        """Add rows of new keys."""
        self._loaded("insert", collection, rows)

    def upsert(self, collection: str, rows: list[Row]) -> None:
        """Add rows, in place of those that have the same key."""
        self._loaded("upsert", collection, rows)

    def delete(self, collection: str, condition: str) -> None:
        """Remove the rows that fulfil a condition."""
        self._loaded("delete", collection, filter=condition)

    def flush(self, collection: str) -> None:
        """Let the server write a collection's newest rows to its disk, and index them."""
        self._call("flush", collection)

    # -- calls ----------------------------------------------------------------------------------------------------

    def _loaded(self, method: str, collection: str, *args: Any, **kwargs: Any) -> Any:
        """A call that needs the collection in the server's memory: Milvus Lite forgets that when it is restarted."""
        try:
            return self._call(method, collection, *args, **kwargs)
        except _NotLoadedError:
            self._call("load_collection", collection)
            return self._call(method, collection, *args, **kwargs)

    def _call(self, method: str, *args: Any, **kwargs: Any) -> Any:
        return self._guarded(lambda: getattr(self._connected(), method)(*args, timeout=self.timeout_s, **kwargs))

    def _guarded(self, work: Any) -> Any:
        """Do ``work``, and turn what pymilvus and grpc say into one line of ours."""
        _import_pymilvus()
        import grpc
        from pymilvus.exceptions import MilvusException

        started = time.monotonic()
        try:
            return work()
        except grpc.RpcError as error:
            code = error.code() if hasattr(error, "code") else None
            raise self._lost(code, error, started) from None
        except MilvusException as error:
            if isinstance(error.code, grpc.StatusCode):
                raise self._lost(error.code, error, started) from None
            raise self._refused(error.code, str(error.message), started) from None
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            # pymilvus could not read an answer
            raise MapError(
                f"expected an answer of Milvus from {self.address} (got another: {_short(error)})"
            ) from error

    def _connected(self) -> MilvusClient:
        with self._lock:
            if self._client is None:
                from pymilvus import MilvusClient

                certificate = os.environ.get(CERTIFICATE_VARIABLE, "")
                if self.address.secure and certificate and not Path(certificate).is_file():
                    raise MapError(f"expected {CERTIFICATE_VARIABLE} to name a file (got {certificate}, which is none)")
                more = {"server_pem_path": certificate} if self.address.secure and certificate else {}
                token = os.environ.get(TOKEN_VARIABLE, "")
                self._client = MilvusClient(
                    self.address.uri,
                    token=token,
                    timeout=self.timeout_s,
                    dedicated=True,
                    grpc_options=_OPTIONS,
                    **more,
                )
            return self._client

    def _lost(self, code: Any, error: Exception, started: float) -> MapError:
        import grpc

        if code in (grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.PERMISSION_DENIED):
            return self._not_let_in()
        if code is grpc.StatusCode.RESOURCE_EXHAUSTED:
            return MapError(f"expected messages of at most {MAX_MESSAGE_BYTES} bytes (got more from {self.address})")
        if code is grpc.StatusCode.UNIMPLEMENTED:
            return MapError(f"expected a Milvus server at {self.address} (got something else: {_short(error)})")
        self.close()
        reason = code.name.lower().replace("_", " ") if isinstance(code, grpc.StatusCode) else _short(error)
        return self._unavailable(reason, started)

    def _refused(self, code: int, message: str, started: float) -> MapError:
        lowered = message.lower()
        if code == _NOT_LOADED or "not loaded" in lowered:
            return _NotLoadedError(f"expected a loaded collection at {self.address} (got: {_short(message)})")
        if code == _NO_COLLECTION:
            return NoCollectionError(f"expected a map at {self.address} (got: {_short(message)})")
        if code == _CONNECT_FAILED:
            self.close()
            return self._unavailable("no server there", started)
        if code == _RATE_LIMIT or "timeout" in lowered or "deadline" in lowered:
            self.close()
            return self._unavailable(_short(message), started)
        if "auth" in lowered or "permission" in lowered or "privilege" in lowered:
            return self._not_let_in()
        return MapError(f"expected {self.address} to do as it is told (got: {_short(message)})")

    def _unavailable(self, reason: str, started: float) -> MapUnavailableError:
        waited = time.monotonic() - started >= 0.9 * self.timeout_s
        within = f" within {self.timeout_s:g} s" if waited else ""
        return MapUnavailableError(f"expected an answer from {self.address}{within} (got none: {reason})")

    def _not_let_in(self) -> MapError:
        have = "the token in" if os.environ.get(TOKEN_VARIABLE) else "no token in"
        return MapError(f"expected to be let in by {self.address} (got a refusal, with {have} {TOKEN_VARIABLE})")


class NoCollectionError(MapError):
    """There is no such collection on the server."""


class _NotLoadedError(MapError):
    """The collection is on the server's disk only."""


def _short(reason: object) -> str:
    return " ".join(str(reason).split())[:200]


def _import_pymilvus() -> None:
    try:
        import pymilvus  # noqa: F401
    except ImportError as error:
        name = error.name or "pymilvus"
        raise MapError(
            f"expected pymilvus, for a map on a server (got no {name}: pip install -e '.[fleet]' in the clone)"
        ) from None
    # It logs the whole traceback of every error that it raises; what is wrong is said by our own.
    logging.getLogger("pymilvus").setLevel(logging.CRITICAL + 1)
