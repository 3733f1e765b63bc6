"""General encoders that semloc ships: trained on generated buildings only, for new buildings without training.

Made by ``make assets`` (`tools/make_assets.sh`); one for a labelspace.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.errors import ModelError
from semloc_core.graph import Labelspace

FOLDER = Path(str(resources.files("semloc_core.encoding"))) / "general_models"
LEAST_KNOWN = 0.5
"""Share of a building's objects whose classes a general encoder must know to be taken for it unasked."""
RINGS_TEMPERATURE = 0.01
"""Softmax temperature of rings, as fitted on 32 generated homes and offices (`semloc train --encoder rings`)."""


def general_models() -> tuple[str, ...]:
    """Names of the shipped general encoders, each that of its labelspace."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.model")))


def load_general(name: str) -> Model:
    """A shipped general encoder.

    Raises:
        ModelError: there is none of this name.

    """
    if name not in general_models():
        raise ModelError(f"expected a general encoder among {', '.join(general_models()) or 'none'} (got '{name}')")
    return Model.load(FOLDER / f"{name}.model")


def load_model(name_or_path: str) -> Model:
    """A shipped general encoder by name, or a model file.

    Raises:
        ModelError: neither, or the file is not right.

    """
    return load_general(name_or_path) if name_or_path in general_models() else Model.load(name_or_path)


def pick_general(
    buildings: Sequence[Mapping[str, int]], *, least_known: float = LEAST_KNOWN
) -> tuple[str, Model, int] | None:
    """The general encoder that knows the most of some buildings' objects; of equal ones that of fewest classes.

    Args:
        buildings: how many objects of each class there are in each.
        least_known: share of each building's objects that it must know; one object at least.

    Returns:
        its name, the model, how many objects it knows; None where none knows enough. Its labelspace has no numbers:
        nobody who chose it said that its numbers are the buildings'.

    """
    best: tuple[str, Model, int] | None = None
    for name in general_models():
        model = load_general(name)
        space = model.labelspace = replace(model.labelspace, ids={})
        known = [sum(n for class_, n in one.items() if space.index(class_) >= 0) for one in buildings]
        enough = all(k >= least_known * sum(one.values()) for k, one in zip(known, buildings, strict=True))
        total = sum(known)
        if enough and total and (best is None or (total, -len(space)) > (best[2], -len(best[1].labelspace))):
            best = name, model, total
    return best


def own_classes(space: Labelspace) -> Model:
    """The encoder for classes that no general one knows: soft rings, with nothing to train, of any classes.

    Args:
        space: the buildings' own; one without a class stands for buildings without an object.

    """
    space = space if space.classes else replace(space, classes=("object",))
    return Model(build_encoder("rings", None, len(space)), space, temperature=RINGS_TEMPERATURE)
