"""Fits `matching.layout.confidence` on generated buildings: ``python -m semloc_core.evaluate.fit_confidence``.

No real building is read. Homes and offices are drawn, of one storey or several, some of them towers of floors that are
alike, each mapped once and seen again by a detector of any quality, from centimetres to half a metre; a robot walks
through the second run, on the same day or on another when much has changed, and each fragment of its graph is asked in
maps of few buildings and of many, with its own among them and without.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.errors import SemlocError
from semloc_core.evaluate.online.another_day import AnotherDay, changed
from semloc_core.evaluate.verified_answers import fragments_along, layout_verifier
from semloc_core.files import CALIBRATION, Output, guarded, write_whole
from semloc_core.graph import Floats, GraphArrays, Labelspace, load_labelspace, storey_at
from semloc_core.matching import (
    FEATURES,
    MOST_SURE,
    Calibration,
    LayoutVerifier,
    Tested,
    features,
    near_figures,
    other_figures,
    perfect,
)
from semloc_core.sources import (
    KINDS,
    BuildingKind,
    SecondRun,
    Walk,
    WalkConfig,
    draw_pair,
    draw_stacked,
    walks_through,
)
from semloc_core.text import short_repr
from semloc_core.training import PerturbConfig, perturb

BUILDINGS = 36
"""Buildings of each kind."""
WALKS = 14
"""Walks through each."""
NOISE_M = (0.02, 0.5)
"""Bounds of a detector's error in a position, per axis, metres; its logarithm is drawn evenly."""
CHANGED = 0.5
"""Share of the walks that are made on another day, when up to `MOST_CHANGED` of the objects …"""
MOST_CHANGED = AnotherDay(mislabelled=0.3, gone=0.4, moved=0.3)
"""… have another name, are gone, were moved."""
LONGEST_M = 60.0
AWAY_WEIGHT = 0.25
"""Weight of an answer given in a building that the map does not have, against one given at home."""
TWINS = 0.15
"""Share of the answers at home whose building has a twin in the map, of the same plan and furniture."""
STOREYS = 0.5
"""Share of the buildings that have two or three storeys; of these `ALIKE` are towers of floors that are alike."""
ALIKE = 0.4
PENALTY = 0.3
"""Inverse of the L2 penalty (scikit-learn's ``C``)."""

EXACT = SecondRun(noise_m=0.0)

Bools = NDArray[np.bool_]


@short_repr
@dataclass(frozen=True, eq=False)
class Example:
    """One answer.

    Args:
        x: (F,) of `features`.
        right: the best answer is right, by its place nearest to where it has the robot.
        at_home: the robot's building is in the map.
        share: of the best answer in the belief, by likelihood.
        score: (A,) of the other answers.
        others: (A,) which of them are right, in the same way.
        perfect: the best score that there could be.
        n_objects: seen.
        away: (K,) metres of places from where an answer that is right has the robot.
        near: (K,) which of them are right.

    """

    x: Floats
    right: bool
    at_home: bool
    share: float
    score: Floats
    others: Bools
    perfect: float
    n_objects: int
    away: Floats
    near: Bools


def draw_buildings(
    kind: BuildingKind, number: int, rng: np.random.Generator, storeys: float = 0.0
) -> tuple[list[GraphArrays], list[GraphArrays], Labelspace]:
    """Buildings as mapped and, in the same frames, as seen again by detectors from good to bad.

    Args:
        kind: of building.
        number: how many.
        rng: the only source of randomness.
        storeys: share of those of two or three storeys.

    """
    space = load_labelspace(kind.labelspace)
    maps, again = [], []
    for index in range(number):
        if storeys and rng.random() < storeys:
            alike, lacking = bool(rng.random() < ALIKE), float(rng.uniform(0.0, 0.3))
            pair = draw_stacked(kind, int(rng.integers(2, 4)), rng, alike=alike, changed=lacking, run=EXACT)
        else:
            pair = draw_pair(kind, rng, EXACT)
        mapped, seen = (GraphArrays.from_scene_graph(w.graph, space, str(index)) for w in pair)
        worse = PerturbConfig(
            mobility_scale=0.0,
            jitter_m=float(np.exp(rng.uniform(*np.log(NOISE_M)))),
            drop_probability=float(rng.uniform(0.0, 0.15)),
            false_ratio=float(rng.uniform(0.0, 0.3)),
            mislabel_probability=float(rng.uniform(0.0, 0.1)),
        )
        maps.append(mapped)
        again.append(perturb(seen, space, worse, rng))
    return maps, again, space


def gather(
    maps: Sequence[GraphArrays], again: Sequence[GraphArrays], n_classes: int, walks: int, rng: np.random.Generator
) -> list[Example]:
    """Answers along walks through the second runs, at home and away."""
    # Each building's twin is in the database too, but asked only now and then.
    verifier = layout_verifier((*maps, *maps), n_classes)
    return [
        example
        for building, graph in enumerate(again)
        for _ in range(walks)
        for way in walks_through(_some_day(graph, n_classes, rng), WalkConfig(distance_m=LONGEST_M), rng, 1)
        for example in _walked(verifier, building, maps, way, rng)
    ]


def _some_day(graph: GraphArrays, n_classes: int, rng: np.random.Generator) -> GraphArrays:
    """A building as it was when it was mapped, or on another day."""
    if rng.random() >= CHANGED:
        return graph
    most = msgspec.structs.asdict(MOST_CHANGED)
    day = AnotherDay(**{name: float(rng.uniform(0.0, share)) for name, share in most.items()})
    return changed(graph, day, n_classes, rng)


