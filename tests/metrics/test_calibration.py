"""Honesty of probabilities: the figures that the reports state."""

import numpy as np
import pytest

from semloc_core.evaluate.fit_confidence import Example, draw_buildings, fit, gather
from semloc_core.matching.layout.answers import near_figures
from semloc_core.metrics.calibration import accepted_share, expected_calibration_error, reliability
from semloc_core.sources.world import KINDS


def test_the_calibration_error_by_hand():
    said = np.array([0.95, 0.95, 0.95, 0.95, 0.25, 0.25])
    so = np.array([True, True, True, False, False, False])
    # 4 of 6 in a bin that says .95 and has .75, 2 in one that says .25 and has 0.
    assert expected_calibration_error(said, so) == pytest.approx((4 * 0.2 + 2 * 0.25) / 6)
    assert reliability(said, so) == [(0.25, 0.0, 2 / 6), (pytest.approx(0.95), 0.75, 4 / 6)]
    assert expected_calibration_error(np.array([1.0, 0.0]), np.array([True, False])) == 0
    assert np.isnan(expected_calibration_error(np.zeros(0), np.zeros(0, dtype=bool)))


def test_what_a_threshold_accepts():
    home, abroad = np.linspace(0.1, 1.0, 10), np.array([0.05, 0.15, 0.6, 0.2])
    right = np.ones(10, dtype=bool)
    assert accepted_share(home, abroad, right)["foreign_accepted"] == 0.75
    assert accepted_share(home, abroad, ~right)["foreign_accepted"] is None


def test_a_fit_learns_what_is_worth_believing():
    """From a few walks already: answers at home are believed more than those given in a building that is not there."""
    rng = np.random.default_rng(1)
    maps, again, space = draw_buildings(KINDS["home"], 2, rng)
    found = gather(maps, again, len(space), 2, rng)
    assert all(isinstance(one, Example) for one in found)
    right, at_home = (np.array([getattr(one, name) for one in found]) for name in ("right", "at_home"))
    assert right.any()
    assert not right[~at_home].any()
    assert (~at_home).any()
    calibration = fit(found)
    terms = calibration.terms(np.array([one.x for one in found]))
    believed = terms @ np.array(calibration.right)
    assert believed[right].mean() > believed[~at_home].mean() + 1
    known = terms @ np.array(calibration.in_map)
    assert known[at_home].mean() > known[~at_home].mean()
    near, far = near_figures(np.array([0.5, 6.0]), 20) @ np.array(calibration.near)
    assert near > 0 > far, "a place beside where the robot is is right, one beyond the match radius is not"
