"""Ids as people read them: breaks if what is printed can't be typed back."""

import pytest

from semloc_core.graph.node_ids import full_id, short_id

P86 = str(ord("p") << 56 | 86)
O0 = str(ord("O") << 56)


@pytest.mark.parametrize(
    ("id_", "shown"), [(P86, "p86"), (O0, "O0"), (str(ord("p") << 56 | (1 << 56) - 1), f"p{2**56 - 1}")]
)
def test_a_64_bit_id_is_a_letter_and_a_number_and_can_be_typed_back(id_, shown):
    assert short_id(id_) == shown
    assert full_id(shown, {id_}) == id_
    assert full_id(f"{shown[0]}({shown[1:]})", {id_}) == id_
    assert full_id(id_, {id_}) == id_


@pytest.mark.parametrize(
    "id_", ["0", "86", "place 3", "p86", "", "²", "9" * 30, str(ord("[") << 56), str(1 << 63), "-5"]
)
def test_other_ids_are_as_they_are(id_):
    assert short_id(id_) == id_
    assert full_id(id_, {id_}) == id_


def test_a_graph_that_has_the_typed_id_itself_means_that():
    assert full_id("p86", {"p86", P86}) == "p86"


def test_what_means_nothing_known_is_given_back_for_the_refusal():
    assert full_id("p87", {P86}) == "p87"
    assert full_id("p" + "9" * 17, {P86}) == "p" + "9" * 17
