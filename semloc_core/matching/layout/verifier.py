"""The verification of an answer by layout, from what is around the robot to scored places of the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats, GraphArrays, Ints
from semloc_core.map_database import kth_largest
from semloc_core.matching.layout.building.layout import APART_M, LayoutPart
from semloc_core.matching.layout.config import LayoutConfig
from semloc_core.matching.layout.fragment import Fragment
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.pair_votes import PairVotes
from semloc_core.matching.layout.pose.align import against, align
from semloc_core.matching.layout.pose.heading_vote import STEP, best_poses, heading_scores, with_ties
from semloc_core.matching.layout.ring_score import CoarseScan, affordable
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True, eq=False)
class Tried:
    """P aligned poses, best first; a place may have several, with headings of their own.

    Args:
        rows: (P,) rows of the map.
        score: (P,) log-likelihood ratio.
        heading: (P,) radians: the robot's frame turned by it is parallel to the map's.
        shift: (P, 2) metres from the map's place to where the robot is.
        missing: (P,) lost for objects not seen, ≥ 0.
        walls: (P,) lost for room that the map does not have, ≥ 0.

    """

    rows: Ints
    score: Floats
    heading: Floats
    shift: Floats
    missing: Floats
    walls: Floats


@short_repr
@dataclass(frozen=True, eq=False)
class Verified:
    """Places of the map that were put to the test, best first, each once.

    Args:
        rows: (T,) rows of the map.
        score: (T,) log-likelihood ratio: the objects as mapped there, against all invented.
        heading: (T,) radians: the robot's frame turned by it is parallel to the map's.
        shift: (T, 2) metres from the map's place to where the robot is.
        rise: (T,) the same in height.
        explained: (T, n) share in the score of each object of the fragment, ≥ 0.
        missing: (T,) lost for objects not seen, ≥ 0.
        walls: (T,) lost for room that the map does not have, ≥ 0.
        tried: all poses, of these places.

    """

    rows: Ints
    score: Floats
    heading: Floats
    shift: Floats
    rise: Floats
    explained: Floats
    missing: Floats
    walls: Floats
    tried: Tried


class LayoutVerifier:
    """Reads the map once; then answers any number of queries.

    Args:
        graphs: the map's buildings.
        rows: for each building the indices of its places that are in the map, in the order of the map's rows.
        n_classes: C.
        config: options.
        weights: for each building the probability that each of its objects is still there; None: all surely are.
        storeys: for each building the storey of each of these places; None derives them from the graphs.

    """

    def __init__(
        self,
        graphs: Sequence[GraphArrays],
        rows: Sequence[Ints],
        n_classes: int,
        config: LayoutConfig | None = None,
        weights: Sequence[Floats] | None = None,
        storeys: Sequence[Ints] | None = None,
    ) -> None:
        each = [None] * len(graphs) if weights is None else weights
        on = [None] * len(graphs) if storeys is None else storeys
        parts = [LayoutPart(g, r, n_classes, w, config, s) for g, r, w, s in zip(graphs, rows, each, on, strict=True)]
        self._read(parts, n_classes, config or LayoutConfig())

    @classmethod
    def joined(cls, parts: Sequence[LayoutPart]) -> LayoutVerifier:
        """The same of buildings that are laid out already, in a few milliseconds for thousands of places.

        Args:
            parts: one at least, all made for the same classes and options; they may be in other maps too.

        """
        verifier = cls.__new__(cls)
        verifier._read(parts, parts[0].n_classes, parts[0].config)
        return verifier

    def _read(self, parts: Sequence[LayoutPart], n_classes: int, config: LayoutConfig) -> None:
        self.config = config
        self.mapped = MappedLayout(parts, n_classes, config)
        self._votes = PairVotes(
            [part.pairs for part in parts],
            self.mapped.object_positions,
            [len(part.object_positions) for part in parts],
            self.mapped.positions,
            self.mapped.building,
            n_classes,
        )
        scanned = len(parts) > 0 and affordable(self.mapped.n_places, n_classes)
        self._scan = CoarseScan([part.rings for part in parts]) if scanned else None

    def verify(
        self,
        fragment: Fragment,
        similarity: NDArray[np.float32] | None = None,
        only: NDArray[np.bool_] | None = None,
    ) -> Verified | None:
        """Put the likeliest places to the test.

        Args:
            fragment: what is around the robot.
            similarity: (M,) of its embedding to every place of the map: it proposes too. None: only the scan does,
                and a map that is too large for one has no answer.
            only: (M,) bool, the places that the robot can be at; None for all.

        Returns:
            The places tested; None where nothing speaks for any of them.

        """
        if not len(fragment.classes) or not self.mapped.n_places:
            return None
        rows, heading = self.poses(fragment, self.candidates(fragment, similarity, only))
        return self.tested(fragment, rows, heading) if len(rows) else None

    def poses(self, fragment: Fragment, candidates: Ints) -> tuple[Ints, Floats]:
        """(T,) rows and (T,) headings, radians, at which a fragment with an object may fit some of (K,) rows best."""
        scores = heading_scores(self.mapped, fragment, candidates)
        chosen, step = best_poses(self.mapped, candidates, scores, self.config.wide * self.config.fine, APART_M)
        rows: Ints = candidates[chosen]
        heading: Floats = (step * STEP).astype(np.float64)
        # What the map explains was voted for; of those that have most of that some have no room for it.
        missing, walls = against(self.mapped, fragment, rows, heading)
        value = scores[chosen, step].astype(np.float64) - missing - walls
        order = np.argsort(-value, kind="stable")[: with_ties(value, self.config.fine)]
        return rows[order], heading[order]

    def tested(self, fragment: Fragment, rows: Ints, heading: Floats) -> Verified:
        """Align a fragment at (T,) rows and headings, radians, one at least."""
        fitted = align(self.mapped, fragment, rows, heading)
        score = np.round(fitted.score, 6)
        order = np.lexsort((rows, -score))
        every = fitted.heading[order], fitted.shift[order], fitted.missing[order], fitted.walls[order]
        tried = Tried(rows[order], score[order], *every)
        # A place that was tried with several headings is listed with the best.
        best: dict[int, int] = {}
        for i, row in zip(order.tolist(), rows[order].tolist(), strict=True):
            best.setdefault(row, i)
        order = np.array(list(best.values()), dtype=np.int64)
        return Verified(
            rows[order],
            score[order],
            fitted.heading[order],
            fitted.shift[order],
            fitted.rise[order],
            fitted.explained[order],
            fitted.missing[order],
            fitted.walls[order],
            tried,
        )

    def candidates(
        self, fragment: Fragment, similarity: NDArray[np.float32] | None, only: NDArray[np.bool_] | None = None
    ) -> Ints:
        """(K,) rows to be tried, in rising order: the likeliest of the scan, and some of the most similar."""
        found = [self._votes.rows(fragment.sure(), self.config.voted, only)]
        if self._scan is not None and self.config.coarse:
            likelihood = self._scan.log_likelihood(fragment)
            found.append(self._apart(_largest(likelihood, self.config.coarse, only), likelihood))
        if similarity is not None:
            k = self.config.coarse // 5 if self._scan is not None else self.config.coarse
            found.append(self._apart(_largest(similarity, k, only), similarity))
        return np.unique(np.concatenate(found))

    def _apart(self, rows: Ints, values: NDArray[np.float32]) -> Ints:
        """The best of these places in each cell of `APART_M`: places beside one another make one pose."""
        cells = self.mapped.cells[rows]
        order = np.lexsort((rows, -values[rows], cells))
        ordered = cells[order]
        first = np.ones(len(rows), dtype=np.bool_)
        first[1:] = ordered[1:] != ordered[:-1]
        chosen: Ints = rows[order[first]]
        return chosen


def _largest(values: NDArray[np.float32], k: int, only: NDArray[np.bool_] | None) -> Ints:
    rows = None if only is None else np.flatnonzero(only)
    of = values if rows is None else values[rows]
    if len(of) <= k:
        return np.arange(len(of)) if rows is None else rows
    # Ties at the edge are all taken: which of them a partition would keep is not defined.
    chosen = np.flatnonzero(of >= kth_largest(of, k))
    if len(chosen) > 2 * k:
        chosen = np.argsort(-of, kind="stable")[:k]
    return chosen if rows is None else rows[chosen]
