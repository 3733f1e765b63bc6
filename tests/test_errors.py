"""What another machine sent is never printed raw."""

from semloc_core.errors import BagError, SemlocError


def test_an_error_is_its_line():
    line = "expected a bag (got Größe 3, 椅子)"
    assert str(BagError(line)) == line


def test_control_characters_and_length_are_bounded():
    said = str(SemlocError("expected text (got a\nb\x1b[2J\x00\ud800" + "x" * 10_000_000 + ")"))
    assert said.startswith("expected text (got a\\nb\\x1b[2J\\x00\\ud800xxx")
    assert said.isprintable()
    assert len(said) == 1000
