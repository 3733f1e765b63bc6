"""``semloc map info``: what an engineer asks of a map before a robot is trusted to it."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from semloc_core.cli.maps.good_for import good_for
from semloc_core.cli.shared.common import Json, write_json
from semloc_core.cli.shared.map_places import MapPlace, server_map, to_read
from semloc_core.cli.shared.screen import console, cut, many, plain_table, print_whole
from semloc_core.fleet import is_address

if TYPE_CHECKING:
    from semloc_core.encoding import Model
    from semloc_core.map_database import ReadableMap
    from semloc_core.metrics import Row

UNASKED_PLACES = 20_000
"""Maps of at most so many places are searched for look-alikes unasked."""
MOVES = 0.05
"""Share of a class's objects that moves, from which on the class is named as one that does."""
MOVING_CLASSES = 8


def info(
    map_place: MapPlace,
    aliasing: Annotated[
        bool | None,
        typer.Option(
            "--aliasing/--no-aliasing",
            help=f"Say what looks alike; default: in maps of at most {UNASKED_PLACES} places.",
        ),
    ] = None,
    long: Annotated[
        bool,
        typer.Option(
            "--long",
            help="Hashes, the model's options, classes building by building, and how many places an encoder of class "
            "labels can't tell apart (1-WL colour refinement).",
        ),
    ] = False,
    json_file: Json = None,
) -> None:
    """Say what a map is good for: what looks alike in it, storeys, how many objects a place has and needs.

    Then its buildings and classes. --json has all that --long says.
    """
    facts = _facts(map_place)
    name = facts["model"]["name"]
    rows: list[Row] = [
        {
            "method": name,
            "scope": b["name"],
            "places": b["places"],
            "objects": b["objects"],
            "storeys": len(b["storeys"]),
            **_extent(b["extent_m"]),
        }
        for b in facts["buildings"]
    ]
    asked = facts["places"] <= UNASKED_PLACES if aliasing is None else aliasing
    with to_read(map_place) as (map_, model):
        console.print(_head(facts))
        if asked and facts["places"]:
            said, more = good_for(map_, name)
            for row, own in zip(rows, more, strict=False):
                row.update(own)
            rows += more[len(rows) :]
            for line in said:
                console.print(f"- {line}")
        elif aliasing is None and facts["places"]:
            console.print(
                "- Look-alikes: --aliasing says which buildings look alike, and how few objects a place needs."
            )
        _print_buildings(facts)
        _print_classes(facts)
        _print_unknown(facts, model)
        alike = _aliasing_rows(map_, model) if asked and (long or json_file is not None) else []
        if long:
            _print_long(facts)
            if alike:
                _print_alike(alike, model)
            elif asked:
                _line("alike", "no place to tell from others")
    if json_file is not None:
        write_json(json_file, "map info", 0, [map_place], [*rows, *alike])


def _extent(extent: list[list[float]] | None) -> Row:
    """As figures of a row."""
    if extent is None:
        return {}
    return {
        f"{axis}_{end}_m": at[i] for end, at in zip(("from", "to"), extent, strict=True) for i, axis in enumerate("xyz")
    }


def _head(facts: dict[str, Any]) -> str:
    """What there is, in one sentence."""
    objects = sum(building["objects"] for building in facts["buildings"])
    classes = len({name for building in facts["buildings"] for name in building["classes"]})
    held = f"{many(facts['places'], 'place')}, {many(objects, 'object')} of {many(classes, 'class', 'classes')}"
    return f"{facts['name']}: {many(len(facts['buildings']), 'building')}, {held}"


def _facts(place: str) -> dict[str, Any]:
    from semloc_core.map_database import describe, describe_map

    if is_address(place):
        with server_map(place) as database:
            return describe_map(database, database.meta, database.model)
    return describe(place)


def _line(name: str, text: str) -> None:
    console.print(Text.assemble((f"{name:11s}", "bold"), " ", text))


def _table(*names: str) -> Table:
    """A table without a frame: names, then figures."""
    table = plain_table()
    for number, name in enumerate(names):
        table.add_column(name, justify="right" if number else "left")
    return table


def _print_buildings(facts: dict[str, Any]) -> None:
    merged = any(building["traversals"] for building in facts["buildings"])
    axes = ["x (m)", "y (m)", "z (m)"]
    table = _table("building", "places", "objects", "storeys", *axes, *(["merged"] if merged else []))
    for b in facts["buildings"]:
        ends = b["extent_m"]
        extent = (
            [f"{round(low, 1) + 0.0} to {round(high, 1) + 0.0}" for low, high in zip(*ends, strict=True)]
            if ends
            else ["", "", ""]
        )
        more = [str(b["traversals"])] if merged else []
        table.add_row(cut(b["name"]), str(b["places"]), str(b["objects"]), _storeys(b["storeys"]), *extent, *more)
    console.print()
    print_whole(table, console)


