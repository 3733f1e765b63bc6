"""Percentages: one of a thousand is not none, and all but one are not all."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import semloc_core
from semloc_core.text.shares import percent, summing

SOURCE = Path(semloc_core.__file__).parent


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0, "0%"), (1, "100%"), (0.25, "25%"), (1 / 241, "<1%"), (240 / 241, ">99%"), (0.004, "<1%"), (0.006, "1%"),
        (-0.36, "-36%"), (-0.001, "-<1%"), (-0.999, "->99%"), (1.5, "150%"),
        (float(np.float32(1) - np.float32(1e-7)), "100%"),
    ],
)  # fmt: skip
def test_whole_percents(share: float, text: str) -> None:
    assert percent(share) == text


def test_more_digits_and_signs() -> None:
    assert [percent(s, 1) for s in (0.1234, 0.0004, 0.9996, 0, 1)] == ["12.3%", "<0.1%", ">99.9%", "0.0%", "100.0%"]
    assert [percent(s, signed=True) for s in (0.2, -0.2, 0.0001, 0)] == ["+20%", "-20%", "+<1%", "0%"]


@given(count=st.integers(0, 10_000), total=st.integers(1, 10_000), digits=st.integers(0, 2))
def test_none_and_all_are_said_of_none_and_all_only(count: int, total: int, digits: int) -> None:
    count = min(count, total)
    shown = percent(count / total, digits)
    assert (float(shown.strip("<>%")) == 0) == (count == 0)
    assert (float(shown.strip("<>%")) == 100) == (count == total)


def test_what_is_measured_is_printed_by_this_function() -> None:
    """A format of its own would say 0% again; thresholds, which are constants, may be formatted anyhow."""
    own = re.compile(r"\{([^{}]*):[^{}]*%\}")
    found = [
        (path.name, match[1])
        for path in SOURCE.rglob("*.py") if path.name != "percent.py"
        for match in own.finditer(path.read_text()) if not match[1].isupper()
    ]  # fmt: skip
    assert found == []


def test_parts_add_up_as_they_are_printed() -> None:
    assert summing([1 / 3, 1 / 3, 1 / 3], 2) == [0.34, 0.33, 0.33]
    assert summing([0.26, 0.26, 0.48], 1) == [0.3, 0.2, 0.5], "the largest remainders are rounded up"
    assert summing([-0.54, 2.27, -1.7], 1) == [-0.6, 2.3, -1.7]
    assert summing([], 1) == []


@given(parts=st.lists(st.floats(-1e4, 1e4), max_size=12), digits=st.integers(0, 3))
def test_no_part_is_off_by_as_much_as_its_last_digit(parts: list[float], digits: int) -> None:
    found = summing(parts, digits)
    step = 10.0**-digits
    assert f"{sum(found) + 0.0:.{digits}f}".lstrip("-") == f"{math.fsum(parts):.{digits}f}".lstrip("-")
    assert all(abs(a - b) < step * (1 + 1e-9) for a, b in zip(found, parts, strict=True))
