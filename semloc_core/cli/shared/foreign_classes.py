"""Classes that a labelspace lacks, and numbers for classes: told, and refused where a building is mostly these."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.screen import note
from semloc_core.errors import MapError

LEAST_KNOWN = 0.5
"""Share of a building's objects whose classes a map's model must know to take it unasked."""

if TYPE_CHECKING:
    from collections.abc import Mapping

    from semloc_core.graph import Labelspace, Reading, SceneGraph

AllowUnknown = Annotated[
    bool,
    typer.Option(
        "--allow-unknown",
        help="Take buildings too most of whose objects are of classes that the map's model does not know.",
    ),
]


def report_unknown_classes(unknown: Mapping[str, int], where: str, *, advise: bool = True) -> None:
    """Say which classes the labelspace lacks: they are counted, never silently dropped.

    Args:
        unknown: class -> objects of it.
        where: the file.
        advise: say which option helps.

    """
    from semloc_core.graph import advice

    if unknown:
        listed = ", ".join(f"{name} ({count})" for name, count in sorted(unknown.items()))
        helps = f"; {advice(unknown)}" if advise else ""
        note(f"{where}: objects of classes that the labelspace lacks are not used: {listed}{helps}")


def tell_numbers(space: Labelspace, reading: Reading) -> None:
    """Say that all classes are numbers, where the person did not say what they mean."""
    if reading.said is None and space.classes and all(name.startswith("class_") for name in space.classes):
        from semloc_core.graph import advice

        note(f"the graphs have numbers in place of class names: {advice(space.classes)}")


def check_classes(graph: SceneGraph, space: Labelspace, where: str, *, allow_unknown: bool) -> None:
    """Say which of a building's classes a labelspace lacks, and refuse it where most objects are of these.

    Such a building is of another labelspace: in the map it would be one with hardly anything in it.

    Args:
        graph: the building.
        space: of the map's model, or of the model to be.
        where: the file.
        allow_unknown: take it all the same.

    Raises:
        MapError: it knows less than `LEAST_KNOWN` of the objects, and that is not allowed.

    """
    from semloc_core.graph import advice, count_unknown, is_nameless, listed

    unknown = count_unknown(graph, space)
    total = sum(not is_nameless(thing.class_) for thing in graph.objects.values())
    known = total - sum(unknown.values())
    if not allow_unknown and known < LEAST_KNOWN * total:
        raise MapError(
            f"expected at least {LEAST_KNOWN:.0%} of the objects to be of classes that the map's model knows (got "
            f"{known} of {total} in {where}, and of others {listed(unknown)}; {advice(unknown)}, "
            "--allow-unknown leaves them out)"
        )
    report_unknown_classes(unknown, where)
