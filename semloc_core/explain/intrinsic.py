"""What the encoder itself says of a match, from the pass that made it: attention, or an exact decomposition."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from semloc_core.encoding import Batch, Encoded, Encoder, products, repeat
from semloc_core.explain.scores import ObjectScores


def intrinsic_scores(
    encoder: Encoder, batch: Batch, encoded: Encoded, class_names: Sequence[str], target: Tensor
) -> ObjectScores:
    """Credit the objects around one query place.

    An encoder with attention answers with it (`Encoded.credit`: no further pass). One that only counts is taken
    apart exactly (``closed_form``: the objects' parts sum to the similarity). Any other is asked what each
    object's removal costs (``occlusion``: one batch with as many copies as there are objects).

    Args:
        encoder: the encoder that made ``encoded``.
        batch: one query place, N nodes.
        encoded: what the encoder made of it.
        class_names: N names; those of places are not read.
        target: (D,) embedding of the map place it is compared to.

    """
    objects = torch.from_numpy(np.flatnonzero(batch.is_object.numpy()))
    if encoded.credit is not None:
        method, values = "attention", encoded.credit[objects]
        rest = float(encoded.self_share[0]) if encoded.self_share is not None else None
        gap = None
    else:
        rest = None
        with torch.inference_mode():
            similarity = float(products(encoded.embedding[0], target))
            parts = encoder.contributions(batch, target)
            if parts is not None:
                method, values = "closed_form", parts[objects]
                gap = similarity - float(values.sum())
            else:
                method, values, gap = (
                    "occlusion",
                    _occlusion(encoder, batch, objects, similarity, target),
                    None,
                )
    rows = objects.tolist()
    return ObjectScores(
        method=method,
        ids=tuple([batch.node_ids[i] for i in rows]),
        classes=tuple([class_names[i] for i in rows]),
        scores=np.asarray(values.double().numpy(), dtype=np.float64),
        unattributed=rest,
        completeness_gap=gap,
    )


def _occlusion(encoder: Encoder, batch: Batch, objects: Tensor, similarity: float, target: Tensor) -> Tensor:
    """(O,) loss of similarity when one object is removed."""
    copies, index = repeat(batch, len(objects))
    keep = torch.ones(copies.n_nodes, dtype=torch.bool)
    keep[index[torch.arange(len(objects)), objects]] = False
    without: Tensor = encoder(copies, keep=keep) @ target
    return similarity - without
