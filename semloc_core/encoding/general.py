"""General encoders that semloc ships: trained on generated buildings only, for new buildings without training.

Made by ``make assets`` (`tools/make_assets.sh`); one for a labelspace.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path

from semloc_core.encoding.model import Model
from semloc_core.errors import ModelError
from semloc_core.graph import advice, all_numbers, listed
from semloc_core.text import percent

FOLDER = Path(str(resources.files("semloc_core.encoding"))) / "general_models"
LEAST_KNOWN = 0.5
"""Share of a building's objects whose classes a general encoder must know to be taken for it unasked."""


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


def pick_general(objects: Mapping[str, int], *, least_known: float = LEAST_KNOWN) -> tuple[str, Model, int]:
    """The general encoder that knows the most of a building's objects; of equal ones that of fewest classes.

    Args:
        objects: how many objects of each class there are.
        least_known: share of them that it must know; one of them at least.

    Returns:
        its name, the model, how many objects it knows. Its labelspace has no numbers: nobody who chose it said that
        its numbers are the building's.

    Raises:
        ModelError: none knows enough of them, or there are none.

    """
    found = [(name, load_general(name)) for name in general_models()]
    for _, model in found:
        model.labelspace = replace(model.labelspace, ids={})
    known = {
        name: sum(count for class_, count in objects.items() if model.labelspace.index(class_) >= 0)
        for name, model in found
    }
    total = sum(objects.values())
    best = max(found, key=lambda pair: (known[pair[0]], -len(pair[1].labelspace)), default=None)
    if best is None or not known[best[0]] or known[best[0]] < least_known * total:
        names = ", ".join(known) or "none"
        raise ModelError(
            f"expected --model, or a building of which a general encoder ({names}) knows "
            f"{f'at least {percent(least_known)} of the objects' if least_known else 'an object'} "
            f"(got {_unknown(objects, known, best) if best and total else 'none'})"
        )
    return best[0], best[1], known[best[0]]


def _unknown(objects: Mapping[str, int], known: Mapping[str, int], best: tuple[str, Model]) -> str:
    """What the best general encoder does not know of a building, and what helps."""
    name, model = best
    lacks = {class_: count for class_, count in objects.items() if model.labelspace.index(class_) < 0}
    helps = advice(lacks)
    if not all_numbers(lacks):
        helps = f"semloc train makes a model of the building's own classes, {helps}"
    return f"{known[name]} of {sum(objects.values())} known to {name}, none of {listed(lacks)}; {helps}"
