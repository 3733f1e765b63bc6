"""How training begins: pairs of views for an encoder's warm start, or another model's weights."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from semloc_core.encoding import Encoder, Model, Pairs
from semloc_core.errors import TrainingError
from semloc_core.graph import Floats, Labelspace
from semloc_core.training.views.variants import VariantMaker

SAME_PLACE_M = 3.0
"""Two places of two variants are views of one where they are nearest and no farther apart than this, metres."""
FRAGMENT_WEIGHT = 0.3
"""How much a pair of a fragment and the whole counts beside one of two wholes."""


def view_pairs(makers: tuple[VariantMaker, VariantMaker], n_buildings: int, variants: int) -> Iterator[Pairs]:
    """Pairs of variants of every building, and of fragments with them.

    Args:
        makers: of variants that ask, and of those that are asked.
        n_buildings: how many buildings they know.
        variants: pairs of each.

    """
    for building in range(n_buildings):
        for k in range(variants):
            query, reference = makers[0].make(building, 2 * k), makers[1].make(building, 2 * k + 1)
            yield Pairs(query.batch, reference.batch, _nearest(query.positions, reference.positions))
            if query.fragments is not None:
                nearest = _nearest(query.fragments.positions, reference.positions)
                yield Pairs(query.fragments.batch, reference.batch, nearest, FRAGMENT_WEIGHT)


def take_over(encoder: Encoder, start: Model, labelspace: Labelspace) -> None:
    """Begin with another model's weights.

    Args:
        encoder: gets them.
        start: has them.
        labelspace: what the encoder is to be trained in.

    Raises:
        TrainingError: another labelspace or encoder, or one without weights.

    """
    if start.labelspace.hash != labelspace.hash:
        raise TrainingError(f"expected the start's labelspace {start.labelspace.name} (got {labelspace.name})")
    if not encoder.trainable:
        raise TrainingError(f"expected an encoder with weights to go on from (got '{encoder.name}', which has none)")
    if start.encoder.name != encoder.name or start.encoder.config != encoder.config:
        raise TrainingError(f"expected the start's encoder '{start.encoder.name}' and its options (got another)")
    encoder.load_state_dict(start.encoder.state_dict())


def _nearest(queries: Floats, places: Floats) -> Tensor:
    """(B,) index of the nearest place, -1 where there is none within `SAME_PLACE_M`."""
    if not len(places):
        return torch.full((len(queries),), -1)
    distance, nearest = torch.cdist(torch.from_numpy(queries), torch.from_numpy(places)).min(1)
    return torch.where(distance <= SAME_PLACE_M, nearest, -1)
