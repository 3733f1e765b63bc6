"""What to expect of a map, in words: twins, storeys, how many objects a place has and how many it needs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from semloc_core.cli.shared.screen import cut, many
from semloc_core.text import percent

if TYPE_CHECKING:
    from semloc_core.map_database import ReadableMap
    from semloc_core.metrics import Row

REPEATS = 0.7
"""Share of a storey's places that are like another one far off on it, from which on it is said to repeat itself."""


def good_for(map_: ReadableMap, model: str) -> tuple[list[str], list[Row]]:
    """What to expect of a map, in sentences; and in figures, a row a building and one for all."""
    import numpy as np

    from semloc_core.evaluate import MOST_SEEN, SEEN_M, look_alikes
    from semloc_core.graph import storeys_of

    parts = [map_.building(building)[1] for building in map_.buildings]
    graphs = [map_.graph(building) for building in map_.buildings]
    known = [storeys_of(graph) for graph in graphs]
    on = [np.array([of[id_] for id_ in part.ids]) for part, of in zip(parts, known, strict=True)]
    keys = np.concatenate([np.column_stack([np.full(len(each), b), each]) for b, each in enumerate(on)])
    floors, floor = np.unique(keys, axis=0, return_inverse=True)
    several = [len(np.unique(each)) > 1 for each in on]
    names = [
        f"{cut(map_.buildings[b])}, storey {storey + 1}" if several[b] else cut(map_.buildings[b])
        for b, storey in floors.tolist()
    ]
    found = look_alikes(
        np.concatenate([part.embeddings for part in parts]),
        np.concatenate([part.positions for part in parts]),
        floor.reshape(-1),
        [(len(part.ids), graph) for part, graph in zip(parts, graphs, strict=True)],
    )
    rooms = [name for name, share in zip(names, found.doubled.tolist(), strict=True) if share >= REPEATS]
    twins = [" = ".join(names[f] for f in group) for group in found.twins]
    half, most = found.needed
    bare = int((found.near == 0).sum())
    said = [
        f"Storeys: {sum(several)} of {many(len(several), 'building')} {'has' if sum(several) == 1 else 'have'} several."
        if any(several)
        else "Storeys: one in each building."
        if len(several) > 1
        else "Storeys: one.",
        f"Look-alikes: {'; '.join(twins)}. Expect `ambiguous` there until the robot has seen what differs, if anything "
        "does; naming the building, or the filter, helps."
        if twins
        else "Look-alikes: no building or storey is the twin of another."
        if len(floors) > 1
        else "Look-alikes: no other building or storey is in this map"
        + ("." if rooms else f"; of this one's places {percent(found.doubled[0])} are like another far off in it."),
    ]
    if rooms:
        itself = "repeats itself" if len(rooms) == 1 else "repeat themselves"
        said.append(
            f"Look-alikes within: {'; '.join(rooms)} {itself}: most places there are like another far off: expect to "
            "drive some metres before a `match`."
        )
    said.append(
        f"Objects: half of the places have {int(np.median(found.near))} or more within {SEEN_M:g} m"
        + (
            f"; {bare} of {len(found.near)} have none: a robot that starts there has nothing to go by."
            if bare
            else "; none has none."
        )
    )
    if half is None:
        said.append(f"Needs: the classes of the {MOST_SEEN} nearest objects do not tell half of the places apart.")
    else:
        nine = f"{most} tell nine in ten" if most is not None else f"{MOST_SEEN} do not tell nine in ten"
        said.append(
            f"Needs: {classes_of(half)} half of the places from all others, "
            f"{nine}; fewer are enough where distances tell, more are needed where objects moved."
        )
    near = np.split(found.near, np.cumsum([len(part.ids) for part in parts])[:-1])
    rows: list[Row] = []
    for b in range(len(parts)):
        own = {f for f in range(len(floors)) if floors[f][0] == b}
        others = [names[f] for group in found.twins if own & set(group) for f in group if f not in own or several[b]]
        rows.append(
            {
                "objects_near_p50": float(np.median(near[b])),
                "places_without_objects": int((near[b] == 0).sum()),
                "twins": ", ".join(others),
            }
        )
    rows.append({"method": model, "scope": "all", "objects_needed_p50": half, "objects_needed_p90": most})
    return said, rows


def classes_of(nearest: int) -> str:
    """The nearest objects by number, and the verb that follows."""
    return (
        "the class of the nearest object tells"
        if nearest == 1
        else f"the classes of the {nearest} nearest objects tell"
    )
