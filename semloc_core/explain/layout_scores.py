"""What classes and objects add to the test by layout, which decides where it is on."""

from __future__ import annotations

from semloc_core.errors import SemlocError
from semloc_core.explain.scores import by_share
from semloc_core.matching import Located
from semloc_core.wire import MethodAttributions, ObjectAttribution

LAYOUT = "layout"
"""The explainer's name."""


def layout_attributions(located: Located) -> tuple[MethodAttributions, float]:
    """Credit the objects around the robot with what each adds to the score of the published place.

    The score is a log-likelihood ratio in nats (`matching.layout.pose.align`), and a sum: an object's score is what the
    mapped object that it is taken for makes more likely, at least 0; a class's is the sum over its objects, less what
    is lost for mapped objects of the class that should have been seen and were not, so it may be below 0, or have no
    object at all. Nothing is estimated, so there is no fidelity to be tested.

    Args:
        located: an answer that was put to the test.

    Returns:
        The attributions, objects by falling score, and what belongs to no class: known places where the map has no
        room, at most 0.

    Raises:
        SemlocError: the published place was not put to the test.

    """
    evidence = located.evidence
    if evidence is None:
        raise SemlocError("expected an answer that was put to the test by layout (got one that was not)")
    names = located.map.model.labelspace.classes
    seen = evidence.fragment
    of_objects = list(zip(seen.object_ids, seen.classes.tolist(), evidence.explained.tolist(), strict=True))
    total = {names[class_]: -nats for class_, nats in evidence.missing.items()}
    instances = dict.fromkeys(total, 0)
    for _, class_, nats in of_objects:
        name = names[class_]
        total[name] = total.get(name, 0.0) + nats
        instances[name] = instances.get(name, 0) + 1
    return MethodAttributions(
        method=LAYOUT,
        classes=by_share(total, instances),
        objects=[
            ObjectAttribution(id=id_, class_=names[class_], score=nats)
            for id_, class_, nats in sorted(of_objects, key=lambda of: (-of[2], of[0]))
        ],
        fidelity=None,
        completeness_gap=evidence.score - sum(total.values()) + evidence.walls,
    ), -evidence.walls
