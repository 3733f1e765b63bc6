"""Chances of places that can't all be right, compiled: `answers` of the room above.

What is compiled here is kept beside this file and is made anew when this file changes, and no other: constants of other
files are arguments.
"""

from __future__ import annotations

import numpy as np

from semloc_core.graph import Floats, Ints
from semloc_core.matching.layout.compiled.kernel import kernel


@kernel
def shared(chance: Floats, at: Floats, building: Ints, apart_m: float, times: int, none: float) -> Floats:
    """(K,) as of `answers._shared`.

    Args:
        chance: (K,) of each place.
        at: (K, 3) metres.
        building: (K,) of each.
        apart_m: two places further apart can't both be right.
        times: how often chances are lowered at most.
        none: chances below don't count.

    """
    chance = chance.copy()
    for _ in range(times):
        order = np.argsort(-chance, kind="mergesort")
        n = 0
        while n < len(order) and chance[order[n]] > none:
            n += 1
        left, elsewhere = order[:n].copy(), order[:n]
        total = 0.0
        while n:
            first, kept = left[0], 0
            for i in range(n):
                other = left[i]
                ax, ay, az = at[other, 0] - at[first, 0], at[other, 1] - at[first, 1], at[other, 2] - at[first, 2]
                if building[other] != building[first] or ax * ax + ay * ay + az * az > apart_m * apart_m:
                    left[kept] = other
                    kept += 1
            if total == 0.0:
                elsewhere = left[:kept].copy()
            total += chance[first]
            n = kept
        if total <= 1.0:
            break
        best = chance[order[0]]
        for other in elsewhere:
            chance[other] *= (1.0 - best) / (total - best)
    return chance
