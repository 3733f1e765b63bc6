"""What objects weigh by now: those that persist more than those that went missing, classes that stay more than others.

The paper's third hypothesis, used: mobile objects count less once traversals have shown that they move. A map's
embeddings are made with these weights and a query is weighed by class alike: weighing one side only would make every
place with mobile objects look unlike itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from semloc_core.graph import Labelspace, SceneGraph
from semloc_core.map_database.history import ClassChange, History, ObjectBelief, move_rates


def class_weights(changes: Iterable[Mapping[str, ClassChange]], labelspace: Labelspace) -> dict[str, float]:
    """Weight in (0, 1] of each class of the labelspace: the share of its objects that stays until the next traversal.

    Args:
        changes: class changes of all buildings of the map; where none is known, all classes weigh 1.
        labelspace: of the map's model.

    """
    known = [by_class for by_class in changes if by_class]
    if not known:
        return dict.fromkeys(labelspace.classes, 1.0)
    rates = move_rates(known, labelspace.classes)
    return {name: 1.0 - rates[name] for name in labelspace.classes}


def object_weights(
    graph: SceneGraph, labelspace: Labelspace, history: History, of_class: Mapping[str, float]
) -> dict[str, float]:
    """Weight in [0, 1] of each object: the probability that the next traversal will find it where the map has it.

    Args:
        graph: the building.
        labelspace: joins another detector's names to the map's.
        history: what traversals told of it; a building that was never merged has objects of equal persistence.
        of_class: of `class_weights`.

    """
    persistence = {key: belief.persistence for key, belief in history.objects.items()}
    usual = ObjectBelief().persistence if history.traversals else 1.0
    return {
        key: persistence.get(key, usual) * of_class.get(labelspace.canonical(thing.class_), 1.0)
        for key, thing in graph.objects.items()
    }
