"""Run the commands that docs/first_runs.md shows, each section in a fresh environment, and write what they print.

``python tools/first_runs.py [--here]``: a wheel is built of the clone; for each section an environment is made of this
Python, with PyTorch for the CPU (`tools/install_torch.sh`), the wheel and its extra `tools`, and the commands run in an
empty folder beside it. ``--here`` takes the environment of this Python. The data are in ``SEMLOC_DATA``.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "first_runs.md"
DATA = os.environ.get("SEMLOC_DATA", str(ROOT.parent / "shared" / "data"))
BUILT_OF = ("semloc_core", "pyproject.toml", "README.md", "LICENSE")


def done(words: list[str], **options: object) -> str:
    """What a command prints, both of its channels; SystemExit where it fails."""
    found = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False, **options)
    if found.returncode:
        raise SystemExit(f"expected {' '.join(words)!r} to succeed (got {found.returncode}: {found.stdout})")
    return str(found.stdout)


def outside() -> dict[str, str]:
    """The variables of this process without those that lead to the clone, or to another Python's packages."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def wheel(folder: Path) -> Path:
    """A wheel of the clone, built of a copy."""
    source = folder / "source"
    source.mkdir()
    for name in BUILT_OF:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    words = ["-m", "pip", "--disable-pip-version-check", "wheel", "--no-deps", "--wheel-dir", str(folder), str(source)]
    done([sys.executable, *words], env=outside())
    return next(folder.glob("*.whl"))


def fresh(folder: Path, built: Path) -> Path:
    """The programs of a new environment with PyTorch for the CPU, the wheel and its extra `tools`."""
    python = folder / "bin" / "python"
    done([sys.executable, "-m", "venv", str(folder)], env=outside())
    done(["sh", "tools/install_torch.sh", str(python)], cwd=ROOT, env=outside())
    words = ["-m", "pip", "--disable-pip-version-check", "install", "--constraint", "constraints.txt"]
    done([str(python), *words, f"semloc[tools] @ {built.as_uri()}"], cwd=ROOT, env=outside())
    return python.parent


def printed(command: str, folder: Path, programs: Path) -> str:
    """What a command prints on a terminal of 160 columns, in a folder and with the programs of an environment."""
    path = f"{programs}{os.pathsep}{os.environ['PATH']}"
    environment = {**outside(), "PATH": path, "COLUMNS": "160", "SEMLOC_DATA": DATA, "NO_COLOR": "1"}
    said = done(["bash", "-c", command], cwd=folder, env=environment)
    lines = (line for line in said.splitlines() if not re.match(r"\w+ing: \d+ of \d+", line))
    return "".join(f"{line.rstrip()}\n" for line in lines).replace(DATA, "$SEMLOC_DATA")


def again(section: str, folder: Path, programs: Path) -> str:
    """A section with its commands run in a folder: files of the page are written there first."""

    def block(found: re.Match[str]) -> str:
        language, text = found.groups()
        if language == "python":
            name = text.split("\n", 1)[0].removeprefix("# ")
            (folder / name).write_text(text)
        if language != "console":
            return found.group()
        commands = [line.removeprefix("$ ") for line in text.splitlines() if line.startswith("$ ")]
        return "```console\n" + "".join(f"$ {each}\n{printed(each, folder, programs)}" for each in commands) + "```"

    return re.sub(r"```(\w+)\n(.*?)```", block, section, flags=re.DOTALL)


def main() -> None:
    """Write the page again."""
    here = "--here" in sys.argv[1:]
    written = []
    with tempfile.TemporaryDirectory() as scratch:
        built = None if here else wheel(Path(scratch))
        for number, section in enumerate(re.split(r"(?m)^(?=## )", PAGE.read_text())):
            if "```console" not in section:
                written.append(section)
                continue
            environment, folder = Path(scratch) / f"environment{number}", Path(scratch) / f"run{number}"
            folder.mkdir()
            programs = Path(sys.executable).parent if built is None else fresh(environment, built)
            written.append(again(section, folder, programs))
            shutil.rmtree(environment, ignore_errors=True)
    PAGE.write_text("".join(written))


if __name__ == "__main__":
    main()
