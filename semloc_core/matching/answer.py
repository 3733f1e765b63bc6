"""A question to the localiser, its answer, and what one update led to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import Batch, Encoded
from semloc_core.graph import Outcome
from semloc_core.map_database import LoadedMap
from semloc_core.matching.layout.evidence import Evidence
from semloc_core.matching.posterior import Ranking
from semloc_core.wire import ClassAttributions, Match, PlaceMatches


@dataclass(frozen=True, eq=False)
class Query:
    """One question: where is ``place``, in the graph as it was after update ``seq``? Nothing in it changes later.

    ``batch`` and ``encoded`` are None where there was nothing to embed; ``reason`` then says why.
    """

    stamp_ns: int
    seq: int
    place: str | None
    batch: Batch | None = None
    encoded: Encoded | None = None
    class_names: tuple[str, ...] = ()
    reason: str = ""

    def because(self, reason: str) -> Query:
        """The same question, which has no answer for this reason."""
        return Query(self.stamp_ns, self.seq, self.place, reason=reason)


@dataclass(frozen=True, eq=False)
class Located:
    """An answer: the message to publish, and what `Localiser.explain` needs to say why.

    ``evidence`` is what the test by layout rests on at the best row; None where that was not tested.
    """

    query: Query
    matches: PlaceMatches
    map: LoadedMap
    best_row: int | None = None
    evidence: Evidence | None = None


@dataclass(frozen=True, eq=False)
class Localisation:
    """What one update led to.

    Attributes:
        outcome: what became of the update.
        located: the answer; None where the update was dropped as a repeat.
        attributions: why; None where none were due.

    """

    outcome: Outcome
    located: Located | None = None
    attributions: ClassAttributions | None = None

    @property
    def matches(self) -> PlaceMatches | None:
        """The message to publish."""
        return self.located.matches if self.located is not None else None


@dataclass(frozen=True)
class ServerState:
    """How the server that keeps a map does, as far as this robot knows.

    Args:
        answers: whether it answered when it was last asked.
        line: one sentence.
        values: figures, as text.

    """

    answers: bool
    line: str
    values: dict[str, str]


def matches_of(
    loaded: LoadedMap, rows: NDArray[np.int64], ranking: Ranking, similarity: NDArray[np.float32]
) -> list[Match]:
    """Rows of a map as a message lists them.

    Args:
        loaded: the map.
        rows: (K,) best first.
        ranking: has their probabilities.
        similarity: (M,) of the query to all places of the map.

    """
    return [
        Match(
            rank=rank,
            map=loaded.buildings[int(loaded.building_index[row])],
            place=loaded.place_ids[row],
            position=tuple(loaded.positions[row].tolist()),
            similarity=float(similarity[row]),
            probability=ranking.probability[row],
        )
        for rank, row in enumerate(rows.tolist(), 1)
    ]
