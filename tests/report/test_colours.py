"""A class looks alike in every picture, and no two classes of a labelspace look the same."""

import numpy as np
import pytest

from semloc_core.graph.labels.files import load_labelspace, shipped_labelspaces
from semloc_core.report.colours import OTHER_STYLE, OWN, ClassLooks, class_style
from semloc_core.report.introspection.figures import importance_figure, shift_figure

SPACE = ("chair", "couch", "plant", "painting")


@pytest.mark.parametrize("name", shipped_labelspaces())
def test_no_two_classes_of_a_shipped_labelspace_share_a_mark_or_a_hatch_of_one_colour(name: str) -> None:
    found = [class_style(i) for i in range(len(load_labelspace(name)))]
    assert len({(style.colour, style.marker) for style in found}) == len(found)
    assert len({(style.colour, style.hatch) for style in found}) == len(found)


def test_the_first_classes_differ_in_colour_mark_and_hatch_each() -> None:
    """So that a colour-blind reader, or a print without colour, tells them apart."""
    first = [class_style(i) for i in range(7)]
    for attribute in ("colour", "marker", "hatch"):
        assert len({getattr(style, attribute) for style in first}) == 7, attribute


def test_neighbours_in_a_labelspace_never_share_a_colour() -> None:
    assert all(class_style(i).colour != class_style(i + 1).colour for i in range(83))


def test_looks_go_by_the_labelspace_whatever_a_picture_thinks_important() -> None:
    one, other = ClassLooks(SPACE, ["plant", "chair"]), ClassLooks(SPACE, ["couch", "plant", "painting"])
    assert one["plant"] == other["plant"] == class_style(2)
    assert one["zeppelin"] == OTHER_STYLE, "no class of the labelspace"
    many = ClassLooks(SPACE, [f"c{i}" for i in range(20)])
    assert (len(many.own), len(many.rest)) == (OWN, 20 - OWN)


def test_all_figures_of_a_report_give_a_class_its_colour() -> None:
    rising = ClassLooks(SPACE, SPACE[::-1])
    objects = [name for name in SPACE for _ in range(2)]
    figures = {
        "importance": importance_figure(objects, {"saliency": np.arange(8.0)}, rising),
        "shift": shift_figure(rising, np.ones(4), np.ones(4)),
    }
    for index, name in enumerate(SPACE):
        colour = tuple(int(class_style(index).colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
        for what, figure in figures.items():
            drawn = [
                tuple(artist.get_facecolor()[0][:3])
                for axes in figure.axes
                for artist in axes.collections
                if str(artist.get_label()).startswith(name) or artist.get_gid() == _gid(what, index)
            ]
            assert drawn, (what, name)
            assert all(np.allclose(found, colour) for found in drawn), (what, name)


def _gid(what: str, index: int) -> str:
    """Importance's marks have no label; the classes are in rising order there."""
    return f"objects-0-{len(SPACE) - 1 - index}" if what == "importance" else ""
