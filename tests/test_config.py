"""Options have one source; a value out of range must be refused by name, not clipped or taken."""

import pytest

from semloc_core.config import LocaliserConfig, checked, options
from semloc_core.errors import ConfigError


def test_every_option_is_described_and_its_default_is_valid():
    for option in options(LocaliserConfig):
        assert option.description, option.name
        checked(LocaliserConfig, **{option.name: option.default})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("top_n", 0),
        ("top_n", 101),
        ("top_n", 2.5),
        ("accept_probability", 1.01),
        ("accept_probability", float("nan")),
        ("explain_rate_hz", -1.0),
        ("explainer", "oracle"),
        ("max_update_bytes", 1),
        ("no_such_option", 1),
    ],
)
def test_out_of_range_is_refused(name, value):
    with pytest.raises(ConfigError, match=name):
        checked(LocaliserConfig, **{name: value})


def test_the_line_says_what_was_expected_and_what_came():
    with pytest.raises(ConfigError, match=r"^expected rerank to be one of none, layout \(got 'both'\)$"):
        checked(LocaliserConfig, rerank="both")
    with pytest.raises(
        ConfigError, match=r"^expected top_n to be a whole number of at least 1 and at most 100 \(got '0'\)$"
    ):
        checked(LocaliserConfig, top_n=0)


@pytest.mark.parametrize("name", ["", "/", "//map", "/map", " ", "\n", "map\n", "a\tb", "\x00"])
def test_what_is_no_name_of_a_frame_is_refused(name):
    with pytest.raises(
        ConfigError, match=r"^expected frame_id to be the name of a frame, without a slash before it \(got "
    ):
        checked(LocaliserConfig, frame_id=name)


@pytest.mark.parametrize("name", ["map", "one/map", "site/{building}", "{building}", "my map", "m", "é"])
def test_names_of_frames_are_taken(name):
    assert checked(LocaliserConfig, frame_id=name).frame_id == name
