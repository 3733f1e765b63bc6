"""An office that is walked through again, for the tests of merging."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model
from semloc_core.evaluate.merge_cases import WORLD
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.map_merge.transform import Transform
from semloc_core.sources.world import make_office
from semloc_core.training.config import PerturbConfig
from semloc_core.training.views.perturb import perturb

ONE_LINE = r"^expected [^\n]* \(got [^\n]*\)$"
ELSEWHERE = Transform(2.1, (31.0, -12.0, 4.0))
"""From the building's frame into that of a robot's odometry."""
AGAIN = PerturbConfig(mobility_scale=0.0, jitter_m=0.1, drop_probability=0.2, false_ratio=0.1, resample_probability=1.0)


@cache
def office(seed: int = 0) -> tuple[GraphArrays, Labelspace]:
    world = make_office(WORLD, np.random.default_rng(seed))
    return GraphArrays.from_scene_graph(world.graph, world.labelspace), world.labelspace


def rings(space: Labelspace) -> Model:
    return Model(build_encoder("rings", None, len(space)), space)


def seen_again(arrays: GraphArrays, space: Labelspace, seed: int = 0, into: Transform = ELSEWHERE) -> SceneGraph:
    """As a detector sees it on another day, from another frame."""
    graph = perturb(arrays, space, AGAIN, np.random.default_rng(seed))
    return moved(graph, into).to_scene_graph(space)


def moved(arrays: GraphArrays, into: Transform) -> GraphArrays:
    positions, objects = into.apply(arrays.place_positions), into.apply(arrays.object_positions)
    return replace(arrays, place_positions=positions, object_positions=objects)


def inverse(transform: Transform) -> Transform:
    back = Transform(-transform.yaw, (0.0, 0.0, 0.0))
    x, y, z = back.apply(-np.array([transform.translation]))[0].tolist()
    return Transform(-transform.yaw, (x, y, z))
