"""Rigid transforms that keep the vertical: a turn about it and a shift. Robots know which way is up."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from semloc_core.graph import Floats


@dataclass(frozen=True)
class Transform:
    """x ↦ R(yaw) x + translation.

    Args:
        yaw: about the vertical, counterclockwise seen from above, radians.
        translation: metres.

    """

    yaw: float
    translation: tuple[float, float, float]

    @property
    def rotation(self) -> Floats:
        """(3, 3)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def apply(self, points: Floats) -> Floats:
        """(N, 3) points moved, metres."""
        moved: Floats = points @ self.rotation.T + np.array(self.translation)
        return moved


def fit_transform(source: Floats, target: Floats, weights: Floats) -> Transform:
    """The transform with the least weighted sum of squared distances from source to target.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns" (PAMI 1991), for a
    rotation about the vertical, where the singular value decomposition becomes an arc tangent.

    Args:
        source: (N, 3) metres, N ≥ 1.
        target: (N, 3) metres.
        weights: (N,) ≥ 0, not all 0.

    """
    share = weights / weights.sum()
    from_centre, to_centre = share @ source, share @ target
    p, q = source - from_centre, target - to_centre
    yaw = math.atan2(
        float(share @ (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])), float(share @ (p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1]))
    )
    turned = Transform(yaw, (0.0, 0.0, 0.0)).apply(from_centre[None])[0]
    x, y, z = (to_centre - turned).tolist()
    return Transform(yaw, (x, y, z))
