"""What a detector makes of a furnished building: objects missed, misplaced and invented."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from semloc_core.sources.world.floor_plan import FloorPlan
from semloc_core.sources.world.furniture import Item


class SecondRun(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a detector errs.

    ``missed``: probability that it misses an object; ``noise_m``: standard deviation of x and of y of those it sees
    (m); ``invented``: objects that are not there, as a share of those that are (Poisson mean).
    """

    missed: float = 0.25
    noise_m: float = 0.15
    invented: float = 0.15


def detect(plan: FloorPlan, items: Sequence[Item], run: SecondRun, rng: np.random.Generator) -> list[Item]:
    """The objects that a detector reports.

    An invented one is of a class that the building has, as often as it has it, anywhere in a room.

    Args:
        plan: the floor.
        items: what stands on it.
        run: how the detector errs.
        rng: source of all that is random.

    """
    found = rng.random(len(items)) >= run.missed
    noise = rng.normal(0.0, run.noise_m, size=(len(items), 2))
    seen = [_moved(item, noise[i]) for i, item in enumerate(items) if found[i]]
    for _ in range(int(rng.poisson(run.invented * len(items)))):
        like = items[int(rng.integers(len(items)))]
        room = int(rng.integers(len(plan.rooms)))
        x, y = rng.uniform(plan.rooms[room].low, plan.rooms[room].high)
        seen.append(Item(like.class_, room, (float(x), float(y), like.position[2]), like.size, like.half))
    return seen


def _moved(item: Item, offset: NDArray[np.float64]) -> Item:
    x, y, z = item.position
    return Item(item.class_, item.room, (x + float(offset[0]), y + float(offset[1]), z), item.size, item.half)
