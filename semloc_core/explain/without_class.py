"""What the answer would be if the robot had seen nothing of a class: the whole question, asked again."""

from __future__ import annotations

import numpy as np
import torch

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.encoding import PerturbedEncoder
from semloc_core.explain.layout_scores import layout_attributions
from semloc_core.matching import LayoutVerifier, Located, confidence, status_of, verifier_of
from semloc_core.wire import WithoutClass

MOST = 8
"""Classes asked about: each costs as much as an answer."""


def without_classes(
    located: Located, perturbed: PerturbedEncoder, accept_probability: float, most: int = MOST
) -> list[WithoutClass]:
    """Take away one class after another, and answer by similarity and layout.

    A filter has no say: what it would have made of an update without the class depends on all updates before.

    Args:
        located: an answer that was put to the test.
        perturbed: embeds variants of its query.
        accept_probability: from which on an answer is a ``match``.
        most: classes; those seen whose share in the test is largest.

    Returns:
        One entry a class, by falling share.

    """
    verifier, names = verifier_of(located.map), located.map.model.labelspace.classes
    assert verifier is not None, "expected the map of an answer that was put to the test"
    assert located.evidence is not None, "expected an answer that was put to the test"
    said = layout_attributions(located.evidence, names).classes
    seen = [of.class_ for of in said if of.instances and of.class_ in names][:most]
    return [_without(located, perturbed, verifier, names.index(name), accept_probability) for name in seen]


def _without(
    located: Located, perturbed: PerturbedEncoder, verifier: LayoutVerifier, class_: int, accept: float
) -> WithoutClass:
    loaded, evidence, labelspace = located.map, located.evidence, located.map.model.labelspace
    assert evidence is not None
    fragment = evidence.fragment.without(class_)
    stays = [not name or labelspace.index(name) != class_ for name in located.query.class_names]
    z = perturbed.embed(keep=torch.tensor([stays]))[0].numpy()
    found = verifier.verify(fragment, loaded.index.everywhere(z, 1)[2])
    name = labelspace.classes[class_]
    if found is None:
        return WithoutClass(class_=name, map=None, place=None, probability=0.0, same=False, status="unknown")
    sure = confidence(found, fragment, verifier.mapped)
    first = int(sure.order[0])
    row = int(found.rows[first])
    off = np.linalg.norm(loaded.positions[row] - loaded.positions[evidence.row])
    on, probability = loaded.storey_index, float(sure.probability[first])
    return WithoutClass(
        class_=name,
        map=loaded.buildings[int(loaded.building_index[row])],
        place=loaded.place_ids[row],
        probability=probability,
        same=bool(on[row] == on[evidence.row] and off <= MATCH_RADIUS_M),
        status=status_of(probability, accept, sure.in_map),
    )
