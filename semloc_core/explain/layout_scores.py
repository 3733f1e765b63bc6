"""What classes and objects add to the test by layout, which decides where it is on."""

from __future__ import annotations

from collections.abc import Sequence

from semloc_core.explain.scores import by_share
from semloc_core.matching import Evidence
from semloc_core.wire import NAMELESS, MethodAttributions, ObjectAttribution

LAYOUT = "layout"
"""The explainer's name."""


def layout_attributions(evidence: Evidence, names: Sequence[str]) -> MethodAttributions:
    """Credit the objects around the robot with what each adds to the score of a place that was put to the test.

    The score is a log-likelihood ratio in nats (`matching.layout.pose.align`), and a sum: an object's score is what the
    mapped object that it is taken for makes more likely, at least 0; a class's is the sum over its objects, less what
    is lost for mapped objects of the class that should have been seen and were not, so it may be below 0, or have no
    object at all. Nothing is estimated, so there is no fidelity to be tested. Known places where the map has no room
    belong to no class: ``walls``, at most 0.

    Args:
        evidence: the score taken apart.
        names: of the classes.

    Returns:
        The attributions, objects by falling score.

    """
    seen = evidence.fragment
    of_objects = [
        ObjectAttribution(id=id_, class_=names[class_] if class_ >= 0 else NAMELESS, score=nats, mapped=mapped)
        for id_, class_, nats, mapped in zip(
            seen.object_ids, seen.classes.tolist(), evidence.explained.tolist(), evidence.mapped, strict=True
        )
    ]
    missed = [ObjectAttribution(id=of.id, class_=names[of.class_], score=-of.lost) for of in evidence.missed]
    total: dict[str, float] = {}
    instances: dict[str, int] = {}
    for of in (*missed, *of_objects):
        total[of.class_] = total.get(of.class_, 0.0) + of.score
        instances.setdefault(of.class_, 0)
    for of in of_objects:
        instances[of.class_] += 1
    return MethodAttributions(
        method=LAYOUT,
        classes=by_share(total, instances),
        objects=sorted(of_objects, key=lambda of: (-of.score, of.id)),
        fidelity=None,
        completeness_gap=evidence.score - sum(total.values()) + evidence.walls,
        missed=missed,
        walls=-evidence.walls,
    )
