"""Perturbed variants of the training buildings, made when they are first wanted and kept for a while."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding import Batch, Extraction, extract_all
from semloc_core.graph import Floats, GraphArrays, Labelspace
from semloc_core.text import short_repr
from semloc_core.training.config import PerturbConfig
from semloc_core.training.split import PARTS, Bools, Part, Split, positive_pairs
from semloc_core.training.views.fragments import Fragments, draw_fragments
from semloc_core.training.views.perturb import perturb


@short_repr
@dataclass(frozen=True, eq=False)
class Variant:
    """One perturbed variant of a building, ready for an encoder.

    Args:
        batch: all its places.
        building: index of the building.
        positions: (P, 3) float64, metres.
        parts: (P,) int8, index into `semloc_core.training.split.PARTS`.
        fragments: queries of parts of it, where they are wanted.

    """

    batch: Batch
    building: int
    positions: Floats
    parts: NDArray[np.int8]
    fragments: Fragments | None = None

    def mask(self, part: Part) -> Bools:
        """(P,) which of its places are in a part of the split."""
        chosen: Bools = self.parts == PARTS.index(part)
        return chosen


class VariantMaker:
    """Makes the variants of some buildings; a variant is a function of seed, building and number alone.

    That is what lets an interrupted training go on as if it had not been: no generator's state has to be kept.

    Args:
        graphs: the buildings.
        splits: their splits.
        labelspace: classes and mobility.
        extraction: what the encoder reads.
        config: the perturbation.
        seed: (seed, stream): two makers with other streams share no variant.
        walks: walks, stops on each and their length (m), for fragments of the graph; None: no fragments.

    """

    def __init__(
        self,
        graphs: Sequence[GraphArrays],
        splits: Sequence[Split],
        labelspace: Labelspace,
        extraction: Extraction,
        config: PerturbConfig,
        seed: tuple[int, int],
        walks: tuple[int, int, float] | None = None,
    ) -> None:
        self._graphs, self._splits = graphs, splits
        self._labelspace, self._extraction = labelspace, extraction
        self._config, self._seed, self._walks = config, seed, walks

    def make(self, building: int, number: int) -> Variant:
        """Variant ``number`` of a building."""
        rng = np.random.default_rng([*self._seed, building, number])
        graph = perturb(self._graphs[building], self._labelspace, self._config, rng)
        batch = extract_all(graph, len(self._labelspace), self._extraction)
        parts = self._splits[building].parts_of(graph)
        fragments = None
        if self._walks is not None:
            fragments = draw_fragments(graph, len(self._labelspace), self._extraction, rng, *self._walks)
        return Variant(batch, building, graph.place_positions, parts, fragments)


class VariantPool:
    """The variants that are in use at a step: a window over the variants' numbers that moves on with the steps.

    Args:
        maker: makes a variant that asks.
        size: variants of each building in the window.
        refresh_steps: the window moves by one after so many steps.
        map_maker: makes a variant that is asked; None: the same maker, a pair is two of a kind.

    """

    def __init__(
        self, maker: VariantMaker, size: int, refresh_steps: int, map_maker: VariantMaker | None = None
    ) -> None:
        self._makers, self._size, self._refresh = (maker, map_maker or maker), size, refresh_steps
        self._kept: dict[tuple[VariantMaker, int, int], Variant] = {}

    def draw(self, building: int, step: int, rng: np.random.Generator) -> tuple[Variant, Variant]:
        """Two different variants of a building from the window at a step."""
        first = step // self._refresh
        self._kept = {key: variant for key, variant in self._kept.items() if key[2] >= first}
        a, b = (first + rng.choice(self._size, 2, replace=False)).tolist()
        return self._get(self._makers[0], building, a), self._get(self._makers[1], building, b)

    def _get(self, maker: VariantMaker, building: int, number: int) -> Variant:
        key = (maker, building, number)
        if key not in self._kept:
            self._kept[key] = maker.make(building, number)
        return self._kept[key]


def pair_masks(
    queries: Sequence[tuple[int, Floats]],
    places: Sequence[tuple[int, Floats]],
    radius_m: float,
    ignore_radius_m: float | None = None,
) -> tuple[torch.Tensor, torch.Tensor | None]:
    """Which pairs are one place, over several buildings; places of two buildings never are.

    Args:
        queries: for each block of rows its building and (b, 3) positions, metres.
        places: the same for each block of columns.
        radius_m: the matching radius.
        ignore_radius_m: pairs between ``radius_m`` and this are neither one place nor two.

    Returns:
        (B, M) bool, positive pairs, and (B, M) bool, pairs to ignore, or None where there can be none.

    """

    def within(limit: float) -> torch.Tensor:
        blocks = [
            [
                positive_pairs(q, p, limit) if qb == pb else np.zeros((len(q), len(p)), dtype=np.bool_)
                for pb, p in places
            ]
            for qb, q in queries
        ]
        return torch.from_numpy(np.block(blocks))

    positive = within(radius_m)
    if ignore_radius_m is None or ignore_radius_m <= radius_m:
        return positive, None
    return positive, within(ignore_radius_m) & ~positive
