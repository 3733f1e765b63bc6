"""What MkDocs adds to the pages in docs/: the README, the rules, and the reference, generated from the code.

A hook of `mkdocs.yml`. Links to files outside docs/ are looked up and kept as words: the site has no place for them.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]  # the checkout whose pages these are, before an installed one

import docs_reference  # noqa: E402

AT_THE_ROOT = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md"}
"""Pages that stand at the root of the checkout -> where the site has them."""
ELSEWHERE = AT_THE_ROOT | {
    "msgs_schema": "reference/messages.md",
    "semloc_core/config.py": "reference/parameters.md",
    "semloc_core/__init__.py": "reference/python.md",
    "semloc_core/cli/commands.py": "reference/commands.md",
}
"""What stands outside docs/ -> the site's page of it; where there is no site, the link leads to the source."""
LINK = re.compile(r"(?<!!)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\((?!https?://|#|mailto:)([^)\s]+)\)")

FETCHED = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*\bsrc=[\"']?(?:https?:)?//[^>]*>|<link\b[^>]*\bhref=[\"']?(?:https?:)?//[^>]*>"
)
"""What a page would fetch from elsewhere when it is read."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not files in docs/."""
    for name, address in AT_THE_ROOT.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        text = re.sub(r"\]\((?!https?://|#|docs/)", "](../", text).replace("](docs/", "](")
        files.append(File.generated(config, address, content=text))
    for address, write in docs_reference.PAGES.items():
        files.append(File.generated(config, address, content=write()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links out of docs/ to what the site has of them; the others must be there, and become words."""

    def follow(found: re.Match[str]) -> str:
        words, target = found.groups()
        path, _, anchor = target.partition("#")
        if not path.startswith("../") or page.file.src_uri.startswith("reference/"):
            return found[0]
        name = path.removeprefix("../").rstrip("/")
        if name in ELSEWHERE:
            return f"[{words}]({ELSEWHERE[name]}{'#' + anchor if anchor else ''})"
        if not (ROOT / name).exists():
            raise PluginError(f"{page.file.src_uri}: a link to {name}, which is not there")
        return words

    return LINK.sub(follow, markdown)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Refuse a page that would need a network."""
    if found := FETCHED.search(output):
        raise PluginError(f"{page.file.src_uri}: it fetches {found[0]}")
    return output
