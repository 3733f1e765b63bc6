"""Run the commands that docs/first_runs.md shows, in order, and write what they print into the page.

``python tools/first_runs.py``: semloc is that of this Python's environment, the data are in ``SEMLOC_DATA``.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "first_runs.md"
DATA = os.environ.get("SEMLOC_DATA", str(PAGE.parents[2] / "shared" / "data"))


def printed(command: str, folder: str) -> str:
    """What a command prints on a terminal of 160 columns, both of its channels; SystemExit where it fails."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "COLUMNS": "160", "SEMLOC_DATA": DATA, "NO_COLOR": "1"}
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if done.returncode:
        raise SystemExit(f"expected {command!r} to succeed (got {done.returncode}: {done.stdout})")
    lines = (line for line in done.stdout.splitlines() if not re.match(r"\w+ing: \d+ of \d+", line))
    return "".join(f"{line.rstrip()}\n" for line in lines).replace(DATA, "$SEMLOC_DATA")


def main() -> None:
    """Write the page again."""
    with tempfile.TemporaryDirectory() as folder:

        def again(block: re.Match[str]) -> str:
            language, text = block.groups()
            if language == "python":
                name = text.split("\n", 1)[0].removeprefix("# ")
                (Path(folder) / name).write_text(text)
            if language != "console":
                return block.group()
            commands = [line.removeprefix("$ ") for line in text.splitlines() if line.startswith("$ ")]
            return "```console\n" + "".join(f"$ {each}\n{printed(each, folder)}" for each in commands) + "```"

        PAGE.write_text(re.sub(r"```(\w+)\n(.*?)```", again, PAGE.read_text(), flags=re.DOTALL))


if __name__ == "__main__":
    main()
