"""A person says about where the robot is: of places that look the same, the one that is meant is found."""

from __future__ import annotations

import pytest
from small_building import building_update, delta, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.localiser import Localiser
from semloc_core.tracking.hint import LASTS_M, Hint

SURE = LocaliserConfig(accept_probability=0.75)  # of two that are the same each has a half


@pytest.fixture(scope="module")
def twins(tmp_path_factory):
    """A map of two buildings that are the same."""
    path = tmp_path_factory.mktemp("twins") / "twins.map"
    return make_map(path, make_model("rings"), here=building_update(), there=building_update())


@pytest.mark.parametrize("name", ["here", "there"])
def test_of_two_buildings_that_are_the_same_the_one_meant_is_found(twins, name):
    localiser = Localiser(twins, SURE)
    assert localiser.update(building_update()).matches.status == "ambiguous"
    localiser.hint(Hint([name], (5.0, 0.0), 4.0))
    found = localiser.update(building_update()).matches
    assert (found.status, found.matches[0].map, found.matches[0].place) == ("match", name, "p5")
    assert found.rivals == []
    localiser.hint(None)
    assert localiser.update(building_update()).matches.status == "ambiguous"


def test_a_hint_is_forgotten_when_the_robot_has_walked_on_and_when_the_map_is_another(twins, tmp_path):
    localiser = Localiser(twins, SURE)
    localiser.hint(Hint(["there"], (5.0, 0.0), 4.0))
    assert localiser.update(building_update()).matches.status == "match"
    same = localiser.renewed()
    same.take_over(localiser)
    assert same.update(delta(1, query="p5")).matches.status == "match"
    last = 5 + round(LASTS_M)
    for seq, place in enumerate(range(6, last + 1), 2):
        assert same.update(delta(seq, query=f"p{place}")).matches.matches[0].map == "there"
    assert same.update(delta(seq + 1, query=f"p{last + 1}")).matches.status == "ambiguous"

    hinted = Localiser(twins, SURE)
    hinted.hint(Hint(["there"], (5.0, 0.0), 4.0))
    other = make_map(tmp_path / "other.map", make_model("rings"), there=building_update(), third=building_update())
    swapped = Localiser(other, SURE)
    swapped.take_over(hinted)
    assert swapped.update(building_update()).matches.status == "ambiguous"


def test_a_hint_of_nowhere_narrows_nothing(twins):
    localiser = Localiser(twins, SURE)
    localiser.hint(Hint(["elsewhere"], (5.0, 0.0), 4.0))
    assert localiser.update(building_update()).matches.status == "ambiguous"
    localiser.hint(Hint(["here", "there"], (500.0, 0.0), 4.0))
    assert localiser.update(building_update()).matches.status == "ambiguous"
