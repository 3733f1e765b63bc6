"""How a map lies on a Milvus server: four collections, and what their rows hold.

A server has no transactions over several rows. So what a building consists of is written under a **generation**, a
number of its own, and never changed; the building's one row in the catalogue says which generation counts. Putting
another number there is the one step by which a change becomes visible.

- ``…_catalogue``: a row for each building, one for the map (`META`), one that every change writes anew (`CHANGE`).
- ``…_places_D``: places with embeddings of D numbers; found by generation.
- ``…_blobs``: scene graphs, histories and the model, cut into pieces that a text field takes; found by generation.
- ``…_generations``: a row for each generation that was begun, by which a sweep finds what nothing points to.
"""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Mapping
from typing import Any

PREFIX = "semloc_"
META = "meta"
CHANGE = "change"
CATALOGUE_FIELDS = ("key", "generation", "data")
PLACE_FIELDS = ("generation", "row", "id", "x", "y", "z", "embedding")
BLOB_FIELDS = ("generation", "kind", "piece", "data")
INDEX_KINDS = ("HNSW", "FLAT", "IVF_FLAT", "IVF_SQ8", "DISKANN", "AUTOINDEX")
MAX_TEXT = 65_535  # bytes of a text field
PIECE_BYTES = 48_000  # of a blob in a row: 64,000 characters in base 64
MAX_ID_BYTES = 4096  # 1024 characters
_EPOCH_MS = 1_700_000_000_000
_RANDOM_BITS = 22

Field = tuple[str, str, Mapping[str, Any]]
# A server wants a vector in every collection.
_PAD: Field = ("embedding", "FLOAT_VECTOR", {"dim": 2})
PAD = [0.0, 0.0]


def catalogue(name: str) -> str:
    """Collection with the pointers."""
    return f"{PREFIX}{name}_catalogue"


def generations(name: str) -> str:
    """Collection with the generations that were begun."""
    return f"{PREFIX}{name}_generations"


def blobs(name: str) -> str:
    """Collection with scene graphs, histories and models."""
    return f"{PREFIX}{name}_blobs"


def places(name: str, dimension: int) -> str:
    """Collection with places whose embeddings have ``dimension`` numbers."""
    return f"{PREFIX}{name}_places_{dimension}"


def collections(name: str, dimension: int) -> dict[str, tuple[Field, ...]]:
    """The collections of a map and their fields, the key first; the catalogue, which makes it a map, last."""
    return {
        generations(name): (("generation", "INT64", {}), ("touched_ms", "INT64", {}), _PAD),
        blobs(name): (
            ("key", "VARCHAR", {"max_length": 64}),
            ("generation", "INT64", {}),
            ("kind", "VARCHAR", {"max_length": 16}),
            ("piece", "INT64", {}),
            ("data", "VARCHAR", {"max_length": MAX_TEXT}),
            _PAD,
        ),
        places(name, dimension): (
            ("key", "VARCHAR", {"max_length": 64}),
            ("generation", "INT64", {}),
            ("row", "INT64", {}),
            ("id", "VARCHAR", {"max_length": MAX_ID_BYTES}),
            *((axis, "DOUBLE", {}) for axis in "xyz"),
            ("embedding", "FLOAT_VECTOR", {"dim": dimension}),
        ),
        catalogue(name): (
            ("key", "VARCHAR", {"max_length": 80}),
            ("generation", "INT64", {}),
            ("data", "VARCHAR", {"max_length": MAX_TEXT}),
            _PAD,
        ),
    }


def building_key(name: str) -> str:
    """The key of a building's row: a hash, so that no name is ever part of a condition."""
    return f"b{hashlib.sha256(name.encode()).hexdigest()}"


def now_ms() -> int:
    """Milliseconds since 1970, by this machine's clock."""
    return time.time_ns() // 1_000_000


def new_generation() -> int:
    """A number that no other writer takes: the time and 22 random bits; positive and below 2⁶³."""
    return ((now_ms() - _EPOCH_MS) << _RANDOM_BITS) | secrets.randbits(_RANDOM_BITS) | 1
