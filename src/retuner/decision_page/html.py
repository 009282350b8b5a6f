"""Pieces of HTML that pages are made of. Text comes in as it is and is escaped here; cells are HTML already."""

import html
import re
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files


def escaped(text: object) -> str:
    """Text as HTML."""
    return html.escape(str(text))


@cache
def palette() -> str:
    """The colours of every page, light and dark."""
    return _template("palette.css")


@cache
def _template(name: str) -> str:
    return files("retuner.templates").joinpath(name).read_text(encoding="utf-8")


def document(title: str, body: str, style: str = "") -> str:
    """A whole page; body is HTML. style : beside what all pages have."""
    screen = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    styles = f"<style>{palette()}{_template('pages.css')}{style}</style>"
    head = f'<meta charset="utf-8">{screen}<title>{escaped(title)}</title>{styles}'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def table(heads: Iterable[str], rows: Iterable[Iterable[str]], classes: Iterable[str] = ()) -> str:
    """A table of cells that are already HTML; classes are those of the rows. On a narrow screen each row is a card."""
    kinds, named = iter(classes), list(heads)
    head = "".join(f"<th>{h}</th>" for h in named)
    lines = "".join(f'<tr class="{next(kinds, "")}">{_cells(named, row)}</tr>' for row in rows)
    return f'<div class="scroll"><table class="cards"><tr>{head}</tr>{lines}</table></div>'


def _cells(heads: Sequence[str], row: Iterable[str]) -> str:
    return "".join(f'<td data-head="{_plain(head)}">{cell}</td>' for head, cell in zip(heads, row, strict=False))


def _plain(head: str) -> str:
    return re.sub(r"<[^>]*>", " ", head).replace('"', "&quot;")


def text_table(heads: Iterable[str], rows: Iterable[Iterable[object]], classes: Iterable[str] = ()) -> str:
    """A table of plain text."""
    return table(map(escaped, heads), (map(escaped, row) for row in rows), classes)


def pairs(rows: Sequence[tuple[str, object]]) -> str:
    """A table of names and values without a head; rows without a value are left out, and no rows are no table."""
    lines = "".join(
        f'<tr><th>{escaped(name)}</th><td class="long">{escaped(value)}</td></tr>' for name, value in rows if value
    )
    return f'<table class="pairs">{lines}</table>' if lines else ""


def figure(drawing: str) -> str:
    """A wide drawing, which scrolls on a narrow screen."""
    return f"<figure>{drawing}</figure>"


def section(heading: str, *content: str) -> str:
    """A heading with what stands under it; nothing where that is nothing. The content is HTML."""
    inside = "".join(content)
    return f"<section><h3>{escaped(heading)}</h3>{inside}</section>" if inside else ""


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text, nothing for none."""
    mark = f' class="{kind}"' if kind else ""
    return f"<p{mark}>{escaped(text)}</p>" if text else ""
