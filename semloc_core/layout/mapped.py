"""A map's buildings side by side, laid out for verification."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from semloc_core.graph_arrays import Floats, Ints
from semloc_core.layout.config import LayoutConfig
from semloc_core.layout.part import LayoutPart


class MappedLayout:
    """All buildings of a map.

    Args:
        parts: its buildings, in the order of the map's rows, all made for the same classes and options; not kept.
        n_classes: C.
        config: these options.

    Attributes:
        positions: (M, 3) the map's places, metres; each building in its own frame.
        building: (M,) the number of each place's building.
        object_positions: (K, 3) objects of all buildings, metres.
        object_classes: (K,) of these.
        detected: (K,) probability that each object is there and is detected.
        invented: (C,) objects invented, per m² and class.
        rooms: the free space of each building.
        objects_near: (M + 1,) starts and (L,) objects in reach of each place and a little more, by place.

    """

    def __init__(self, parts: Sequence[LayoutPart], n_classes: int, config: LayoutConfig) -> None:
        self.config, self.n_classes = config, n_classes
        for building in parts:
            assert building.n_classes == n_classes, (building.n_classes, n_classes)
            assert building.config == config, (building.config, config)
        none = np.zeros((0, 3))
        self.positions: Floats = np.concatenate([none, *(b.positions for b in parts)])
        self.building: Ints = np.repeat(np.arange(len(parts)), [len(b) for b in parts]).astype(np.int64)
        self.object_positions: Floats = np.concatenate([none, *(b.object_positions for b in parts)])
        self.object_classes: Ints = np.concatenate([np.zeros(0, np.int64), *(b.object_classes for b in parts)])
        self.detected: Floats = np.concatenate([np.zeros(0), *(b.detected for b in parts)])
        counts = np.bincount(self.object_classes, minlength=n_classes).astype(np.float64)
        # A class that no map has can be invented too.
        frequency = (counts / max(counts.sum(), 1.0) + 0.1 / n_classes) / 1.1
        self.rooms = tuple(b.room for b in parts)
        self.objects_near = _objects_near(parts)
        self.invented: Floats = config.invented * frequency

    @property
    def n_places(self) -> int:
        """M."""
        return len(self.positions)


def _objects_near(parts: Sequence[LayoutPart]) -> tuple[Ints, Ints]:
    sizes, found = [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
    first = accumulate((len(b.object_positions) for b in parts), initial=0)
    for building, before in zip(parts, first, strict=False):
        start, objects = building.objects_near
        sizes.append(np.diff(start))
        found.append(objects + before)
    return np.cumsum(np.concatenate(sizes)), np.concatenate(found)
