import io
import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from svg_marks import Marks

from semloc_core.report.colours import INK, OTHER_STYLE, ClassLooks, styles
from semloc_core.report.drawing import LEAST_PX, TEXT, WIDTH, figure, to_png, to_svg


def drawing() -> Figure:
    with figure(2.0) as drawn:
        axes = drawn.add_subplot()
        axes.plot([0, 1], [0, 1], color=INK, gid="line")
        axes.scatter([0, 1, 2], [1, 2, 3], gid="dots", label="$x_2$ & <b>")
        axes.imshow(np.eye(4), gid="image")
        axes.legend()
    return drawn


def test_same_bytes_each_time_and_nothing_of_today():
    assert to_svg(drawing(), "k", "d") == to_svg(drawing(), "k", "d")
    assert to_png(drawing()) == to_png(drawing())
    assert "<metadata" not in to_svg(drawing(), "k", "d")


def test_ids_are_the_drawings_own_and_every_reference_is_resolved():
    text = to_svg(drawing(), "first", "d")
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert ids
    assert all(i.startswith("first-") for i in ids)
    references = re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', text)
    assert references
    assert {a or b for a, b in references} <= set(ids)


def test_ink_takes_the_pages_colour_and_the_picture_its_width():
    text = to_svg(drawing(), "k", "d")
    assert INK.lower() not in text.lower()
    assert "currentColor" in text
    assert "width=" not in text[: text.index(">")]


def test_description_is_read_out_whatever_is_in_it():
    text = to_svg(drawing(), "k", 'less than 4 < "five" & more')
    assert Marks(text).root.attrib["aria-label"] == 'less than 4 < "five" & more'
    assert Marks(text).root.attrib["role"] == "img"


def test_names_are_text_not_formulae_nor_markup():
    assert "$x_2$ & <b>" in Marks(drawing()).labels


def test_every_mark_is_drawn():
    marks = Marks(drawing())
    assert (marks.count("dots"), marks.count("line"), marks.count("image")) == (3, 1, 1)


def test_rounding_moves_nothing_by_more_than_a_hundredth():
    text = to_svg(drawing(), "k", "d")
    assert not re.search(r' (d|x|y)="[^"]*\.\d{3}', text)


def test_png_is_opaque_and_a_faint_line_stays_faint():
    with figure(1.0) as drawn:
        axes = drawn.add_subplot()
        axes.set_axis_off()
        axes.plot([0, 1], [0.5, 0.5], color=INK, alpha=0.25, linewidth=20)
    with Image.open(io.BytesIO(to_png(drawn))) as image:
        shades = image.convert("RGBA").getcolors()
    assert {alpha for _, (*_, alpha) in shades} == {255}
    assert (max(shades)[1])[:3] == (255, 255, 255)
    assert min(sum(rgb) for _, (*rgb, _) in shades) > 3 * 180


def test_styles_differ_in_more_than_colour():
    look = styles([f"c{i}" for i in range(9)])
    first = list(look.values())[:7]
    for attribute in ("colour", "marker", "hatch"):
        assert len({getattr(s, attribute) for s in first}) == 7, attribute
    assert look["c7"] == look["c8"] == OTHER_STYLE


@pytest.mark.parametrize("name", ["_hidden", "plain"])
def test_a_class_whose_name_begins_with_an_underscore_is_in_the_legend(name):
    from semloc_core.report.introspection.figures import importance_figure

    marks = Marks(importance_figure([name], {"saliency": [1.0]}, ClassLooks([name], [name])))
    assert any(label.lstrip("\u200b") == name for label in marks.labels)


@pytest.mark.parametrize("size", [6.0, 11.5, 30.0])
def test_a_drawing_says_how_narrow_its_smallest_text_lets_it_become(size):
    with figure(2.0) as drawn:
        drawn.add_subplot().set_title("small", fontsize=size)
    text = to_svg(drawn, "k", "d")
    width = float(re.search(r'viewBox="0 0 (\S+) ', text).group(1))
    narrowest = float(re.search(r'style="min-width:(\d+)px"', text).group(1))
    smallest = min(size, TEXT)
    assert width == pytest.approx(72 * WIDTH)
    assert LEAST_PX <= smallest * narrowest / width < LEAST_PX + 0.5


def test_a_drawing_in_the_reports_style_fits_a_telephone():
    """360 px, less the page's and the card's margins."""
    narrowest = float(re.search(r'style="min-width:(\d+)px"', to_svg(drawing(), "k", "d")).group(1))
    assert narrowest <= 360 - 2 * (8 + 10 + 1)
