"""Hypothesis strategies for scene-graph updates over few ids and a small grid, so that clashes and ties occur."""

from collections.abc import Sequence

from hypothesis import strategies as st

from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.wire import Object, Place, SceneGraphUpdate

PLACES = tuple(f"p{i}" for i in range(7))
OBJECTS = tuple(f"o{i}" for i in range(4))
CLASSES = ("chair", "couch", "box", "unheard-of")

positions = st.tuples(st.integers(0, 3).map(float), st.integers(0, 3).map(float), st.sampled_from([0.0, 0.0, 0.1]))
places = st.builds(Place, id=st.sampled_from(PLACES), position=positions)
named = st.one_of(
    st.tuples(st.sampled_from(CLASSES), st.none()),
    st.tuples(st.just("chair"), st.sampled_from([{"chair": 0.5, "box": 0.25}, {"chair": 0.5, "couch": 0.5}])),
)
objects = st.builds(
    lambda id_, position, size, name: Object(id_, name[0], position, size, name[1]),
    st.sampled_from(OBJECTS),
    positions,
    st.one_of(st.none(), st.just((1.0, 0.5, 0.2))),
    named,
)


def update(
    places: Sequence[Place] = (),
    objects: Sequence[Object] = (),
    edges: Sequence[tuple[str, str]] = (),
    *,
    full: bool = False,
    query_place: str | None = None,
    sightings: Sequence[tuple[str, str]] = (),
    removed_nodes: Sequence[str] = (),
    removed_edges: Sequence[tuple[str, str]] = (),
    seq: int = 0,
) -> SceneGraphUpdate:
    """An update with what is given; the rest empty."""
    return SceneGraphUpdate(
        schema="semloc/scene_graph_update/1",
        stamp_ns=0,
        frame_id="map",
        seq=seq,
        full=full,
        places=list(places),
        objects=list(objects),
        edges=list(edges),
        query_place=query_place,
        sightings=list(sightings),
        removed_nodes=list(removed_nodes),
        removed_edges=list(removed_edges),
    )


@st.composite
def any_updates(draw: st.DrawFn) -> SceneGraphUpdate:
    """Updates of which most break a rule somewhere."""
    node = st.sampled_from(PLACES + OBJECTS)
    pairs = st.lists(st.tuples(node, node), max_size=4)
    return update(
        draw(st.lists(places, max_size=4)),
        draw(st.lists(objects, max_size=2)),
        draw(pairs),
        full=draw(st.booleans()),
        query_place=draw(st.one_of(st.none(), node)),
        sightings=draw(st.lists(st.tuples(node, node), max_size=1)),
        removed_nodes=draw(st.lists(node, max_size=3)),
        removed_edges=draw(pairs),
    )


@st.composite
def valid_updates(draw: st.DrawFn, graph: SceneGraph | None = None, full: bool | None = None) -> SceneGraphUpdate:
    """Updates that fit a graph; removals mostly of what is there."""
    graph = graph or SceneGraph()
    whole = draw(st.sampled_from([False] * 4 + [True])) if full is None else full
    new_places = draw(st.lists(places, max_size=4, min_size=3 if whole else 0, unique_by=lambda p: p.id))
    new_objects = draw(st.lists(objects, max_size=2, min_size=1 if whole else 0, unique_by=lambda o: o.id))
    gone = draw(st.lists(st.sampled_from(PLACES + OBJECTS), max_size=2))
    here = [] if whole else [n for n in (*graph.places, *graph.objects) if n not in gone]
    p = sorted({n for n in here if n[0] == "p"} | {x.id for x in new_places})
    o = sorted({n for n in here if n[0] == "o"} | {x.id for x in new_objects})
    edges = draw(st.lists(st.tuples(*[st.sampled_from(p or [""])] * 2), max_size=8 if p else 0))
    edges = [(a, b) for a, b in edges if a != b]
    links = st.tuples(st.sampled_from(p or [""]), st.sampled_from(o or [""]))
    possible = bool(p and o)
    parents = draw(st.lists(links, max_size=3 if possible else 0))
    edges += [pair if draw(st.booleans()) else pair[::-1] for pair in parents]
    there = [(a, b) for a, row in graph.neighbours.items() for b in row]
    there += [(a, b) for a, row in graph.parents.items() for b in row]
    there.append(("p0", "p1"))
    return update(
        new_places,
        new_objects,
        edges,
        full=whole,
        query_place=draw(st.one_of(st.none(), st.sampled_from(p))) if p else None,
        sightings=draw(st.lists(links, max_size=2 if possible and draw(st.booleans()) else 0)),
        removed_nodes=gone,
        removed_edges=draw(st.lists(st.sampled_from(there), max_size=4)),
    )
