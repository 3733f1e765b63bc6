"""The test by layout, compiled where numba is installed (the extra ``fast``): the same answers, sooner."""

from __future__ import annotations

import os
from functools import lru_cache
from importlib.util import find_spec

OFF = "SEMLOC_NOT_COMPILED"
"""Of the environment: where it is set to anything, nothing is compiled."""


@lru_cache(maxsize=1)
def compiled() -> bool:
    """Whether the compiled test is used."""
    return not os.environ.get(OFF) and find_spec("numba") is not None
