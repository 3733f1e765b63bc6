"""A replay's bytes do not hang on the processor, on its libraries' ways to sum, or on the number of threads."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from semloc_core.sources.bag import BagWriter, read_messages

ROOT = Path(__file__).resolve().parents[2]
UPDATES = 30
SETTINGS = {
    "as it comes": {},
    "AVX2": {"OPENBLAS_CORETYPE": "Haswell", "ATEN_CPU_CAPABILITY": "avx2", "MKL_CBWR": "AVX2"},
    "old, two threads": {
        "OPENBLAS_CORETYPE": "Prescott",
        "ATEN_CPU_CAPABILITY": "default",
        "MKL_CBWR": "COMPATIBLE",
        "OMP_NUM_THREADS": "2",
    },
}


@pytest.mark.skipif(sys.platform == "win32", reason="other libraries")
def test_a_replay_has_the_same_bytes_on_other_processors(tmp_path: Path) -> None:
    run, found = tmp_path / "run.mcap", {}
    with BagWriter(run) as bag:
        for number, message in enumerate(read_messages(ROOT / "bags" / "office_run.mcap")):
            if number >= 2 * UPDATES:
                break
            bag.write_raw(message)
    for name, variables in SETTINGS.items():
        out = tmp_path / f"{len(found)}.mcap"
        words = ["replay", run, "--map", ROOT / "models" / "office.map", "-o", out, "-q"]
        subprocess.run(
            [sys.executable, "-m", "semloc_core", *map(str, words)],
            env={**os.environ, "OMP_NUM_THREADS": "1", **variables},
            check=True,
            capture_output=True,
        )
        found[name] = out.read_bytes()
    assert len(set(found.values())) == 1, [name for name in found if found[name] != found["as it comes"]]
