"""What is compiled by numba, where it is installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Work = TypeVar("Work", bound=Callable[..., object])


def kernel(work: Work) -> Work:
    """Compile a function when it is first called, once for a machine; others may run while it does."""
    return cast(Work, numba.njit(cache=True, nogil=True, error_model="numpy")(work))
