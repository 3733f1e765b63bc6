"""Writes a page on what the project depends on: ``python tools/licences.py constraints.txt > docs/licences.md``.

Versions are those that the constraints pin; licences are what each installed package says of itself.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution, requires
from pathlib import Path

HEAD = """# Dependencies and their licences

Made by `make licences`; versions are those of `constraints.txt`. The robot runs on the first table alone.
"""
LONGEST = 60


def normal(name: str) -> str:
    """A package's name as the index compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def licence(package: Distribution) -> str:
    """What a package says its licence is, in a few words."""
    data = package.metadata
    said = data.get("License-Expression")
    if said:
        return str(said)
    found = [line.rsplit(" :: ", 1)[1] for line in data.get_all("Classifier") or () if line.startswith("License ::")]
    found = [line for line in found if line != "OSI Approved"]
    if found:
        return ", ".join(found)
    lines = (data.get("License") or "").strip().splitlines()
    return lines[0][:LONGEST] if lines else "not stated"


def needed(names: list[str]) -> set[str]:
    """Packages and what they need in turn, without extras, as far as installed."""
    found: set[str] = set()
    work = [normal(name) for name in names]
    while work:
        name = work.pop()
        if name in found:
            continue
        try:
            lines = requires(name) or []
        except PackageNotFoundError:
            continue
        found.add(name)
        work += [normal(re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0]) for line in lines if "extra ==" not in line]
    return found


def table(names: list[str], pinned: dict[str, str]) -> list[str]:
    """Rows of a Markdown table."""
    rows = ["| package | version | licence |", "| --- | --- | --- |"]
    for name in names:
        try:
            package = distribution(name)
        except PackageNotFoundError:
            rows.append(f"| {name} | {pinned.get(name, '')} | not installed here |")
        else:
            rows.append(f"| {package.metadata['Name']} | {pinned.get(name, package.version)} | {licence(package)} |")
    return rows


def main() -> None:
    """Print the page."""
    lines = Path(sys.argv[1]).read_text(encoding="utf-8").splitlines()
    pins = [line.split("==") for line in lines if "==" in line and not line.startswith("#")]
    pinned = {normal(name): version.split(";")[0].strip() for name, version in pins}
    own = [line for line in requires("semloc") or [] if "extra" not in line]
    robot = needed([re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0] for line in own])
    rest = sorted(set(pinned) - robot)
    page = [HEAD, "## On the robot", "", *table(sorted(robot), pinned), "", "## Tools, tests and evaluation", ""]
    sys.stdout.write("\n".join([*page, *table(rest, pinned)]) + "\n")


if __name__ == "__main__":
    main()
