"""Shared fixtures. The real scene graphs are not part of the project: what needs them skips where they are absent."""

import os
from pathlib import Path

import pytest
import torch
from small_worlds import small_arrays, small_worlds  # noqa: F401  # fixtures

# Graphs in tests are small: on them a pool of threads costs many times what it saves. It must be said before the
# first computation.
torch.set_num_threads(1)

DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of real scene graphs: SEMLOC_DATA, or ../shared/data beside the checkout."""
    root = Path(os.environ.get("SEMLOC_DATA", DEFAULT_DATA))
    if not root.is_dir():
        pytest.skip(f"real scene graphs not found at {root} (set SEMLOC_DATA)")
    return root
