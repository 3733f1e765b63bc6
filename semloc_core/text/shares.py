"""Shares, and parts of a sum, as a person reads them."""

from __future__ import annotations

import math
from collections.abc import Sequence

WHOLE = 1e-6
"""What a share may lack of 1 by rounding, where it is a sum of single-precision numbers."""


def percent(share: float, digits: int = 0, *, signed: bool = False) -> str:
    """A share as a percentage, which never says none for what is there nor all for what is not.

    Args:
        share: 0.25 for a quarter; may be negative or above 1.
        digits: after the point.
        signed: with a plus sign, too.

    Returns:
        ``25%``; ``<1%`` for less than half a percent that is more than nothing (``-<1%`` below zero); ``>99%`` for
        more than 99.5 % that is less than all.

    """
    size, step = abs(share), 10.0**-digits
    sign = "-" if share < 0 else "+" if signed and share > 0 else ""
    shown = f"{size:.{digits}%}"
    if size and float(shown[:-1]) == 0:
        shown = f"<{step:.{digits}f}%"
    elif size < 1 - WHOLE and float(shown[:-1]) == 100:
        shown = f">{100 - step:.{digits}f}%"
    return sign + shown


def summing(parts: Sequence[float], digits: int = 0, total: float | None = None) -> list[float]:
    """Round parts so that, as printed, they add up to their sum as it is printed.

    By largest remainders: no part is off by as much as its last digit.

    Args:
        parts: of a sum.
        digits: after the point.
        total: the sum, where it is known more exactly; None: it is added up.

    """
    unit = 10**digits
    scaled = [part * unit for part in parts]
    whole = [math.floor(part) for part in scaled]
    left = round(round(math.fsum(parts) if total is None else total, digits) * unit) - sum(whole)
    order = sorted(range(len(parts)), key=lambda i: (whole[i] - scaled[i], i))
    for i in order[:left]:
        whole[i] += 1
    return [part / unit for part in whole]
