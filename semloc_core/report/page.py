"""One HTML page with everything in it: no network, and readable on a telephone, in the dark and aloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

from semloc_core.metrics import Row, cell, columns
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True)
class Table:
    """Figures in rows; ``note`` says what the columns mean, or what was left out."""

    caption: str
    rows: Sequence[Row]
    note: str = ""


@short_repr
@dataclass(frozen=True)
class Section:
    """One figure of the page.

    Args:
        key: unique in the page; its address.
        heading: what it is.
        sentence: what to see in it.
        svg: the drawing (see `semloc_core.report.drawing.to_svg`); empty where a table says it all.
        tables: the figure's own numbers.
        wide: whether it takes the page's whole width.
        open: whether the tables are shown from the start.

    """

    key: str
    heading: str
    sentence: str
    svg: str = ""
    tables: Sequence[Table] = ()
    wide: bool = False
    open: bool = False


@dataclass(frozen=True)
class Fact:
    """One figure in large type: ``value`` and what it is."""

    value: str
    label: str


@short_repr
@dataclass(frozen=True)
class Page:
    """What a page says, before it is HTML.

    Args:
        title: of the page.
        introduction: paragraphs for a reader who knows nothing of this.
        facts: the few figures to read first.
        sections: the figures, in order.
        terms: words the page uses, and what they mean.
        provenance: what it was made from: names and hashes.

    """

    title: str
    introduction: Sequence[str]
    facts: Sequence[Fact]
    sections: Sequence[Section]
    terms: Sequence[tuple[str, str]]
    provenance: Sequence[tuple[str, str]]

    def __post_init__(self) -> None:
        assert len({s.key for s in self.sections}) == len(self.sections), "keys of sections must differ"

    def html(self) -> str:
        """The whole page as text."""
        style = files("semloc_core.report").joinpath("page.css").read_text(encoding="utf-8")
        contents = "".join(f'<li><a href="#{s.key}">{escape(s.heading)}</a></li>' for s in self.sections)
        return "\n".join(
            [
                "<!doctype html>",
                '<html lang="en">',
                "<head>",
                '<meta charset="utf-8">',
                # The page asks for nothing: the browser is told to refuse if it did.
                '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
                "style-src 'unsafe-inline'; img-src data:\">",
                '<meta name="viewport" content="width=device-width, initial-scale=1">',
                '<meta name="color-scheme" content="light dark">',
                f"<title>{escape(self.title)}</title>",
                f"<style>\n{style}</style>",
                "</head>",
                "<body>",
                "<header>",
                f"<h1>{escape(self.title)}</h1>",
                *(f"<p>{escape(paragraph)}</p>" for paragraph in self.introduction),
                f'<dl class="facts">{"".join(map(_fact, self.facts))}</dl>' if self.facts else "",
                f'<nav aria-label="Figures"><ul>{contents}</ul></nav>',
                "</header>",
                "<main>",
                self.body(),
                "</main>",
                "<footer>",
                _definitions("Words used here", self.terms),
                _definitions("What this page was made from", self.provenance),
                "</footer>",
                "</body>",
                "</html>",
                "",
            ]
        )

    def body(self) -> str:
        """The figures alone, to stand in another page."""
        return "\n".join(_section(section) for section in self.sections)


def _fact(fact: Fact) -> str:
    return f"<div><dt>{escape(fact.label)}</dt><dd>{escape(fact.value)}</dd></div>"


def _definitions(heading: str, pairs: Sequence[tuple[str, str]]) -> str:
    if not pairs:
        return ""
    body = "".join(f"<dt>{escape(term)}</dt><dd>{escape(meaning)}</dd>" for term, meaning in pairs)
    return f"<section><h2>{escape(heading)}</h2><dl>{body}</dl></section>"


def _section(section: Section) -> str:
    parts = [
        f'<section id="{section.key}" class="card{" wide" if section.wide else ""}" aria-labelledby="{section.key}-h">',
        f'<h2 id="{section.key}-h">{escape(section.heading)}</h2>',
        f"<p>{escape(section.sentence)}</p>",
    ]
    if section.svg:
        parts.append(f'<figure class="scroll">{section.svg}</figure>')
    if section.tables:
        tables = "".join(map(_table, section.tables))
        opened = ' open class="all"' if section.open else ""
        parts.append(f"<details{opened}><summary>The figures</summary>{tables}</details>")
    parts.append("</section>")
    return "\n".join(parts)


def _table(table: Table) -> str:
    """A table; closing tags that HTML does without are left out, because a table may have thousands of cells."""
    names = columns(table.rows)
    text = {name for name in names if any(isinstance(row.get(name), str) for row in table.rows)}
    head = "".join(f"<th scope=col{'' if name in text else ' class=n'}>{escape(name)}" for name in names)
    body = "\n".join(
        "<tr>" + "".join(f"<td{'' if name in text else ' class=n'}>{escape(cell(row, name))}" for name in names)
        for row in table.rows
    )
    note = f"<p class=note>{escape(table.note)}</p>" if table.note else ""
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(table.caption)}">'
        f"<table><caption><span>{escape(table.caption)}</span></caption><thead><tr>{head}</thead>\n"
        f"<tbody>{body}</tbody></table></div>{note}"
    )
