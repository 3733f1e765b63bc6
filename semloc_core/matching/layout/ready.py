"""What is compiled, compiled before anybody waits for it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from semloc_core.graph import GraphArrays
from semloc_core.matching.layout.compiled import compiled
from semloc_core.matching.layout.confidence import confidence
from semloc_core.matching.layout.fragment import fragment_of_arrays
from semloc_core.matching.layout.pose.placed import placed
from semloc_core.matching.layout.verifier import LayoutVerifier


@lru_cache(maxsize=1)
def ready() -> None:
    """Ask a room of two storeys once where it is itself, if anything is compiled, so that no update waits for that.

    The first time on a machine that takes some twenty seconds, then a second for each process.
    """
    if not compiled():
        return
    at = np.array([[x, 0.0, z] for z in (0.0, 6.0) for x in range(12)])
    edges = np.array([[i, i + 1] for i in range(len(at) - 1)], dtype=np.int64).T
    objects = np.array([[0.0, 2.0, 0.0], [3.0, -1.0, 0.5], [5.0, 1.5, 0.2], [1.0, 2.0, 6.0]])
    names, none = tuple(map(str, range(len(at)))), np.zeros((2, 0), dtype=np.int64)
    room = GraphArrays("room", names, at, edges, names[: len(objects)], objects, np.arange(len(objects)), none, none)
    verifier = LayoutVerifier([room, room], [np.arange(len(at))] * 2, len(objects))
    fragment = fragment_of_arrays(room, 2, verifier.config)
    tested = verifier.verify(fragment)
    assert tested is not None
    _ = confidence(tested, fragment, verifier.mapped).probability
    placed(verifier.mapped, fragment, tested, tested.rows[:1].tolist())


if __name__ == "__main__":
    ready()
