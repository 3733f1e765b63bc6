"""Each building of a map has a frame of its own, which everything that is published agrees on."""

from __future__ import annotations

import pytest

from semloc_core.config import LocaliserConfig, checked
from semloc_core.errors import ConfigError
from semloc_core.map_database.frames import frame_of


@pytest.mark.parametrize(
    ("pattern", "buildings", "building", "frame"),
    [
        ("map", ["home"], "home", "map"),
        ("map", ["home", "other"], "home", "home"),
        ("map", ["home", "other"], None, "map"),
        ("world", ["home", "other"], "home", "world"),
        ("world", ["home", "other"], None, "world"),
        ("site/{building}", ["home"], "home", "site/home"),
        ("site/{building}", ["home", "other"], None, "map"),
        ("{building}_{x}", ["home"], "a{building}", "a{building}_{x}"),
    ],
)
def test_a_pattern_makes_a_frame(pattern, buildings, building, frame):
    assert frame_of(pattern, buildings, building) == frame


def test_a_frame_has_a_name():
    with pytest.raises(ConfigError, match="frame_id"):
        checked(LocaliserConfig, frame_id="")
