"""Two generated homes, each as mapped and as seen again; drawn once."""

import numpy as np
import pytest

from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.sources.world import KINDS, draw_pair

Homes = tuple[list[GraphArrays], list[GraphArrays], Labelspace]


@pytest.fixture(scope="session")
def homes() -> Homes:
    """Maps, second runs in the same frames, labelspace."""
    rng = np.random.default_rng(5)
    pairs = [draw_pair(KINDS["home"], rng) for _ in range(2)]
    space = pairs[0][0].labelspace
    maps, again = (
        [GraphArrays.from_scene_graph(pair[i].graph, space, str(n)) for n, pair in enumerate(pairs)] for i in (0, 1)
    )
    return maps, again, space
