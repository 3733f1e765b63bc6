"""What `map info` says of how many objects tell places apart, in words that fit the number."""

from semloc_core.cli.maps.good_for import classes_of


def test_one_object_and_several_are_said_as_such() -> None:
    assert classes_of(1) == "the class of the nearest object tells"
    assert classes_of(3) == "the classes of the 3 nearest objects tell"
