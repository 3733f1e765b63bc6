"""Commands in the README and the docs are ones that there are; the quick ones are run here, the others by
`make docs-run` (see `docs_run.py`)."""

import re
import sys

import pytest
from doc_blocks import PROMPT, all_blocks, blocks, fences, inline, pages
from doc_commands import commands_of, fault
from doc_files import prepare

from semloc_core.cli import main

PAGES = pages()
NAMES = [page.name for page in PAGES]
MOST_NOT_RUN = 0.1


@pytest.mark.parametrize("block", all_blocks(), ids=repr)
def test_every_line_of_a_block_is_a_command_that_there_is(block) -> None:
    assert block.lines, "a block of commands without any"
    assert [(line, why) for line in block.lines if (why := fault(line, whole=True))] == []


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_in_running_text_are_ones_that_there_are(page) -> None:
    assert [(line, why) for line in inline(page) if (why := fault(line, whole=False))] == []


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_stand_in_blocks_that_are_looked_at(page) -> None:
    elsewhere = [line for line, kind, text, _ in fences(page) if kind not in ("sh", "console") and PROMPT.search(text)]
    assert elsewhere == []


def test_at_most_one_block_in_ten_is_not_run() -> None:
    left_out = [block for block in all_blocks() if block.mark == "not run"]
    assert all(block.words for block in left_out), "without saying why"
    assert len(left_out) <= MOST_NOT_RUN * len(all_blocks()), left_out


@pytest.mark.parametrize("page", [p for p in PAGES if any(b.mark is None for b in blocks(p))], ids=lambda p: p.name)
def test_quick_blocks_run(page, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    prepare(page.name, tmp_path)
    for block in blocks(page):
        for line in block.lines if block.mark is None else ():
            for words in commands_of(line):
                assert words[0] == "semloc", f"{block!r}: a quick block has nothing but semloc (got {line!r})"
                monkeypatch.setattr(sys, "argv", words)
                with pytest.raises(SystemExit) as stop:
                    main()
                assert not stop.value.code, f"{block!r}: {line}\n{capsys.readouterr().err}"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("semloc replay run.mcap --map a.map --no-such-option", "no-such-option"),
        ("semloc map bild a.json -o a.map", "bild"),
        ("semloc map build a.json", "--output"),
        ("semloc evaluate online ROOT --walks none", "--walks"),
        ("semloc world home -o a.json && semloc world hous -o b.json", "hous"),
        ("make everything", "everything"),
        ("pytest tests/no_such_folder", "no_such_folder"),
        ("python -m semloc_core.no_such_module", "no_such_module"),
        ("ros2 run semloc_ros no_such_node", "no_such_node"),
        ("ros2 run semloc_ros localiser --ros-args -p no_such_parameter:=1", "no_such_parameter"),
        ("ros2 launch semloc_ros localiser.launch.py no_such_argument:=1", "no_such_argument"),
    ],
)
def test_stale_commands_are_found(line, said) -> None:
    assert said in (fault(line, whole=True) or "")


def test_each_pinned_package_has_a_row_among_the_licences() -> None:
    root = PAGES[0].parent
    pins = dict(line.split("==") for line in (root / "constraints.txt").read_text().splitlines() if "==" in line)
    rows = re.findall(r"^\| (\S+) \| (\S*) \| ", (root / "docs" / "licences.md").read_text(), re.MULTILINE)
    listed = {re.sub(r"[-_.]+", "-", name.lower()): version for name, version in rows}
    for name, version in pins.items():
        assert listed.get(re.sub(r"[-_.]+", "-", name.lower())) == version.split(";")[0].strip(), name
