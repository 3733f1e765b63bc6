"""Kinds of buildings: which rooms and furniture one may have; a building of a kind is drawn, no two alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec
import numpy as np

from semloc_core.errors import ConfigError
from semloc_core.graph import load_labelspace
from semloc_core.sources.world.floor_plan import CORRIDOR, RoomKind
from semloc_core.sources.world.furniture import Furniture
from semloc_core.sources.world.office import OfficeConfig, World, make_world_pair
from semloc_core.sources.world.second_run import SecondRun

T = TypeVar("T")
ATTEMPTS = 50
"""Buildings drawn before one whose furniture fits its rooms is given up."""
TASTE = 1.5
"""Shape of the gamma distribution of how much a household has of a thing, around its mean: some none, some many."""
CLUTTER_SIZE = (0.2, 0.2, 0.2)
CLUTTER_HEIGHT_M = 0.9


class Rooms(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Between ``count[0]`` and ``count[1]`` rooms of a kind (whose own count is not read)."""

    kind: RoomKind
    count: tuple[int, int]


class Thing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Furniture whose count is drawn: ``mean`` for each room that it may stand in.

    ``usual``: it is there or not, room by room, with probability ``mean``; else the household's taste decides
    (`TASTE`). ``beside`` furniture never outnumbers what it stands beside.
    """

    furniture: Furniture
    mean: float
    usual: bool = False


class BuildingKind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a kind of building may be.

    ``rooms``, ``things``: what there may be; ``depth_m``, ``corridor_m``, ``wings``, ``passages``: bounds of the floor
    plan's measures (see `OfficeConfig`); ``spacing_m``: bounds of how near places lie; ``clutter``: mean number of
    objects of any class of the labelspace at all, as detectors report them.
    """

    labelspace: str
    rooms: tuple[Rooms, ...]
    things: tuple[Thing, ...]
    depth_m: tuple[float, float]
    corridor_m: tuple[float, float]
    wings: tuple[int, int]
    passages: tuple[float, float]
    spacing_m: tuple[float, float] = (0.4, 0.9)
    clutter: float = 5.0


def draw_config(kind: BuildingKind, rng: np.random.Generator) -> OfficeConfig:
    """One building of a kind; its furniture may turn out not to fit."""
    rooms = tuple(
        msgspec.structs.replace(r.kind, count=int(rng.integers(r.count[0], r.count[1] + 1))) for r in kind.rooms
    )
    wings = int(rng.integers(kind.wings[0], kind.wings[1] + 1))
    number = {room.name: room.count for room in rooms} | {CORRIDOR: wings + (wings > 1)}
    furniture: list[Furniture] = []
    for thing in kind.things:
        count = _count(thing, number, furniture, rng)
        if count:
            furniture.append(msgspec.structs.replace(thing.furniture, count=count))
    classes, anywhere = load_labelspace(kind.labelspace).classes, tuple(r.name for r in rooms if r.count)
    for c in rng.integers(len(classes), size=int(rng.poisson(kind.clutter))):
        furniture.append(Furniture(classes[c], 1, "wall", CLUTTER_SIZE, CLUTTER_HEIGHT_M, rooms=anywhere))
    near = float(rng.uniform(*kind.spacing_m))
    return OfficeConfig(
        rooms=rooms,
        furniture=tuple(furniture),
        wings=wings,
        depth_m=float(rng.uniform(*kind.depth_m)),
        corridor_m=float(rng.uniform(*kind.corridor_m)),
        passages=float(rng.uniform(*kind.passages)),
        spacing_m=(near, 1.5 * near),
        max_edge_m=4.0 * near,
        labelspace=kind.labelspace,
    )


def draw_pair(kind: BuildingKind, rng: np.random.Generator, run: SecondRun | None = None) -> tuple[World, World]:
    """A building of a kind as mapped, and as a detector saw it on another run (`make_world_pair`).

    Args:
        kind: of building.
        rng: the only source of randomness.
        run: how the detector errs; None for the defaults.

    Raises:
        ConfigError: none that was drawn could be furnished.

    """
    return draw(kind, rng, lambda config, rng: make_world_pair(config, rng, run))


def draw(kind: BuildingKind, rng: np.random.Generator, make: Callable[[OfficeConfig, np.random.Generator], T]) -> T:
    """What ``make`` makes of the first building of a kind that can be furnished; errors as of `draw_pair`."""
    for _ in range(ATTEMPTS):
        try:
            return make(draw_config(kind, rng), rng)
        except ConfigError as error:
            last = error
    raise ConfigError(f"expected a kind of building that can be furnished (got {ATTEMPTS} failures: {last})")


def _count(thing: Thing, number: dict[str, int], before: list[Furniture], rng: np.random.Generator) -> int:
    wanted, places = thing.furniture, sum(number.get(room, 0) for room in thing.furniture.rooms)
    if wanted.where == "beside":
        hosts = sum(f.count for f in before if f.class_ == wanted.beside)
        return int(rng.binomial(hosts, min(1.0, thing.mean * float(rng.uniform(0.6, 1.4)))))
    if not places:
        return 0
    if thing.usual:
        return int(rng.binomial(places, thing.mean))
    return int(rng.poisson(places * rng.gamma(TASTE, thing.mean / TASTE)))
