"""The scan by rings, of objects that may be of several classes or of any."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_core.evaluate.verified_answers import layout_verifier
from semloc_core.matching.layout.fragment import fragment_of_arrays
from semloc_core.matching.layout.ring_score import INVENTED, RING_CENTRES_M, _metres, _shares


@pytest.fixture(scope="module")
def asked(homes):
    maps, again, space = homes
    verifier = layout_verifier(tuple(maps), len(space))
    return verifier, fragment_of_arrays(again[0], again[0].n_places // 2, verifier.config)


def told(fragment, n_classes, likely):
    return replace(fragment, likely=np.array(likely, dtype=np.float64).reshape(-1, n_classes + 1))


def unnamed(fragment):
    """The same where no object has a class that it is rather of."""
    return replace(fragment, classes=np.full_like(fragment.classes, -1))


def sure(fragment, n_classes):
    return np.eye(n_classes + 1)[fragment.classes]


def test_what_is_of_one_class_for_sure_is_as_without_a_table(asked):
    verifier, fragment = asked
    c = len(verifier.mapped.invented)
    plain = verifier._scan.log_likelihood(fragment)
    assert np.array_equal(verifier._scan.log_likelihood(told(fragment, c, sure(fragment, c))), plain)


def test_rates_of_several_classes_add_up_by_how_often_each_is_called_so(asked):
    """Computed anew, place by place, of rates that nothing has taken logarithms of."""
    verifier, fragment = asked
    scan, c, rings = verifier._scan, len(verifier.mapped.invented), len(RING_CENTRES_M)
    few = unnamed(fragment._only(np.arange(len(fragment.classes)) < 2))
    likely = np.zeros((2, c + 1))
    likely[0, :3], likely[1, -1] = (0.5, 0.3, 0.2), 1.0
    scan.log_likelihood(fragment)  # of some rows the scan has logarithms now
    rate = scan._rate.astype(np.float64).reshape(c, rings, -1)
    invented, logged = scan._invented.astype(np.float64), scan._logged.reshape(c, rings)
    rate[logged] = np.exp(rate[logged])
    rate[~logged] += np.repeat(invented[:, None], rings, axis=1)[~logged][:, None]
    expected = scan._sure(few._only(np.zeros(2, dtype=np.bool_))).astype(np.float64)
    shares = _shares(_metres(few.objects))
    weight = likely[0, :3] / (invented[:3] / INVENTED)
    expected += shares[:, 0] @ np.log(np.einsum("c,crm->rm", weight, rate[:3]))
    expected += shares[:, 1] @ np.log(rate.sum(axis=0))
    for _ in range(2):  # the second time from what was kept
        assert scan.log_likelihood(told(few, c, likely)) == pytest.approx(expected, abs=2e-3)


def test_places_are_proposed_by_what_is_of_several_classes_alone(asked, homes):
    """A detector that calls every class one of two names: no object is of a class for sure."""
    (_, again, space), (verifier, fragment) = homes, asked
    c = len(space)
    often = np.bincount(verifier.mapped.object_classes, minlength=c) + 1e-9
    likely = np.zeros((len(fragment.classes), c + 1))
    for i, class_ in enumerate(fragment.classes.tolist()):
        group = np.arange(c) % 2 == class_ % 2
        likely[i, :-1][group] = (often / often[group].sum())[group]
    found = told(unnamed(fragment), c, likely)
    assert len(found.sure().classes) == 0
    place = again[0].place_positions[again[0].n_places // 2]
    rows = verifier.candidates(found, None)
    off = np.linalg.norm(verifier.mapped.positions[rows] - place, axis=1)
    assert off[verifier.mapped.building[rows] == 0].min() <= 2.0
    score = verifier._scan.log_likelihood(found)
    near = (np.linalg.norm(verifier.mapped.positions - place, axis=1) <= 2.0) & (verifier.mapped.building == 0)
    assert (score > score[near].max()).mean() < 0.1
