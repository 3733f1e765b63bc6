"""Long work that is logged to a file must say that it goes on."""

import pytest

from semloc_core.cli.shared import common


def test_a_line_now_and_then_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(common.time, "monotonic", lambda: now[0])
    with common.progress("training") as step:
        for done in range(40):
            now[0] += 1.0
            step(done, 40, "step")
    printed = capsys.readouterr()
    assert printed.err.splitlines() == ["training: 14 of 40 step", "training: 29 of 40 step"]
    assert printed.out == ""
