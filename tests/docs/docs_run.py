"""Runs the commands of the README and the docs: ``python tests/docs/docs_run.py [PAGE…]``; exit status 1 if one fails.

The blocks of a page are run one after the other by bash, in a copy of the checkout made for that page. SEMLOC_DATA is
a folder of small stand-ins, of the same form as the real one: two homes, one more building, the Hydra files (the real
ones where they are, else generated; what needs Hydra files is then passed over and said). What must be there before a
page begins is made first (`prepare`). Blocks marked as not run are not.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "docs"), str(ROOT / "tests" / "fleet")]

from doc_blocks import Block, blocks, pages  # noqa: E402
from doc_commands import fault  # noqa: E402
from doc_files import prepare  # noqa: E402
from lite_server import LiteServer  # noqa: E402

LIMIT_S = 3600
"""A block that takes longer has failed."""
HOMES = ("Allensville", "Hiteman")
SERVER = "maps.local:19530"
"""The server that the pages speak of; here Milvus Lite on loopback."""


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def copy_of_the_checkout(folder: Path) -> None:
    """What git knows, older than any environment (so that `make` makes none), and the environment."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name, follow_symlinks=False)
        os.utime(folder / name, (0, 0), follow_symlinks=False)
    (folder / ".venv").symlink_to(Path(sys.prefix), target_is_directory=True)


def stand_ins(folder: Path, env: dict[str, str]) -> None:
    """A folder like the one of the real graphs, but small."""
    real = Path(os.environ.get("SEMLOC_DATA", ROOT.parent / "shared" / "data")).resolve()
    homes = folder / "gibson"
    if (real / "gibson").is_dir():
        homes.mkdir(parents=True)
        for name in HOMES:
            (homes / name).symlink_to(real / "gibson" / name)
        (folder / "gibson_detector").mkdir()
        small = min((real / "gibson_detector").glob("*.json"), key=lambda path: path.stat().st_size)
        (folder / "gibson_detector" / small.name).symlink_to(small)
        (folder / "hydra").symlink_to(real / "hydra")
    else:
        folder.mkdir(parents=True)
        made = [sys.executable, "-m", "semloc_core", "world", "many", str(homes), "--count", str(len(HOMES))]
        subprocess.run(made, env=env, check=True, stdout=subprocess.DEVNULL)
        for name, path in zip(HOMES, sorted(homes.iterdir()), strict=True):
            path.rename(homes / name)
        shutil.copytree(homes / HOMES[0], folder / "gibson_detector" / HOMES[0])
    (folder / "goseek").mkdir()
    shutil.copyfile(homes / HOMES[0] / "map.json", folder / "goseek" / "office.json")


def script(block: Block, port: int) -> str:
    """What bash is given: the lines, a slow block's `semloc` with its options besides, and no page served for ever."""
    lines = []
    for line in block.lines:
        line = line.replace(SERVER, f"127.0.0.1:{port}")
        if block.words:  # what a command has of these options
            line = re.sub(r"semloc [^#&|]*[^#&|\s]", lambda found: _shorter(found[0], block.words), line)
        if re.match(r"semloc view ", line):  # serves until it is stopped
            line = f"timeout -s INT 30 {line.partition('#')[0]} || [ $? = 124 ]"
        lines.append(line)
    return "\n".join(lines)


def _shorter(command: str, words: str) -> str:
    return f"{command} {words}" if fault(f"{command} {words}", whole=True) is None else command


def run_page(page: Path, scratch: Path) -> int:
    """Run the blocks of a page: how many failed."""
    todo = [block for block in blocks(page) if block.mark != "not run"]
    if not todo:
        return 0
    folder = scratch / page.stem
    copy_of_the_checkout(folder)
    env = {**os.environ, "PYTHONPATH": str(folder), "SEMLOC_DATA": str(scratch / "data"), "NO_COLOR": "1"}
    env["PATH"] = f"{Path(sys.prefix) / 'bin'}{os.pathsep}{env['PATH']}"
    failed, server = 0, None
    try:
        if SERVER in page.read_text(encoding="utf-8"):
            server = LiteServer(scratch / "server")
            server.start()
        prepare(page.name, folder)
        for block in todo:
            text = script(block, server.port if server else 0)
            if "/hydra/" in text and not (scratch / "data" / "hydra").exists():
                say(f"{block!r}: passed over, it needs Hydra files (SEMLOC_DATA)")
                continue
            began = time.monotonic()
            command = ["timeout", str(LIMIT_S), "bash", "-euo", "pipefail", "-c", text]
            done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
            good = done.returncode == 0
            failed += not good
            say(f"{block!r}: {'ran' if good else 'FAILED'}, {time.monotonic() - began:.0f} s")
            if not good:
                say(f"{text}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    finally:
        if server:
            server.stop()
    return failed


def main() -> None:
    """Run the pages that are named, or all."""
    named = [Path(word).resolve() for word in sys.argv[1:]]
    with tempfile.TemporaryDirectory() as made:
        scratch = Path(made)
        stand_ins(scratch / "data", {**os.environ, "PYTHONPATH": str(ROOT)})
        failed = sum(run_page(page, scratch) for page in named or pages())
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
