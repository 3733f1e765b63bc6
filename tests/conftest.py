"""Shared fixtures. The real scene graphs are not part of the project: what needs them skips where they are absent."""

import os
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, settings
from small_worlds import small_arrays, small_worlds  # noqa: F401  # fixtures

# Graphs in tests are small: on them a pool of threads costs many times what it saves. It must be said before the
# first computation.
torch.set_num_threads(1)

# No test rests on how fast the machine is at the moment; in CI (.ci/run) the same cases are drawn every time.
settings.register_profile(
    "semloc", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize="CI" in os.environ
)
settings.load_profile("semloc")

DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of real scene graphs: SEMLOC_DATA, or ../shared/data beside the checkout."""
    root = Path(os.environ.get("SEMLOC_DATA", DEFAULT_DATA))
    if not root.is_dir():
        pytest.skip(f"real scene graphs not found at {root} (set SEMLOC_DATA)")
    return root
