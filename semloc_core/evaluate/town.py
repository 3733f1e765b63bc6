"""A town: many buildings in one map, and what a localiser that opens it answers along walks through them.

Answers are those of the localiser itself (`semloc_core.fleet.localiser_in`): of a map that is too large for one answer
from the buildings on its list.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from semloc_core import metrics
from semloc_core.config import MATCH_RADIUS_M, LocaliserConfig
from semloc_core.encoding import Model, embed_graph, general_model
from semloc_core.errors import GraphError
from semloc_core.evaluate.fit_confidence import draw_buildings
from semloc_core.evaluate.relocalise import make_arena, read_buildings, read_distractors
from semloc_core.evaluate.verified_answers import any_frame, written_in
from semloc_core.fleet import localiser_in
from semloc_core.graph import Floats, GraphArrays, Labelspace, load_labelspace, union
from semloc_core.localiser import Localiser
from semloc_core.map_database import PlaceRows, StoredBuilding, assemble, stored_building
from semloc_core.metrics import Progress, Row, expected_calibration_error, no_progress
from semloc_core.sources import KINDS, Walk, WalkConfig, draw_flat, walk
from semloc_core.text import short_repr
from semloc_core.wire import Match, PlaceMatches

SCOPES_M = (0.0, 2.5, 5.0, 10.0, 20.0, 40.0)
CONFIG = LocaliserConfig(explain_rate_hz=0.0)


@short_repr
@dataclass(frozen=True, eq=False)
class Town:
    """Buildings in one map, and second runs through the first of them.

    Args:
        maps: as mapped.
        again: as seen again, in the same frames.
        labelspace: of all.

    """

    maps: Sequence[GraphArrays]
    again: Sequence[GraphArrays]
    labelspace: Labelspace


def drawn_town(kind: str, buildings: int, plans: int = 0, lacks: float = 0.2, seed: int = 0) -> Town:
    """Generated buildings.

    Args:
        kind: `semloc_core.sources.KINDS`.
        buildings: how many.
        plans: so many plans that they share, as flats do; 0: no two are alike.
        lacks: share of its plan's furniture that each flat lacks.
        seed: of all that is drawn.

    """
    of = {str(name): one for name, one in KINDS.items()}[kind]
    if not plans:
        return Town(*draw_buildings(of, buildings, np.random.default_rng(seed)))
    space, maps, again = load_labelspace(of.labelspace), [], []
    for number in range(buildings):
        plan = np.random.default_rng([seed, number % plans, plans])
        pair = draw_flat(of, plan, np.random.default_rng([seed, number]), lacks)
        mapped, seen = (GraphArrays.from_scene_graph(world.graph, space, str(number)) for world in pair)
        maps.append(mapped)
        again.append(seen)
    return Town(maps, again, space)


def read_town(root: Path, distractors: Sequence[Path] = ()) -> Town:
    """Those of ROOT/*/map.json and query.json, and more that are only in the map (`read_distractors`)."""
    buildings, others = read_buildings(root), read_distractors(distractors)
    files = [file for building in buildings for file in (building.map, building.query)]
    arena = make_arena(buildings, union([file.labelspace for file in (*files, *others)]), others)
    return Town(arena.maps, arena.queries, arena.labelspace)


def mapped_building(name: str, home: GraphArrays, model: Model) -> tuple[StoredBuilding, PlaceRows]:
    """A building as a map has it."""
    order = np.argsort(np.array(home.place_ids, dtype=object))
    ids = tuple(home.place_ids[i] for i in order.tolist())
    stored = stored_building(name, home.to_scene_graph(model.labelspace), ids, {})
    embeddings = np.ascontiguousarray(embed_graph(model, home)[order])
    places = PlaceRows(ids, home.place_positions[order], embeddings)
    return replace(stored, storeys=tuple(home.storeys[order].tolist())), places


@short_repr
@dataclass(frozen=True)
class Said:
    """What one answer was worth.

    Args:
        status: of the message.
        probability: of its first match; 0 without one.
        right: so is that match.
        building: it is in the robot's building.
        among: the right place is the first match or one of the rivals.
        listed: the robot's building was among those that the answer could be in.

    """

    status: str
    probability: float
    right: bool
    building: bool
    among: bool
    listed: bool


def evaluate_town(
    town: Town, walks: int = 1, alone: bool = False, seed: int = 0, progress: Progress = no_progress
) -> list[Row]:
    """Ask along walks through second runs; each answer by itself, from all that was seen by then.

    Args:
        town: the buildings.
        walks: through each building that was seen again.
        alone: each of these buildings is a map of its own.
        seed: of walks and of the robots' frames.
        progress: told of every building.

    Returns:
        A row for each number of metres walked (``scope``): ``success@1`` with its interval over buildings; shares of
        all answers by status (``match``, ``ambiguous``, ``unknown``); ``wrong_match`` and ``wrong_building``, the
        shares that are matches and wrong, or in another building; ``rivals_right``, of ambiguous answers the share with
        the right place among first match and rivals; ``ece``; ``listed``, the share whose building was on the list.

    """
    model = general_model(town.maps, town.labelspace)
    names = [f"{number:05d}" for number in range(len(town.maps))]
    buildings = []
    for number, (name, home) in enumerate(zip(names, town.maps, strict=True)):
        progress(number, len(names), "into a map")
        buildings.append(mapped_building(name, home, model))
    whole = None if alone else localiser_in(assemble("town", model, buildings), CONFIG)
    found: dict[float, list[tuple[int, Said]]] = {metres: [] for metres in SCOPES_M}
    for number, graph in enumerate(town.again):
        progress(number, len(town.again), "walks")
        localiser = whole or localiser_in(assemble("one", model, buildings[number : number + 1]), CONFIG)
        for turn in range(walks):
            try:
                way = walk(graph, WalkConfig(distance_m=SCOPES_M[-1]), np.random.default_rng([seed, number, turn]))
            except GraphError:  # without two places that are joined
                continue
            for metres, said in zip(SCOPES_M, _along(localiser, names[number], way, town, seed), strict=True):
                found[metres].append((number, said))
    return [_row(f"{metres:g}m", said, seed) for metres, said in found.items()]


def _along(localiser: Localiser, name: str, way: Walk, town: Town, seed: int) -> Iterator[Said]:
    steps = np.minimum(np.searchsorted(way.metres, SCOPES_M), way.steps - 1)
    frame = any_frame(np.random.default_rng([seed, int(name)]))
    for step, truth in zip(steps.tolist(), way.at(steps).truth(), strict=True):
        part, place = way.part(step)
        graph = written_in(frame, part).to_scene_graph(town.labelspace)
        update = msgspec.structs.replace(graph.to_update(0, 0, "map"), query_place=part.place_ids[place])
        located = localiser.update(update).located
        assert located is not None  # a full update is never a repeated one
        yield _judged(localiser, located.matches, name, truth)


def _judged(localiser: Localiser, answer: PlaceMatches, name: str, truth: Floats) -> Said:
    def right(match: Match) -> bool:
        near = match.map == name and float(np.linalg.norm(np.subtract(match.position, truth))) <= MATCH_RADIUS_M
        x, y, z = truth.tolist()
        return near and localiser.same_storey(name, match.place, (x, y, z))

    first = answer.matches[:1]
    return Said(
        answer.status,
        first[0].probability if first else 0.0,
        any(map(right, first)),
        any(match.map == name for match in first),
        any(map(right, [*first, *(answer.rivals or ())])),
        name in localiser.map.buildings,
    )


def _row(scope: str, answers: Sequence[tuple[int, Said]], seed: int) -> Row:
    groups, said = np.array([number for number, _ in answers], dtype=np.int64), [each for _, each in answers]
    right = np.array([each.right for each in said])
    rng = np.random.default_rng(seed)
    own = groups if len(np.unique(groups)) > 1 else None
    low, high = metrics.bootstrap_interval(right.astype(np.float64), rng, groups=own)
    ambiguous = [each.among for each in said if each.status == "ambiguous"]
    row: Row = {"method": "semloc", "scope": scope, "queries": len(said)}
    row |= {"success@1": float(right.mean()), "success@1_low": low, "success@1_high": high}
    row |= {status: float(np.mean([e.status == status for e in said])) for status in ("match", "ambiguous", "unknown")}
    return row | {
        "wrong_match": float(np.mean([each.status == "match" and not each.right for each in said])),
        "wrong_building": float(np.mean([each.status == "match" and not each.building for each in said])),
        "rivals_right": float(np.mean(ambiguous)) if ambiguous else None,
        "ece": expected_calibration_error(np.array([each.probability for each in said]), right),
        "listed": float(np.mean([each.listed for each in said])),
    }
