"""The house: rooms that are used through what they export, and are found on the page that draws them."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import semloc_core
from semloc_core.exports import homes

PACKAGE = Path(semloc_core.__file__).parent
ROOMS = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))
MOST_AT_THE_ROOT, MOST_IN_A_ROOM = 8, 12


def name_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imports(path: Path):
    """(module, name) of every import from the package, inside functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "semloc_core":
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.startswith("semloc_core."))


def test_what_lies_across_a_wall_is_imported_from_the_room_and_not_from_its_files():
    """Layers can't say it: a room may be changed inside as long as what it exports stays."""
    wrong = []
    for name, path in MODULES.items():
        mine = name.split(".")[1].replace("__main__", "cli") if "." in name else ""
        for module, what in imports(path):
            room, *inside = module.split(".")[1:] or [""]
            if room in ROOMS and room != mine and mine and (inside or what not in homes_of(room)):
                wrong.append(f"{name}: {module} {what}")
    assert not wrong


def homes_of(room: str) -> list[str]:
    return importlib.import_module(f"semloc_core.{room}").__all__


@pytest.mark.parametrize("package", ["semloc_core", *(f"semloc_core.{room}" for room in ROOMS if room != "cli")])
def test_a_face_lists_what_it_hands_on_and_hands_it_on(package):
    face = importlib.import_module(package)
    assert set(homes(package)) == set(face.__all__) - {"__version__"}
    for name in face.__all__:
        assert getattr(face, name) is not None
    inside = {path.stem for path in Path(face.__file__).parent.iterdir()}
    assert not inside & set(face.__all__), "an imported file of that name would hide what is exported"
    with pytest.raises(AttributeError, match="nothing_of_that_name"):
        getattr(face, "nothing_of_that_" + "name")


def test_a_face_imports_nothing_until_it_is_asked():
    """Who needs one function of a room must not wait for torch, or have scipy."""
    faces = ", ".join(f"semloc_core.{room}" for room in ROOMS if room != "cli")
    code = f"import sys, {faces}; print(*sorted(m for m in sys.modules if m.startswith('semloc_core')))"
    code += "; print(sorted({'torch', 'numpy', 'msgspec', 'yaml', 'scipy', 'matplotlib', 'rich'} & set(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split("\n")
    names = {"semloc_core", "semloc_core.exports", *(f"semloc_core.{room}" for room in ROOMS if room != "cli")}
    assert set(said[0].split()) == names
    assert said[1] == "[]"


@pytest.mark.parametrize("package", [name for name, path in MODULES.items() if path.name == "__init__.py"])
def test_a_room_says_its_job_and_is_not_crowded(package):
    path = MODULES[package]
    files = [each for each in path.parent.iterdir() if each.is_file()]
    rooms_inside = any(path.parent.glob("*/__init__.py"))
    if package == "semloc_core":
        assert len(files) <= MOST_AT_THE_ROOT
    else:
        assert rooms_inside or len(files) <= MOST_IN_A_ROOM
    first = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n")[0]
    assert len(first) > 20


def test_the_page_lists_the_rooms_and_the_files_at_the_root_as_they_are():
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `([a-z_]+(?:/|\.py))` \|", page, flags=re.MULTILINE)
    at_the_root = [path.name for path in PACKAGE.glob("*.py") if not path.name.startswith("__")]
    assert sorted(listed) == sorted([*(f"{room}/" for room in ROOMS), *at_the_root])


def test_the_page_says_where_to_add_by_files_that_are_there_and_counts_them():
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (an? [^|]+) \| (\d+) \| (.+) \|$", page, flags=re.MULTILINE)
    assert [what for what, *_ in rows] == ["an encoder", "an explainer", "a source of graphs", "a message", "a command"]
    for what, number, words in rows:
        besides = re.findall(r"`((?:tests|msgs_schema)/[\w/.]*)`", words)
        inside = [path for path in re.findall(r"`(\w+(?:/\w+)*(?:/|\.py))`", words) if path not in besides]
        inside = [path for path in inside if path != "commands.py"]  # of whichever group
        assert len(inside) == int(number), (what, inside)
        assert besides, what
        for path in inside:
            assert (PACKAGE / path).exists(), (what, path)
        for path in besides:
            assert (PACKAGE.parent / path).exists(), (what, path)
