"""Occupancy grids: lines of sight, and places over their free space. scipy is imported where places are sampled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semloc_core.errors import GraphError
from semloc_core.graph import Floats, Ints
from semloc_core.text import short_repr

Bools = NDArray[np.bool_]
FREE_BELOW = 50
"""Cells known to be occupied with a smaller percentage are free."""
EDGE_LENGTHS = 1.5
"""Longest edge between places of a grid, in spacings."""
NEAREST = 0.6
"""Places that see each other are no nearer than this, in spacings."""
SPECKLE_M2 = 0.5
"""Free areas below this are stray readings, such as what a laser saw through a window."""
FARTHEST = 1e9
"""m; coordinates go no farther anywhere."""
_SAMPLES = 4_000_000


@short_repr
@dataclass(frozen=True, eq=False)
class Grid:
    """An occupancy grid as nav_msgs/OccupancyGrid has it.

    Args:
        cells: (H, W) int8, row 0 at the origin: 0 … 100 % occupied, -1 unknown.
        resolution: edge length of a cell, m.
        origin: x, y (m) and yaw (rad) of the outer corner of the cell (0, 0).

    Raises:
        GraphError: a shape, resolution or origin that is none.

    """

    cells: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]

    def __post_init__(self) -> None:
        if self.cells.ndim != 2 or not self.cells.size:
            raise GraphError(f"expected a grid with rows and columns (got shape {self.cells.shape})")
        if not (np.isfinite(self.resolution) and self.resolution > 0 and np.isfinite(self.origin).all()):
            raise GraphError(
                f"expected a resolution above 0 m and a finite origin (got {self.resolution:g} m at {self.origin})"
            )
        if max(*map(abs, self.origin), self.resolution * max(self.cells.shape)) > FARTHEST:
            raise GraphError(
                f"expected a grid within 10⁹ m (got {self.cells.shape} cells of {self.resolution:g} m at {self.origin})"
            )

    @cached_property
    def free(self) -> Bools:
        """(H, W) cells that are known to be free."""
        return (self.cells >= 0) & (self.cells < FREE_BELOW)

    @cached_property
    def open(self) -> Bools:
        """(H, W) cells that one can see through: whatever is not known to be occupied."""
        return self.cells < FREE_BELOW

    def centres(self, rows: Ints, columns: Ints) -> Floats:
        """(N, 2) centres of cells in the grid's frame, m."""
        along = (np.stack([columns, rows], axis=-1) + 0.5) * self.resolution
        found: Floats = along @ self._turn.T + np.array(self.origin[:2])
        return found

    @cached_property
    def _turn(self) -> Floats:
        sine, cosine = np.sin(self.origin[2]), np.cos(self.origin[2])
        return np.array([[cosine, -sine], [sine, cosine]])

    def at(self, mask: Bools, points: Floats) -> Bools:
        """(N,) whether the cells at (N, 2) points, m, are in a mask; outside the grid they are not."""
        return _inside(mask, np.floor(self._scaled(points)).astype(np.int64))

    def _scaled(self, points: Floats) -> Floats:
        found: Floats = ((points - np.array(self.origin[:2])) @ self._turn) / self.resolution
        return found

    def sight(self, starts: Floats, ends: Floats, short_m: float = 0.0) -> Bools:
        """Whether lines of sight meet nothing that is known to be occupied; arguments as of `clear`."""
        return self.clear(self.open, starts, ends, short_m, outside=True)

    def clear(self, mask: Bools, starts: Floats, ends: Floats, short_m: float = 0.0, *, outside: bool = False) -> Bools:
        """Whether straight lines stay within a mask's cells, corners between two other cells included.

        Args:
            mask: (H, W), such as `free`.
            starts: (N, 2) m.
            ends: (N, 2) m.
            short_m: so much before its end a line may leave the mask.
            outside: whether what is not in the grid counts as in the mask.

        """
        starts, ends = self._scaled(starts), self._scaled(ends)
        lengths = np.linalg.norm(ends - starts, axis=1)
        ends = (
            starts + (ends - starts) * np.clip(1 - short_m / self.resolution / np.maximum(lengths, 1e-9), 0, 1)[:, None]
        )
        number = int(np.ceil(lengths.max(initial=0.0) * 4)) + 2
        part = np.linspace(0.0, 1.0, number)[None, :, None]
        found = np.empty(len(starts), dtype=np.bool_)
        for i in range(0, len(starts), step := max(1, _SAMPLES // number)):
            a, b = starts[i : i + step, None], ends[i : i + step, None]
            cells = np.floor(a + part * (b - a)).astype(np.int64)
            good = _inside(mask, cells, outside)
            # From cell to cell across a corner: both cells beside it have to be in the mask.
            before, after = cells[:, :-1], cells[:, 1:]
            corner = (before != after).all(axis=2)
            beside = (
                np.stack([after[..., 0], before[..., 1]], axis=-1),
                np.stack([before[..., 0], after[..., 1]], axis=-1),
            )
            passes = ~corner | (_inside(mask, beside[0], outside) & _inside(mask, beside[1], outside))
            found[i : i + step] = good.all(axis=1) & passes.all(axis=1)
        return found


def _inside(mask: Bools, cells: Ints, outside: bool = False) -> Bools:
    """(...) whether (..., 2) cells, column and row, are in a mask."""
    height, width = mask.shape
    column, row = cells[..., 0], cells[..., 1]
    within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    found: Bools = np.where(within, mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], outside)
    return found


@short_repr
@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Places over a grid's free space: a block each, (N, 2) positions (m), (2, E) edges that cross no wall.

    A place's block is where it is to the nearest spacing; a place that joins others has a block of its own.
    """

    blocks: list[tuple[int, int, int]]
    points: Floats
    edges: Ints


def free_places(grid: Grid, spacing_m: float, radius_m: float) -> FreeSpace:
    """Sample free space: in each block of it the cell farthest from walls, thinned where places see each other.

    Edges are straight lines over which a robot fits. Where such lines leave a connected free area in parts, as narrow
    bends do, places along the shortest ways between the parts join them.

    Args:
        grid: the grid.
        spacing_m: between places, about.
        radius_m: of the robot: no place and no edge is nearer to what is not known to be free.

    Raises:
        GraphError: the robot fits nowhere.

    """
    from scipy import ndimage, spatial

    clearance = ndimage.distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1] * grid.resolution - grid.resolution / 2
    walkable: Bools = grid.free & (clearance >= radius_m - 1e-9)
    areas, _ = ndimage.label(walkable)
    walkable &= (np.bincount(areas.ravel()) * grid.resolution**2 >= SPECKLE_M2)[areas]
    rows, columns = np.nonzero(walkable)
    if not len(rows):
        raise GraphError(f"expected free space in the grid for a robot of radius {radius_m:g} m (got none)")
    centres = grid.centres(rows, columns)
    blocks = np.floor(centres / spacing_m).astype(np.int64)
    room = np.round(np.minimum(clearance[rows, columns], spacing_m), 6)
    off = np.round(np.linalg.norm(centres - (blocks + 0.5) * spacing_m, axis=1), 6)
    area = areas[rows, columns]
    order = np.lexsort((columns, rows, off, -room, area, blocks[:, 1], blocks[:, 0]))
    key = np.stack([blocks[:, 0], blocks[:, 1], area], axis=1)[order]
    first = order[np.r_[True, (key[1:] != key[:-1]).any(axis=1)]]
    first = first[np.lexsort((columns[first], rows[first], -room[first]))]
    points = centres[first]
    near = spatial.cKDTree(points).query_pairs(NEAREST * spacing_m, output_type="ndarray").reshape(-1, 2)
    near = near[grid.clear(walkable, points[near[:, 0]], points[near[:, 1]])]
    others: dict[int, list[int]] = {}
    for a, b in near.tolist():
        others.setdefault(max(a, b), []).append(min(a, b))
    kept: list[int] = []
    dropped: set[int] = set()
    for i in range(len(first)):
        if all(j in dropped for j in others.get(i, ())):
            kept.append(i)
        else:
            dropped.add(i)
    first = first[kept]
    first = first[np.lexsort((area[first], blocks[first, 1], blocks[first, 0]))]
    points, names, seen = centres[first], [], dict[tuple[int, int], int]()
    for x, y in blocks[first].tolist():
        names.append((x, y, seen.setdefault((x, y), 0)))
        seen[x, y] += 1
    pairs = spatial.cKDTree(points).query_pairs(EDGE_LENGTHS * spacing_m, output_type="ndarray").reshape(-1, 2)
    pairs = pairs[grid.clear(walkable, points[pairs[:, 0]], points[pairs[:, 1]])]
    edges = {(min(a, b), max(a, b)) for a, b in pairs.tolist()}
    cells = np.stack([rows, columns], axis=1)
    for way in _joining(walkable, cells, first, edges):
        here = way[0]
        for cell in _bends(grid, walkable, centres[way[1]], points[way[0]], points[way[2]], EDGE_LENGTHS * spacing_m):
            x, y = np.floor(cell / spacing_m).astype(np.int64).tolist()
            names.append((x, y, seen.setdefault((x, y), 0)))
            seen[x, y] += 1
            points = np.concatenate([points, cell[None]])
            edges.add((here, len(points) - 1))
            here = len(points) - 1
        edges.add((min(here, way[2]), max(here, way[2])))
    return FreeSpace(names, points, np.array(sorted(edges), dtype=np.int64).reshape(-1, 2).T)


def _joining(
    walkable: Bools, cells: Ints, places: Ints, edges: set[tuple[int, int]]
) -> Iterator[tuple[int, Ints, int]]:
    """Shortest ways (place, cells between, place) that join what the edges leave in parts; cells by their number."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree

    number = len(places)
    ends = np.array(sorted(edges), dtype=np.int64).reshape(-1, 2).T
    part = _parts(number, ends)
    index = np.full(walkable.shape, -1, dtype=np.int64)
    index[walkable] = np.arange(len(cells))
    links = _neighbouring(index)
    area = connected_components(_sparse(links, len(cells)), directed=False)[1][places]
    if len(np.unique(part)) == len(np.unique(area)):
        return
    metres, via, source = dijkstra(
        _sparse(links, len(cells)), directed=False, indices=places, min_only=True, return_predecessors=True
    )
    of_place = np.full(len(cells), -1, dtype=np.int64)
    of_place[places] = np.arange(number)
    a, b = of_place[source[links[0]]], of_place[source[links[1]]]
    between = np.flatnonzero(part[a] != part[b])
    low, high = np.minimum(part[a], part[b])[between], np.maximum(part[a], part[b])[between]
    length = metres[links[0]][between] + metres[links[1]][between] + 1
    order = np.lexsort((between, length, high, low))
    best = order[np.r_[True, (np.diff(low[order]) != 0) | (np.diff(high[order]) != 0)]] if len(order) else order
    tree: Any = minimum_spanning_tree(
        coo_array((length[best], (low[best], high[best])), shape=(part.max() + 1,) * 2).tocsr()
    ).tocoo()
    chosen = {(int(low[i]), int(high[i])): int(between[i]) for i in best.tolist()}
    for pair in sorted(zip(tree.row.tolist(), tree.col.tolist(), strict=True)):
        link = chosen[pair]
        there, back = _back(via, int(links[0][link])), _back(via, int(links[1][link]))
        way = np.array(there[::-1] + back, dtype=np.int64)
        yield int(of_place[way[0]]), way[1:-1], int(of_place[way[-1]])


def _parts(number: int, ends: Ints) -> Ints:
    from scipy.sparse.csgraph import connected_components

    found: Ints = connected_components(_sparse(ends, number), directed=False)[1].astype(np.int64)
    return found


def _sparse(links: Ints, number: int) -> Any:
    from scipy.sparse import coo_array

    return coo_array((np.ones(links.shape[1]), (links[0], links[1])), shape=(number, number)).tocsr()


def _neighbouring(index: Ints) -> Ints:
    """(2, L) numbers of walkable cells side by side."""
    pairs = [(index[:, :-1], index[:, 1:]), (index[:-1], index[1:])]
    found = [np.stack([a[both], b[both]]) for a, b in pairs for both in [(a >= 0) & (b >= 0)]]
    return np.concatenate(found, axis=1)


def _back(via: Ints, cell: int) -> list[int]:
    found = [cell]
    while via[found[-1]] >= 0:
        found.append(int(via[found[-1]]))
    return found


def _bends(grid: Grid, mask: Bools, way: Floats, start: Floats, end: Floats, longest_m: float) -> Iterator[Floats]:
    """Points of a way such that each is seen from the one before, and the end from the last."""
    here, i = start, 0
    while True:
        ahead = np.concatenate([way[i:], end[None]])
        starts = np.broadcast_to(here, ahead.shape)
        seen = grid.clear(mask, starts, ahead) & (np.linalg.norm(ahead - here, axis=1) <= longest_m)
        last = int(np.flatnonzero(seen)[-1]) if seen.any() else 0
        if last == len(ahead) - 1:
            return
        here, i = ahead[last], i + last + 1
        yield here
