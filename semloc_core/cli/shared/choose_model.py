"""Which encoder a map is built with: the one of a file, or else the general one, and a line that says so."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_core.cli.shared.common import building_name, note, read_graph
from semloc_core.cli.shared.foreign_classes import tell_numbers
from semloc_core.cli.shared.screen import many

if TYPE_CHECKING:
    from semloc_core.encoding import Model
    from semloc_core.graph import Reading


def choose_model(named: str | None, inputs: Sequence[Path], reading: Reading) -> Model:
    """The encoder for these buildings; its labelspace is told what the person said.

    Args:
        named: a model file; `GENERAL` or None: the general encoder, of the buildings' own classes and fitted to them.
        inputs: graphs or runs.
        reading: what the person said of their labels.

    Raises:
        ModelError: no such model.
        LabelspaceError: a synonym of a class that the model does not have.

    """
    from semloc_core.encoding import GENERAL, Model, general_model
    from semloc_core.graph import GraphArrays

    if named not in (None, GENERAL):
        model = Model.load(named)
        model.labelspace = reading.with_known(model.labelspace).space or model.labelspace
        return model
    files = [read_graph(path, reading) for path in inputs]
    space = reading.classes_of([file.labelspace for file in files])
    tell_numbers(space, reading)
    model = general_model(
        [GraphArrays.from_scene_graph(f.graph, space, building_name(p)) for p, f in zip(inputs, files, strict=True)],
        space,
    )
    if named is None:
        note(f"no --model: the general encoder, fitted to {many(len(space), 'class', 'classes')} of the buildings' own")
    return model
