"""What an object's weight is, and how encoders see it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from semloc_core.labelspace import Labelspace
from semloc_core.map_database.history import ClassChange, History, ObjectBelief, move_rates
from semloc_core.scene_graph import SceneGraph


def object_weights(
    graph: SceneGraph,
    labelspace: Labelspace,
    history: History,
    others: Iterable[Mapping[str, ClassChange]] = (),
) -> dict[str, float]:
    """Weight in (0, 1] of each object: the probability that the next traversal will find it where the map has it.

    That is its persistence times the share of its class that stays (the paper's third hypothesis: mobile objects are
    weighed down as traversals show them to move). Empty for a building that was never merged: all weigh the same.

    Args:
        graph: the building.
        labelspace: joins another detector's names to the map's.
        history: what traversals told of it.
        others: class changes of the map's other buildings.

    """
    if not history.traversals:
        return {}
    names = {key: class_name(thing.class_, labelspace) for key, thing in graph.objects.items()}
    rates = move_rates([history.classes, *others], names.values())
    unknown = ObjectBelief()
    return {key: history.objects.get(key, unknown).persistence * (1.0 - rates[name]) for key, name in names.items()}


def class_name(name: str, labelspace: Labelspace) -> str:
    """The labelspace's own name of a class; as it is where the labelspace lacks it."""
    index = labelspace.index(name)
    return labelspace.classes[index] if index >= 0 else name
