"""What the first day's page shows of the shipped run is what its replay prints."""

import re
import sys
from pathlib import Path

import pytest

from semloc_core.cli import main

ROOT = Path(__file__).parents[2]


def test_the_page_shows_what_the_replay_prints(monkeypatch, capsys) -> None:
    blocks = re.split(r"^```.*\n", (ROOT / "docs/first_day.md").read_text(), flags=re.MULTILINE)[1::2]
    shown = next(block for block in blocks if "metres walked" in block).splitlines()
    assert len(shown) > 5
    words = ["semloc", "replay", ROOT / "bags/office_run.mcap", "--map", ROOT / "models/office.map"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    printed = capsys.readouterr().out.splitlines()
    assert [line for line in shown if line not in printed] == []
