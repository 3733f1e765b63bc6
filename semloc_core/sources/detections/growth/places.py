"""Places and the ways between them: along the robot's way, and over an occupancy grid's free space."""

from __future__ import annotations

import numpy as np

from semloc_core.graph import Floats, ball
from semloc_core.sources.detections.grid import EDGE_LENGTHS, Grid, free_places
from semloc_core.sources.detections.growth.cells import Cells, distance, ordered, rounded
from semloc_core.sources.detections.growth.config import BuilderConfig
from semloc_core.sources.hydra.write import node_id

JUMP_M = 2.0
"""Farther the robot does not go between two poses: its frame jumped, and nothing says that one can walk there."""
STOREY_M = 1.0
"""Places that are farther apart in height are not near each other."""
DETOUR = 3.0
"""A near place is near for the robot too if the known way there is no longer than so many spacings."""


class Places:
    """Places by key, and the ways between them.

    Args:
        config: options.

    Attributes:
        position: by key, m.
        ways: place -> neighbour -> m.
        here: the place where the robot is; empty: none yet.
        grid: the walls that are known.
        changed: keys of places that are new, moved or gone since this was emptied.
        changed_ways: the same of ways, as ordered pairs.

    """

    def __init__(self, config: BuilderConfig) -> None:
        self._config = config
        self.position: dict[str, Floats] = {}
        self.ways: dict[str, dict[str, float]] = {}
        self.here = ""
        self.grid: Grid | None = None
        self.changed: set[str] = set()
        self.changed_ways: set[tuple[str, str]] = set()
        self._cells = Cells()
        self._count = 0
        self._blocks: dict[tuple[int, int, int], str] = {}
        self._of_grid: frozenset[str] = frozenset()

    def walk(self, position: Floats) -> None:
        """The robot is here (m): a place, and a way to it, where there is none."""
        last, spacing = self.here, self._config.place_spacing_m
        near = [key for key in self.near(position, spacing) if self._reachable(key, position)]
        if near:
            self.here = min(near, key=lambda key: (distance(self.position[key], position), key))
        else:
            self.here = self._add(position)
            self._join_in_sight(self.here)
        came = last and last != self.here and distance(self.position[last], position) <= JUMP_M
        if came and self._line_is_free(last, self.here):
            self._join(last, self.here)

    def near(self, position: Floats, radius_m: float, storey_m: float = STOREY_M) -> list[str]:
        """Places so near in the plane and in height, by key."""
        found = []
        for key in self._cells.near(position, radius_m):
            x, y, z = (self.position[key] - position).tolist()
            if x * x + y * y <= radius_m * radius_m and abs(z) <= storey_m:
                found.append(key)
        return sorted(found)

    def seeing(self, position: Floats, radius_m: float, short_m: float) -> list[str]:
        """Places of the grid so near, from which no known wall hides a thing; ``short_m`` as of `Grid.clear`."""
        near = [key for key in self.near(position, radius_m, JUMP_M) if key in self._of_grid]
        if self.grid is None or not near:
            return []
        starts = np.array([self.position[key][:2] for key in near])
        clear = self.grid.sight(starts, np.broadcast_to(position[:2], starts.shape), short_m)
        return [key for key, good in zip(near, clear.tolist(), strict=True) if good]

    def set_grid(self, grid: Grid, height: float) -> bool:
        """Lay places over a grid's free space, in place of the last one's; those of a block keep their id.

        Args:
            grid: the grid, in the graph's frame.
            height: of new places, m.

        Returns:
            Whether it is another grid than before.

        Raises:
            GraphError: the robot fits nowhere in it; all is as it was.

        """
        known = self.grid
        same = known is not None and (known.resolution, known.origin) == (grid.resolution, grid.origin)
        if same and known is not None and np.array_equal(known.cells, grid.cells):
            return False
        space = free_places(grid, self._config.place_spacing_m, self._config.robot_radius_m)
        self.grid = grid
        blocks, self._blocks = self._blocks, {}
        ids: list[str] = []
        for block, (x, y) in zip(space.blocks, space.points.tolist(), strict=True):
            if key := blocks.pop(block, ""):
                self._move(key, np.array([x, y, self.position[key][2]]))
            else:
                key = self._add(np.array([x, y, height]))
            self._blocks[block] = key
            ids.append(key)
        for key in blocks.values():
            self._remove(key)
        own = self._of_grid = frozenset(ids)
        wanted = {ordered(ids[a], ids[b]) for a, b in space.edges.T.tolist()}
        for a in sorted(self.position):
            for b in sorted(self.ways[a]):
                both = a in own and b in own
                if a < b and ((a, b) not in wanted if both else not self._line_is_free(a, b)):
                    self._part(a, b)
        for a, b in sorted(wanted):
            self._join(a, b)
        for a in sorted(self.position.keys() - own):
            self._join_in_sight(a)
        return True

    def _reachable(self, key: str, position: Floats) -> bool:
        """Whether a place is near for the robot, and not only behind a wall."""
        if key == self.here or distance(self.position[key], position) <= self._config.robot_radius_m:
            return True  # its own body is where a wall would be
        if self.grid is not None and self.grid.at(self.grid.free, position[None, :2])[0]:
            return self._sees(position, key)
        return key in ball(self.ways, self.here, DETOUR * self._config.place_spacing_m) if self.here else False

    def _join_in_sight(self, place: str) -> None:
        """Join a place to those of the grid that are near and in sight over free cells."""
        position = self.position[place]
        for key in self.near(position, EDGE_LENGTHS * self._config.place_spacing_m) if self._of_grid else ():
            if key in self._of_grid and key != place and self._sees(position, key):
                self._join(place, key)

    def _sees(self, position: Floats, key: str) -> bool:
        """Whether all of the straight way from a position to a place is known to be free."""
        assert self.grid is not None
        return bool(self.grid.clear(self.grid.free, position[None, :2], self.position[key][None, :2])[0])

    def _line_is_free(self, a: str, b: str) -> bool:
        """Whether no known wall is between two places."""
        grid = self.grid
        return grid is None or bool(grid.sight(self.position[a][None, :2], self.position[b][None, :2])[0])

    def _add(self, position: Floats) -> str:
        key = node_id("p", self._count)
        self._count += 1
        self.position[key] = np.array(rounded(position))
        self._cells.put(key, self.position[key])
        self.ways[key] = {}
        self.changed.add(key)
        return key

    def _move(self, key: str, position: Floats) -> None:
        position = np.array(rounded(position))
        if (position == self.position[key]).all():
            return
        self._cells.drop(key, self.position[key])
        self.position[key] = position
        self._cells.put(key, position)
        for other in self.ways[key]:
            self.ways[key][other] = self.ways[other][key] = distance(position, self.position[other])
        self.changed.add(key)

    def _remove(self, key: str) -> None:
        for other in list(self.ways[key]):
            self._part(key, other)
        self._cells.drop(key, self.position.pop(key))
        del self.ways[key]
        self.changed.add(key)
        if self.here == key:
            self.here = ""

    def _join(self, a: str, b: str) -> None:
        if b not in self.ways[a]:
            self.ways[a][b] = self.ways[b][a] = distance(self.position[a], self.position[b])
            self.changed_ways.add(ordered(a, b))

    def _part(self, a: str, b: str) -> None:
        del self.ways[a][b], self.ways[b][a]
        self.changed_ways.add(ordered(a, b))
