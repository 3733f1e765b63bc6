"""How far poses are from the truth, and whether their covariances mean what they say. Memory does not grow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from semloc_core.graph import Floats
from semloc_core.text import short_repr

_LOWEST, _RATIO, _BINS = 1e-3, 1.01, 2000
CHI2_95 = (3.841459, 5.991465, 7.814728)
"""95th percentile of χ² with 1, 2 and 3 degrees of freedom."""


class Histogram:
    """Percentiles of a stream of values, to 1 %, in fixed memory: logarithmic bins from a thousandth on."""

    def __init__(self) -> None:
        self._counts: NDArray[np.int64] = np.zeros(_BINS, dtype=np.int64)

    def add(self, value: float) -> None:
        """Count one value."""
        position = np.log(max(value, _LOWEST) / _LOWEST) / np.log(_RATIO)
        self._counts[min(int(position), _BINS - 1)] += 1

    def percentile(self, percent: float) -> float | None:
        """The value that ``percent`` of the values do not exceed; None where none was counted."""
        total = int(self._counts.sum())
        if total == 0:
            return None
        position = int(np.searchsorted(np.cumsum(self._counts), np.ceil(total * percent / 100.0)))
        return float(_LOWEST * _RATIO ** (position + 0.5))


@short_repr
@dataclass
class PoseErrors:
    """The errors of poses whose places are right."""

    position_m: Histogram = field(default_factory=Histogram)
    heading_deg: Histogram = field(default_factory=Histogram)
    count: int = 0
    nees: float = 0.0
    inside: int = 0

    def add(self, position: Sequence[float] | Floats, heading: float | None, covariance: Floats) -> None:
        """Count one pose.

        Args:
            position: (3,) its position less the true one, metres.
            heading: its heading less the true one, radians; None where either is not known.
            covariance: (4, 4) of x, y, z and yaw, as said with it.

        """
        x, y, z = (float(value) for value in position)
        self.position_m.add(math.sqrt(x * x + y * y + z * z))
        error, kept = [x, y], [0, 1]
        if heading is not None:
            turned = math.remainder(heading, 2 * math.pi)
            self.heading_deg.add(abs(math.degrees(turned)))
            error, kept = [x, y, turned], [0, 1, 3]
        said = np.array(covariance)[np.ix_(kept, kept)]
        off = float(np.array(error) @ np.linalg.lstsq(said, np.array(error), rcond=None)[0])
        self.count += 1
        self.nees += off / len(kept)
        self.inside += off <= CHI2_95[len(kept) - 1]

    def figures(self) -> dict[str, float | None]:
        """Median and 90th percentile of the errors; None where there are none.

        ``nees`` is the normalised squared error of x, y and yaw per degree of freedom (1: the covariance means what
        it says), ``coverage`` the share of the poses whose 95 % region holds the truth.
        """
        return {
            "position_error_m": self.position_m.percentile(50),
            "position_error_m_p90": self.position_m.percentile(90),
            "heading_error_deg": self.heading_deg.percentile(50),
            "heading_error_deg_p90": self.heading_deg.percentile(90),
            "nees": self.nees / self.count if self.count else None,
            "coverage": self.inside / self.count if self.count else None,
        }
