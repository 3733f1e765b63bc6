"""Detections beside graphs: what a field of view hides is told apart."""

import numpy as np
import pytest

from semloc_core.encoding.model import Model
from semloc_core.evaluate import evaluate_detections
from semloc_core.evaluate.detections import WAYS, in_view, without
from semloc_core.graph import UpdateStream
from semloc_core.sources import KINDS, SimulationConfig, draw_pair, simulate_traversal, write_hydra


@pytest.fixture(scope="module")
def home():
    return draw_pair(KINDS["home"], np.random.default_rng(5))[1]


def updates(graph, seed, metres=8.0):
    config = SimulationConfig.of(distance_m=metres, shared_frame=True, fresh_ids=False)
    return [step.update for step in simulate_traversal(graph, config, np.random.default_rng(seed))]
