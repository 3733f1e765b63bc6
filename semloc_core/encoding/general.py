"""The general encoder: for buildings of any class names, at once, without training.

Geodesic attention (`semloc_core.encoding.encoder.geodesic_attention`) whose values are the principal directions of
what its heads bring to the places of the map at hand. No list of classes is in it and nothing was learned of a name:
how telling a class is, and at what distance, is read off the map itself, since what all its places share has no
variance, and what tells the most of them apart has the most. (Random codes of class names in their place, the same for
a name in any map, share 64 numbers among hundreds of heads and classes: 0.85 where these directions find 0.95.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from semloc_core.encoding.encoder.geodesic_attention import GeodesicAttentionEncoder
from semloc_core.encoding.model import Model
from semloc_core.encoding.place_graph.reach import reach_all_batch
from semloc_core.errors import ModelError
from semloc_core.graph import Floats, GraphArrays, Labelspace, SceneGraph, labelspace_from_hydra

GENERAL = "general"
TEMPERATURE = 0.003
"""Softmax temperature, as `semloc_core.evaluate.fit_temperature` fits it on generated homes and offices: 0.0020 and
0.0026 for two seeds, 0.005 for homes and 0.002 for offices alone."""
NEAR_M, FADING = 3.0, 0.3
"""A head whose gaze is at d metres counts (NEAR_M / d)^FADING: of what is far a walk has seen little yet. Chosen on
generated homes and offices, whole and in part: 0.83 of the homes' walks are found after 10 m, and 0.53 without it."""
MOST_PLACES = 2048
"""Places that the directions are taken from, at most, spread evenly over the buildings."""
TINY = 1e-9
"""Share of the greatest variance below which a direction is rounding."""
NO_CLASS = "object"
"""Stands for the classes of buildings without an object that has one: a model has a class at least."""


def general_model(buildings: Sequence[GraphArrays | SceneGraph], labelspace: Labelspace | None = None) -> Model:
    """The general encoder for a map of these buildings; the same buildings give the same bytes on a machine.

    Buildings that come to the map later are encoded by what tells the places of these apart.

    Args:
        buildings: one at least; of arrays, classes by index into the labelspace.
        labelspace: the map's classes to be, one without a class too; None: those of the buildings, which are graphs.

    Raises:
        ModelError: no building.

    """
    if not buildings:
        raise ModelError("expected at least one building to fit the general encoder to (got none)")
    graphs = [building for building in buildings if isinstance(building, SceneGraph)]
    if labelspace is None:
        names = sorted({thing.class_ for graph in graphs for thing in graph.objects.values()})
        labelspace = labelspace_from_hydra("own", enumerate(names), ())
    if not labelspace.classes:
        labelspace = replace(labelspace, classes=(NO_CLASS,))
    arrays = [
        GraphArrays.from_scene_graph(building, labelspace) if isinstance(building, SceneGraph) else building
        for building in buildings
    ]
    encoder = GeodesicAttentionEncoder(None, len(labelspace))
    extraction, centres = encoder.extraction, torch.tensor(encoder.config.centres)
    gaze = (NEAR_M / centres.clamp_min(NEAR_M)) ** FADING  # (R,) how much a head counts
    size = [building.n_places for building in arrays]
    first = np.cumsum(size) - size
    taken = np.unique(np.linspace(0, max(sum(size) - 1, 0), min(sum(size), MOST_PLACES)).round().astype(np.int64))
    with torch.no_grad():
        encoder.score.copy_(gaze.log()[:, None].expand_as(encoder.score))
        scale = torch.ones(encoder.value.weight.shape[1])
        scale[encoder.score.numel() :] = gaze
        found = [np.zeros((0, len(scale)))]
        for building, start, count in zip(arrays, first, size, strict=True):
            rows = taken[(taken >= start) & (taken < start + count)] - start
            if len(rows):
                batch = reach_all_batch(building, len(labelspace), extraction.radius_m, rows, extraction.bands)
                found.append((encoder.attended(batch) * scale).double().numpy())
        directions = torch.from_numpy(_principal(np.concatenate(found), encoder.dimension))
        encoder.value.weight.copy_(directions * scale)
        encoder.value.bias.zero_()
    encoder.eval()
    provenance = {"graphs": [building.name for building in arrays], GENERAL: True}
    return Model(encoder, labelspace, temperature=TEMPERATURE, provenance=provenance)


def _principal(found: Floats, dimension: int) -> Floats:
    """Directions (D, F) of the greatest variance of rows (P, F); rows of zeros beyond what varies.

    The sign of each is such that its largest entry is positive. Where nothing varies, the only direction is the mean's.
    """
    apart = found - found.mean(axis=0) if len(found) else found
    if not np.abs(apart).max(initial=0.0) > TINY:
        apart = found[:1]
    few = len(apart) < found.shape[1]
    variance, vectors = np.linalg.eigh(apart @ apart.T if few else apart.T @ apart)
    order = np.argsort(-variance, kind="stable")[:dimension]
    best = order[variance[order] > max(TINY * variance.max(initial=0.0), 0.0)]
    directions = vectors[:, best].T @ apart / np.sqrt(variance[best])[:, None] if few else vectors[:, best].T
    result = np.zeros((dimension, found.shape[1]))
    for row, one in zip(result, directions, strict=False):
        row[:] = one * np.sign(one[np.abs(one).argmax()])
    return result
