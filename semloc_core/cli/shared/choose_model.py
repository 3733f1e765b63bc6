"""Which encoder a map is built with: the one named, or else a shipped general one, and a line that says so."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_core.cli.shared.common import note, read_graph_or_run

if TYPE_CHECKING:
    from semloc_core.encoding import Model
    from semloc_core.graph import Reading


def choose_model(named: str | None, inputs: Sequence[Path], reading: Reading, *, allow_unknown: bool) -> Model:
    """The encoder for these buildings; its labelspace is told what the person said.

    Args:
        named: a model file, or the name of a general encoder; None: the general one for the buildings' classes.
        inputs: graphs or runs.
        reading: what the person said of their labels.
        allow_unknown: take the best general encoder, though it knows few of the objects.

    Raises:
        ModelError: no such model, or none named and no general one knows enough of the objects.
        LabelspaceError: a synonym of a class that the model does not have.

    """
    from semloc_core.encoding import LEAST_KNOWN, load_model, pick_general

    if named is not None:
        model = load_model(named)
    else:
        graphs = [read_graph_or_run(path, reading) for path in inputs]
        objects = Counter(thing.class_ for graph in graphs for thing in graph.objects.values())
        name, model, known = pick_general(objects, least_known=0.0 if allow_unknown else LEAST_KNOWN)
        note(
            f"no --model: the general encoder '{name}' is used, which was trained on generated buildings; it knows "
            f"{known} of {objects.total()} objects. To fit it to these buildings: semloc train GRAPH --start {name}"
        )
    model.labelspace = reading.with_known(model.labelspace).space or model.labelspace
    return model
