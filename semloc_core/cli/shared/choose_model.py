"""Which encoder a map is built with: the one named, or else one that knows the buildings' classes, in a line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_core.cli.shared.common import note, read_graph

if TYPE_CHECKING:
    from semloc_core.encoding import Model
    from semloc_core.graph import Reading


def choose_model(named: str | None, inputs: Sequence[Path], reading: Reading, *, allow_unknown: bool) -> Model:
    """The encoder for these buildings; its labelspace is told what the person said.

    Args:
        named: a model file, or the name of a general encoder; None: the general one that knows the most of
            each building's classes, else `rings` with the classes that the files have.
        inputs: graphs or runs.
        reading: what the person said of their labels.
        allow_unknown: take the best general encoder, though it knows few of the objects.

    Raises:
        ModelError: no such model.
        LabelspaceError: a synonym of a class that the model does not have.

    """
    from semloc_core.encoding import LEAST_KNOWN, load_model, own_classes, pick_general

    if named is not None:
        model = load_model(named)
    else:
        files = [read_graph(path, reading) for path in inputs]
        objects = [Counter(thing.class_ for thing in file.graph.objects.values()) for file in files]
        found = pick_general(objects, least_known=0.0 if allow_unknown else LEAST_KNOWN)
        total = sum(one.total() for one in objects)
        if found is None:
            model = own_classes(reading.classes_of([file.labelspace for file in files]))
            note(
                f"no --model: {total} objects in {len(model.labelspace)} classes of the files' own names, of which the "
                "general encoders know too few: encoded by 'rings', which knows any name; semloc train makes a model"
            )
            return model
        name, model, known = found
        note(
            f"no --model: the general encoder '{name}' is used, which was trained on generated buildings; it knows "
            f"{known} of {total} objects. To fit it to these buildings: semloc train GRAPH --start {name}"
        )
    model.labelspace = reading.with_known(model.labelspace).space or model.labelspace
    return model