def _storeys(storeys: list[dict[str, Any]]) -> str:
    """How many, and where there are several how high the places of each lie."""
    heights = ", ".join(f"{storey['height_m']:.1f}" for storey in storeys)
    return f"{len(storeys)} (at {heights} m)" if len(storeys) > 1 else str(len(storeys))


def _print_classes(facts: dict[str, Any]) -> None:
    """Classes by number of objects; where there are several buildings, in how many of them."""
    counts: Counter[str] = Counter()
    homes: Counter[str] = Counter()
    for building in facts["buildings"]:
        counts.update(building["classes"])
        homes.update(building["classes"].keys())
    several = len(facts["buildings"]) > 1
    table = _table("class", "objects", *(["buildings"] if several else []))
    for name, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        table.add_row(name, str(count), *([str(homes[name])] if several else []))
    console.print()
    print_whole(table, console)
    for building in facts["buildings"]:
        if building["traversals"]:
            merged = f"{many(building['traversals'], 'traversal')} merged"
            _line("moves", f"{building['name']}: {merged}; {_moving(building['moved'])}")
    console.print()


def _moving(rates: dict[str, float]) -> str:
    """The classes that move the most; the prior gives every class a little."""
    moving = [item for item in rates.items() if item[1] >= MOVES]
    if not moving:
        return "no class is seen to move"
    moving.sort(key=lambda item: (-item[1], item[0]))
    named = ", ".join(f"{name} {rate:.2f}" for name, rate in moving[:MOVING_CLASSES])
    more = len(moving) - MOVING_CLASSES
    return f"share that moves: {named}{f', and {more} more' if more > 0 else ''}"


def _print_long(facts: dict[str, Any]) -> None:
    model, space = facts["model"], facts["labelspace"]
    if "bytes" in facts:
        _line("file", f"{facts['bytes'] / 1e6:.1f} MB, format {facts['format_version']}")
    _line("hash", facts["hash"])
    _line("model", f"{model['name']} {model['hash'][:12]}, {many(facts['dimension'], 'number')} a place")
    _line("labelspace", f"{space['name']} {space['hash'][:12]}, {many(space['classes'], 'class', 'classes')}")
    for building in facts["buildings"]:
        classes = ", ".join(f"{name} {count}" for name, count in building["classes"].items())
        _line("objects", f"{building['name']}: {classes or 'none'}")
    _line("options", ", ".join(f"{key} {value}" for key, value in facts["model"]["config"].items()))


def _print_unknown(facts: dict[str, Any], model: Model) -> None:
    from semloc_core.graph import listed

    unknown: Counter[str] = Counter()
    for building in facts["buildings"]:
        classes = building["classes"]
        unknown.update({name: count for name, count in classes.items() if model.labelspace.index(name) < 0})
    if unknown:
        _line(
            "unknown", f"{many(unknown.total(), 'object')} of classes that the model does not know: {listed(unknown)}"
        )


def _print_alike(alike: list[Row], model: Model) -> None:
    """What class labels can tell apart: all that such an encoder can reach, and a measure of how uniform a map is."""
    from semloc_core.evaluate import Aliasing, reads_labels_only

    _line("alike", f"kinds of places that {alike[0]['method']} tell apart, nothing moved (1-WL colour refinement)")
    if not reads_labels_only(model.encoder):
        _line("", f"{model.encoder.name} reads distances too: to it this is no ceiling")
    table = _table("building", "places", "kinds", "alone", f"alike > {Aliasing.NEAR_M:g} m", "success@1 at most")
    for row in alike:
        names = ("places", "colours", "alone", "far_aliases")
        table.add_row(cut(str(row["scope"])), *(str(row[name]) for name in names), f"{row['success@1_ceiling']:.3f}")
    print_whole(table, console)


def _aliasing_rows(map_: ReadableMap, model: Model) -> list[Row]:
    """A row a building, and one for all together where there are several."""
    from semloc_core.encoding import build_encoder
    from semloc_core.evaluate import map_aliasing, reads_labels_only
    from semloc_core.graph import GraphArrays

    space, encoder = model.labelspace, model.encoder
    if not reads_labels_only(encoder):
        encoder = build_encoder("paper", None, len(space))
    name = f"class labels within {many(encoder.extraction.hops, 'hop')}"
    buildings = [GraphArrays.from_scene_graph(map_.graph(b), space, b) for b in map_.buildings]
    scopes = [(arrays.name, [arrays]) for arrays in buildings] + ([("all", buildings)] if len(buildings) > 1 else [])
    found = [(scope, map_aliasing(encoder, some, len(space))) for scope, some in scopes]
    return [one.row(name, scope) for scope, one in found if one is not None]
