"""All places of a map scanned, compiled: `ring_score.CoarseScan`.

What is compiled here is kept beside this file and is made anew when this file changes, and no other: constants of other
files are arguments.
"""

from __future__ import annotations

import numpy as np

from semloc_core.graph import Ints
from semloc_core.matching.layout.compiled.kernel import kernel
from semloc_core.matching.layout.compiled.tables import Floats32

_BLOCK = 1024


@kernel
def scan(
    at: Ints, seen: Floats32, rate: Floats32, known: Floats32, total: Floats32, room: Floats32, shape: np.float32
) -> Floats32:
    """(M,) log-likelihood of each place of the map.

    Args:
        at: (K,) rows of the rates.
        seen: (K,) how many objects were seen of each.
        rate: (…, M) logarithms.
        known: (R,) places known in each ring.
        total, room: (R, M) as of `ring_score.Rings`.
        shape: what a place more than there is room for costs.

    """
    m = rate.shape[1]
    found = np.zeros(m, np.float32)
    for first in range(0, m, _BLOCK):
        last = min(first + _BLOCK, m)
        for k in range(len(at)):
            row, weight = at[k], seen[k]
            for i in range(first, last):
                found[i] += weight * rate[row, i]
        for r in range(len(known)):
            e = known[r]
            for i in range(first, last):
                found[i] -= e * total[r, i] + shape * max(e - room[r, i], np.float32(0.0))
    return found
