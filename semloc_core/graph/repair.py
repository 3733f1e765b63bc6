"""What can be mended in a scene graph that was read, and what in it will hurt: a line each for the person. No torch."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from semloc_core.graph.geodesic import connected
from semloc_core.graph.scene_graph import SceneGraph

HANG_M = 4.0
"""How far from a place an object may be that is hung on it, metres."""
NAMED = 8
"""Objects, or parts of a graph, named at most."""


def hang_objects(graph: SceneGraph, objects: Iterable[str]) -> list[str]:
    """Give objects an edge to the nearest place (3D; of equal ones that with the first id) within `HANG_M`.

    Args:
        graph: changed in place.
        objects: ids of its objects.

    Returns:
        Those that are out of reach of all places, sorted; they are left as they are.

    """
    objects = sorted(objects)
    ids = sorted(graph.places, key=lambda place: (graph.places[place][0], place))
    positions = np.array([graph.places[place] for place in ids], dtype=np.float64).reshape(-1, 3)
    edges, left = [], []
    for child in objects:
        position = np.array(graph.objects[child].position)
        first, last = np.searchsorted(positions[:, 0], (position[0] - HANG_M, position[0] + HANG_M))
        away = np.sqrt(((positions[first : last + 1] - position) ** 2).sum(axis=1))
        if not len(away) or away.min() > HANG_M:
            left.append(child)
            continue
        nearest = min(ids[first + row] for row in np.flatnonzero(away == away.min()))
        edges.append((nearest, child))
    if edges:
        graph.amend(edges=edges)
    return left


def mend(graph: SceneGraph, on_other_places: Iterable[str] = ()) -> list[str]:
    """Hang objects without a place, and say so; say what else will hurt.

    Args:
        graph: changed in place.
        on_other_places: objects that hang on places which the graph does not have (2D ones), for the words.

    Returns:
        Lines for the person; none where nothing was to be said.

    """
    lines = []
    others = set(on_other_places)
    orphans = {child for child, parents in graph.parents.items() if not parents and child not in graph.sightings}
    if graph.places:
        for which, why in ((orphans - others, "without an edge to a place"), (orphans & others, "on 2D places")):
            if which:
                left = hang_objects(graph, which)
                lines.append(f"{_objects(len(which))} {why}: {_hung(graph, len(which), left)}")
        lines += _parts_line(graph)
        if not graph.objects:
            lines.append("no objects: there is nothing to tell its places apart by")
    return lines


def _objects(count: int) -> str:
    return f"{count} object{'s' if count != 1 else ''}"


def _hung(graph: SceneGraph, count: int, left: Sequence[str]) -> str:
    done = f"{count - len(left)} now hang{'s' if count - len(left) == 1 else ''} on the nearest one"
    if not left:
        return done
    named = ", ".join(f"{graph.objects[child].class_} {child}" for child in left[:NAMED])
    more = f" and {len(left) - NAMED} more" if len(left) > NAMED else ""
    verb = "is" if len(left) == 1 else "are"
    return f"{done}, {len(left)} {verb} more than {HANG_M:g} m from all and not used: {named}{more}"


def _parts_line(graph: SceneGraph) -> list[str]:
    sizes = sorted(map(len, connected(graph.neighbours)), reverse=True)
    if len(sizes) < 2:
        return []
    listed = ", ".join(map(str, sizes[:NAMED])) + (f" and {len(sizes) - NAMED} smaller" if len(sizes) > NAMED else "")
    return [f"the places are in {len(sizes)} parts without an edge between, of {listed} places"]
