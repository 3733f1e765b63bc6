"""Classes that a labelspace lacks, and numbers for classes: told, and refused where a building is mostly these."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.screen import note
from semloc_core.errors import MapError

if TYPE_CHECKING:
    from semloc_core.encoding import Model
    from semloc_core.graph import Labelspace, SceneGraph
    from semloc_core.sources import HydraFile

AllowUnknown = Annotated[
    bool,
    typer.Option(
        "--allow-unknown",
        help="Take buildings too most of whose objects are of classes that the map's model does not know.",
    ),
]

NAMED = 12
"""Class numbers named at most."""


def tell_numbers(path: Path, file: HydraFile, labelspace: Labelspace) -> None:
    """Numbers mean other classes in other files: a person sees at once whether a labelspace is the wrong one."""
    from semloc_core.graph import all_numbers

    numbers = [i for ids in file.labelspace.ids.values() for i in ids] if all_numbers(file.labelspace.classes) else []
    found = [(i, labelspace.name_of(i)) for i in sorted(numbers)]
    named = [f"{i} {name}" for i, name in found if name and not all_numbers([name])]
    if named:
        more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
        note(
            f"{path}: class numbers without names, read as labelspace {labelspace.name} has them: "
            f"{', '.join(named[:NAMED])}{more}"
        )


def report_unknown_classes(unknown: dict[str, int], where: str, labelspace: bool = True) -> None:
    """Say which classes the labelspace lacks: they are counted, never silently dropped.

    Args:
        unknown: class -> objects of it.
        where: the file.
        labelspace: whether ``--labelspace`` could still name classes that are numbers.

    """
    from semloc_core.graph import all_numbers

    if unknown:
        listed = ", ".join(f"{name} ({count})" for name, count in sorted(unknown.items()))
        note(f"{where}: objects of classes that the labelspace lacks are not used: {listed}")
        if labelspace and all_numbers(unknown):
            note(f"{where}: it has numbers in place of class names: --labelspace names them")


def check_classes(graph: SceneGraph, model: Model, where: str, *, allow_unknown: bool, helps: str) -> None:
    """Say which of a building's classes a map's model lacks, and refuse it where most objects are of these.

    Such a building is of another labelspace: in the map it would be one with hardly anything in it.

    Args:
        graph: the building.
        model: of the map.
        where: the file.
        allow_unknown: take it all the same.
        helps: what else helps, in words.

    Raises:
        MapError: the model knows less than `LEAST_KNOWN` of the objects, and that is not allowed.

    """
    from semloc_core.encoding import LEAST_KNOWN
    from semloc_core.graph import count_unknown, listed

    unknown = count_unknown(graph, model.labelspace)
    known, total = len(graph.objects) - sum(unknown.values()), len(graph.objects)
    if not allow_unknown and known < LEAST_KNOWN * total:
        raise MapError(
            f"expected at least {LEAST_KNOWN:.0%} of the objects to be of classes that the map's model knows (got "
            f"{known} of {total} in {where}, and of others {listed(unknown)}; {helps}, --allow-unknown leaves them out)"
        )
    report_unknown_classes(unknown, where, labelspace=False)