def fit(examples: Sequence[Example]) -> Calibration:
    """Logistic regressions: two on the figures, their squares and products; then those of other answers and places."""
    from sklearn.linear_model import LogisticRegression

    def fitted(x: Floats, truth: Bools, weight: Floats) -> tuple[float, ...]:
        model = LogisticRegression(C=PENALTY, max_iter=5000).fit(x[:, 1:], truth, sample_weight=weight)
        return tuple(np.round([*model.intercept_, *model.coef_[0]], 6).tolist())

    x = np.array([e.x for e in examples])
    blank = Calibration(
        features=FEATURES,
        mean=tuple(np.round(x.mean(axis=0), 6).tolist()),
        deviation=tuple(np.round(np.maximum(x.std(axis=0), 1e-3), 6).tolist()),
        right=(),
        in_map=(),
        others=(),
        near=(),
    )
    terms = blank.terms(x)
    at_home = np.array([e.at_home for e in examples])
    weight = np.where(at_home, 1.0, AWAY_WEIGHT)
    right, in_map = (fitted(terms, truth, weight) for truth in (np.array([e.right for e in examples]), at_home))
    best, home = (1.0 / (1.0 + np.exp(-terms @ np.array(head))) for head in (right, in_map))
    home = np.maximum(best, home)
    best = np.minimum(best, np.array([e.share for e in examples]) * np.minimum(home, MOST_SURE))
    figures = [
        other_figures(e.score, b, h, e.perfect, e.n_objects)
        for e, b, h in zip(examples, best.tolist(), home.tolist(), strict=True)
        if len(e.score)
    ]
    counts = np.array([len(e.score) for e in examples])
    near = np.concatenate([near_figures(e.away, e.n_objects) for e in examples])
    return msgspec.structs.replace(
        blank,
        right=right,
        in_map=in_map,
        others=fitted(np.concatenate(figures), np.concatenate([e.others for e in examples]), np.repeat(weight, counts)),
        near=fitted(near, np.concatenate([e.near for e in examples]), np.ones(len(near))),
    )


def _walked(
    verifier: LayoutVerifier, building: int, maps: Sequence[GraphArrays], way: Walk, rng: np.random.Generator
) -> Iterator[Example]:
    mapped, own = verifier.mapped, maps[building]
    metres = [0.0, *np.exp(rng.uniform(0.0, np.log(LONGEST_M), 3))]
    steps = np.unique(np.minimum(np.searchsorted(way.metres, metres), way.steps - 1)).astype(np.int64)
    others = np.array([b for b in range(len(maps)) if b != building])
    for step, fragment in zip(steps, fragments_along(way, steps, verifier, rng), strict=True):
        truth = way.positions[way.places[step]]
        first = int(np.searchsorted(mapped.building, building))
        right = np.zeros(mapped.n_places, dtype=np.bool_)
        off = np.linalg.norm(own.place_positions - truth, axis=1)
        same = own.storeys == storey_at(truth, own.place_positions, own.storeys)
        right[first : first + own.n_places] = (off <= MATCH_RADIUS_M) & same
        some = rng.permutation(others)[: int(np.ceil(len(others) ** rng.uniform()))]
        for at_home in (True, False):
            asked = some
            if at_home:
                asked = np.append(some, building)
                if rng.random() < TWINS:
                    asked = np.append(asked, building + len(maps))
            answer = verifier.verify(fragment, only=np.isin(mapped.building, asked))
            if answer is None:
                continue
            found = Tested.of(answer, mapped)
            nearest = answer.rows[[found.nearest(a, mapped, answer.rows) for a in found.separate]]
            so = right[nearest]
            at = int(np.argmax(so))
            beside = (mapped.storey == found.storey[found.separate[at]]) & bool(so.any())
            away = np.linalg.norm(mapped.positions - found.pose[found.separate[at]], axis=1)
            beside &= away <= 2 * MATCH_RADIUS_M
            yield Example(
                x=features(answer, fragment, mapped),
                right=bool(so[0]),
                at_home=at_home,
                share=float(found.masses(1.0)[0]),
                score=found.score[found.separate[1:]],
                others=so[1:],
                perfect=perfect(fragment, mapped),
                n_objects=len(fragment.classes),
                away=away[beside],
                near=right[beside],
            )


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, walk, fit, write."""
    parser = argparse.ArgumentParser(description="Fit the probabilities of verified answers on generated buildings.")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--buildings", type=int, default=BUILDINGS, help="of each kind")
    parser.add_argument("--walks", type=int, default=WALKS, help="through each building")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--force", action="store_true", help="replace a calibration that is there")
    options = parser.parse_args(arguments)
    try:
        with guarded([Output("--output", options.output, CALIBRATION)], [], force=options.force):
            write_whole(options.output, calibration(options.buildings, options.walks, options.seed))
    except SemlocError as error:
        parser.error(str(error))


def calibration(buildings: int, walks: int, seed: int) -> bytes:
    """The file: fitted on walks through so many buildings of each kind."""
    rng = np.random.default_rng(seed)
    examples: list[Example] = []
    for kind in KINDS.values():
        maps, again, space = draw_buildings(kind, buildings, rng, STOREYS)
        examples += gather(maps, again, len(space), walks, rng)
    return msgspec.json.format(msgspec.json.encode(fit(examples)), indent=1) + b"\n"


if __name__ == "__main__":
    main()
