"""What is compiled by numba, where it is installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Work = TypeVar("Work", bound=Callable[..., object])


def kernel(work: Work) -> Work:
    """Compile a function when it is first called, once for a machine; others may run while it does.

    Where nothing can be written, neither beside the file nor in the user's cache, it is once for each process.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        return cast(Work, numba.njit(cache=True, **options)(work))
    except RuntimeError:
        return cast(Work, numba.njit(**options)(work))
