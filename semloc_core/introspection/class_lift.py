"""How much an object of a class counts, beside an object of any class."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats
from semloc_core.introspection.run import Run


def of_class(run: Run, names: Sequence[str]) -> NDArray[np.bool_]:
    """(O,) which of the query's objects are of some classes."""
    space = run.model.labelspace
    return np.isin(run.query.object_classes, [space.index(name) for name in names])


def lift(run: Run, method: str, names: Sequence[str], weight: Floats) -> float:
    """Share of the importance over what it would be if all objects in reach had the same, over all places."""
    mine = of_class(run, names)
    seen, shares = run.introspection.seen, run.introspection.shares[method]
    equal = float(weight @ (seen[:, mine].sum(1) / seen.sum(1)))
    return float(weight @ shares[:, mine].sum(1, dtype=np.float64)) / equal if equal > 0 else float("nan")
