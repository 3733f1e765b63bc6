"""Which encoder a map is built with: the one named, or else a shipped general one, and a line that says so."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_core.cli.shared.common import join_synonyms, note, read_graph_or_run

if TYPE_CHECKING:
    from semloc_core.encoding import Model
    from semloc_core.graph import Labelspace


def choose_model(
    named: str | None, inputs: Sequence[Path], labelspace: Labelspace | None, synonyms: Path | None
) -> Model:
    """The encoder for these buildings.

    Args:
        named: a model file, or the name of a general encoder; None: the general one for the buildings' classes.
        inputs: graphs or runs.
        labelspace: what class numbers mean in files without names; the model's own where it is None.
        synonyms: a synonym file, which the model is told.

    Raises:
        ModelError: no such model, or none named and no general one knows enough of the objects.

    """
    from semloc_core.encoding import load_model, pick_general
    from semloc_core.graph import Labelspace, load_synonyms

    if named is not None:
        model = load_model(named)
    else:
        names = labelspace or Labelspace("none", ())
        graphs = [read_graph_or_run(path, names) for path in inputs]
        known_as = load_synonyms(synonyms) if synonyms is not None else {}
        found = (thing.class_ for graph in graphs for thing in graph.objects.values())
        objects = Counter(known_as.get(class_, class_) for class_ in found)
        name, model, known = pick_general(objects)
        note(
            f"no --model: the general encoder '{name}' is used, which was trained on generated buildings; it knows "
            f"{known} of {objects.total()} objects. To fit it to these buildings: semloc train GRAPH --start {name}"
        )
    join_synonyms(model, synonyms)
    if labelspace is not None:
        model.labelspace = model.labelspace.with_ids_of(labelspace)
    return model
