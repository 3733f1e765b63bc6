"""Rows of a server's search made into places: checked, ordered, none twice, only those of the map as it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from semloc_core.errors import MapError
from semloc_core.fleet.milvus.rows import integer, text
from semloc_core.fleet.source import Nearest
from semloc_core.text import short_repr

_HNSW_EF = 1.5  # candidates looked at for each that is wanted
_MOST_EF = 32_768


@short_repr
@dataclass(frozen=True)
class Hits:
    """What searches found: (similarity, generation, place) of each."""

    rows: tuple[tuple[float, int, str], ...] = ()

    def joined(self, other: Hits) -> Hits:
        """Both together."""
        return Hits((*self.rows, *other.rows))

    def of(self, names: Mapping[int, str], k: int) -> tuple[Nearest, set[int]]:
        """The k best of generations that have a name, and the generations that have none."""
        unknown = {generation for _, generation, _ in self.rows if generation not in names}
        best: dict[tuple[str, str], float] = {}
        for similarity, generation, id_ in self.rows:
            if generation in names:
                best.setdefault((names[generation], id_), similarity)
        order = sorted(best, key=lambda place: (-best[place], place))[:k]
        similarities = np.array([best[place] for place in order], dtype=np.float32)
        return Nearest(tuple(name for name, _ in order), tuple(id_ for _, id_ in order), similarities), unknown


def clean_hits(rows: Sequence[Mapping[str, Any]]) -> Hits:
    """Check the rows of a search.

    Raises:
        MapError: a row without generation, place or a finite similarity.

    """
    hits = []
    for row in rows:
        similarity = row.get("distance")
        if not isinstance(similarity, float) or not math.isfinite(similarity):
            raise MapError(f"expected a finite similarity (got {str(similarity)[:40]}: the map is damaged)")
        hits.append((similarity, integer(row, "generation"), text(row, "id")))
    return Hits(tuple(hits))


def search_parameters(index_type: str, k: int) -> dict[str, int]:
    """How thoroughly an index looks for the k best.

    Args:
        index_type: as the server names it; what is not known here gets the server's own settings.
        k: how many are wanted.

    """
    if index_type.startswith("HNSW"):
        return {"ef": min(_MOST_EF, max(64, int(_HNSW_EF * k)))}
    if index_type.startswith("IVF"):
        return {"nprobe": 32}
    if index_type == "DISKANN":
        return {"search_list": max(100, int(_HNSW_EF * k))}
    return {}
