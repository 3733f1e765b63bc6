"""Fits `matching.layout.confidence` on generated buildings: ``python -m semloc_core.evaluate.fit_confidence``.

No real building is read. Homes and offices are drawn, each mapped once and seen again by a detector of any quality; a
robot walks through the second run, and each fragment of its graph is asked in maps of few buildings and of many, with
its own among them and without.
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
from semloc_core.errors import GraphError
from semloc_core.evaluate.verified_answers import fragments_along, layout_verifier
from semloc_core.files import write_whole
from semloc_core.graph import Floats, GraphArrays, Labelspace, load_labelspace
from semloc_core.matching import FEATURES, Calibration, LayoutVerifier, features
from semloc_core.sources import KINDS, BuildingKind, WalkConfig, draw_pair, walk
from semloc_core.training import PerturbConfig, perturb

BUILDINGS = 24
"""Buildings of each kind."""
WALKS = 12
"""Walks through each."""
LONGEST_M = 60.0
AWAY_WEIGHT = 0.25
"""Weight of an answer given in a building that the map does not have, against one given at home."""
TWINS = 0.15
"""Share of the answers at home whose building has a twin in the map: two floors of one plan, furnished alike."""
PENALTY = 0.3
"""Inverse of the L2 penalty (scikit-learn's ``C``)."""

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Examples:
    """N answers.

    Args:
        x: (N, F) of `features`.
        right: (N,) the best place is within the match radius of the robot.
        at_home: (N,) the robot's building is in the map.

    """

    x: Floats
    right: Bools
    at_home: Bools


def draw_buildings(
    kind: BuildingKind, number: int, rng: np.random.Generator
) -> tuple[list[GraphArrays], list[GraphArrays], Labelspace]:
    """Buildings as mapped and, in the same frames, as seen again by detectors from good to bad."""
    space = load_labelspace(kind.labelspace)
    maps, again = [], []
    for index in range(number):
        mapped, seen = (GraphArrays.from_scene_graph(w.graph, space, str(index)) for w in draw_pair(kind, rng))
        worse = PerturbConfig(
            mobility_scale=0.0,
            jitter_m=float(rng.uniform(0.0, 0.45)),
            drop_probability=float(rng.uniform(0.0, 0.15)),
            false_ratio=float(rng.uniform(0.0, 0.3)),
            mislabel_probability=float(rng.uniform(0.0, 0.1)),
        )
        maps.append(mapped)
        again.append(perturb(seen, space, worse, rng))
    return maps, again, space


def gather(
    maps: Sequence[GraphArrays], again: Sequence[GraphArrays], n_classes: int, walks: int, rng: np.random.Generator
) -> Examples:
    """Answers along walks through the second runs, at home and away."""
    # Each building's twin is in the database too, but asked only now and then.
    verifier = layout_verifier((*maps, *maps), n_classes)
    found = [
        example
        for building, graph in enumerate(again)
        for _ in range(walks)
        for example in _walked(verifier, building, len(maps), graph, rng)
    ]
    x, right, at_home = zip(*found, strict=True)
    return Examples(np.array(x), np.array(right), np.array(at_home))


def fit(examples: Examples) -> Calibration:
    """Two logistic regressions on the figures, their squares and products."""
    from sklearn.linear_model import LogisticRegression

    x = examples.x
    blank = Calibration(
        features=FEATURES,
        mean=tuple(np.round(x.mean(axis=0), 6).tolist()),
        deviation=tuple(np.round(np.maximum(x.std(axis=0), 1e-3), 6).tolist()),
        right=(),
        in_map=(),
    )
    terms = blank.terms(x)
    weight = np.where(examples.at_home, 1.0, AWAY_WEIGHT)
    heads = []
    for truth in (examples.right, examples.at_home):
        model = LogisticRegression(C=PENALTY, max_iter=5000).fit(terms[:, 1:], truth, sample_weight=weight)
        heads.append(tuple(np.round([*model.intercept_, *model.coef_[0]], 6).tolist()))
    return msgspec.structs.replace(blank, right=heads[0], in_map=heads[1])


def _walked(
    verifier: LayoutVerifier, building: int, n_buildings: int, graph: GraphArrays, rng: np.random.Generator
) -> Iterator[tuple[Floats, bool, bool]]:
    mapped = verifier.mapped
    try:
        way = walk(graph, WalkConfig(distance_m=LONGEST_M), rng)
    except GraphError:  # a building without two places that are joined
        return
    metres = [0.0, *np.exp(rng.uniform(0.0, np.log(LONGEST_M), 3))]
    steps = np.unique(np.minimum(np.searchsorted(way.metres, metres), way.steps - 1)).astype(np.int64)
    others = np.array([b for b in range(n_buildings) if b != building])
    for step, fragment in zip(steps, fragments_along(way, steps, verifier, rng), strict=True):
        some = rng.permutation(others)[: int(np.ceil(len(others) ** rng.uniform()))]
        for at_home in (True, False):
            asked = some
            if at_home:
                asked = np.append(some, building)
                if rng.random() < TWINS:
                    asked = np.append(asked, building + n_buildings)
            only = np.isin(mapped.building, asked)
            answer = verifier.verify(fragment, only=only)
            if answer is None:
                continue
            best = answer.rows[0]
            off = np.linalg.norm(mapped.positions[best] - way.positions[way.places[step]])
            right = bool(off <= MATCH_RADIUS_M and mapped.building[best] == building)
            yield features(answer, fragment, mapped), right, at_home


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, walk, fit, write."""
    parser = argparse.ArgumentParser(description="Fit the probabilities of verified answers on generated buildings.")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--buildings", type=int, default=BUILDINGS, help="of each kind")
    parser.add_argument("--walks", type=int, default=WALKS, help="through each building")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    parts = []
    for kind in KINDS.values():
        maps, again, space = draw_buildings(kind, options.buildings, rng)
        parts.append(gather(maps, again, len(space), options.walks, rng))
    joined = Examples(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("x", "right", "at_home")))
    write_whole(options.output, msgspec.json.format(msgspec.json.encode(fit(joined)), indent=1) + b"\n")


if __name__ == "__main__":
    main()
