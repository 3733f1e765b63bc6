"""Probabilities: mass near a place counts for it, and the same map rows never count twice."""

import numpy as np
import pytest

from semloc_core.matching.posterior import modes, place_probabilities


def pairs(row):  # places 2k and 2k+1 are near each other
    return np.array([row - row % 2, row - row % 2 + 1])


def test_probability_is_the_softmax_mass_within_the_radius():
    similarities = np.log(np.array([4.0, 2.0, 1.0, 1.0], dtype=np.float32))
    assert place_probabilities(similarities, 1.0, np.array([0, 1, 2]), pairs) == pytest.approx([0.75, 0.75, 0.25])


def test_a_low_temperature_sharpens_and_large_values_do_not_overflow():
    similarities = np.array([1.0, 0.0, 0.9, 0.0], dtype=np.float32)
    sharp = place_probabilities(similarities, 1e-3, np.array([0, 2]), pairs)
    assert np.isfinite(sharp).all()
    assert sharp[0] == pytest.approx(1.0)
    assert sharp[1] < 1e-12


def test_modes_keep_the_best_place_of_each_neighbourhood():
    assert modes(np.array([3, 2, 0, 1, 5]), pairs) == [3, 0, 5]
