"""Pieces of HTML that pages are made of. Text comes in as it is and is escaped here; cells are HTML already."""

import base64
import html
from collections.abc import Iterable, Sequence

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1180px;margin:2em auto;padding:0 1.2em;background:#fff}
h1{font-size:1.7em;margin:0 0 .2em} h2{font-size:1.2em;margin:1.8em 0 .5em} h3{font-size:1em;margin:1.3em 0 .4em}
p.lead{font-size:1.08em} .muted{color:#666} img,svg{max-width:100%;height:auto}
table{border-collapse:collapse;width:100%;font-size:.92em}
th,td{text-align:left;padding:.35em .6em;border-bottom:1px solid #ddd;vertical-align:top}
th{background:#f4f6f8} td.n,th.n{text-align:right;white-space:nowrap} .good{color:#1a7f37} .bad{color:#b42318}
.twins{display:flex;flex-wrap:wrap;gap:1em} .twins img{flex:1 1 340px;max-width:560px} tr.commit td{background:#fff8e6}
table.pairs th{width:1%;min-width:11em} code{background:#f4f6f8;padding:0 .25em;overflow-wrap:anywhere}
.columns{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(430px,100%),1fr));gap:0 2.2em;align-items:start}
.columns section{min-width:0} article td.long{overflow-wrap:anywhere} .good,.bad{white-space:nowrap}
.badge{display:inline-block;border:1.5px solid;border-radius:1em;padding:0 .7em;font-size:.85em;font-weight:600}
details.page{border:1px solid #ddd;border-radius:.4em;margin:.5em 0;padding:.3em .9em}
details.page[open]{padding-bottom:1.2em} details.page>summary{cursor:pointer} svg{display:block;margin:.4em 0}
pre{background:#f4f6f8;padding:.5em .8em;margin:.4em 0;white-space:pre-wrap;font-size:.88em}
.small{font-size:.85em}
@media (max-width:620px){body{margin:.6em auto;padding:0 .6em} table{display:block;overflow-x:auto;font-size:.85em}
table.pairs th{min-width:7em} details.page{padding:.3em .4em} h1{font-size:1.3em}
.twins{display:block} .twins img{max-width:100%}}
@page{margin:11mm}
@media print{body{max-width:none;margin:0;padding:0;font-size:8pt;line-height:1.35} th,td{padding:.18em .5em}
details.page{break-before:page;border:0} svg,table,pre{break-inside:avoid} h2,h3{break-after:avoid}
.columns{grid-template-columns:1fr 1fr;gap:0 1.4em} h3{margin:.6em 0 .2em} p{margin:.3em 0}
svg{max-height:7.6cm;margin:0}}
"""
OPEN_TARGET = """
<script>
function openTarget(){var d=document.getElementById(location.hash.slice(1));
if(d){d=d.closest("details");if(d){d.open=true;d.scrollIntoView()}}}
addEventListener("hashchange",openTarget);openTarget()
</script>
"""
"""A link to a page in the report opens it; without scripts the page is opened by hand."""


def escaped(text: object) -> str:
    """Text as HTML."""
    return html.escape(str(text))


def document(title: str, body: str) -> str:
    """A whole page; body is HTML."""
    screen = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    head = f'<meta charset="utf-8">{screen}<title>{escaped(title)}</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def table(heads: Iterable[str], rows: Iterable[Iterable[str]], classes: Iterable[str] = ()) -> str:
    """A table of cells that are already HTML; classes are those of the rows."""
    kinds = iter(classes)
    head = "".join(f"<th>{h}</th>" for h in heads)
    lines = "".join(f'<tr class="{next(kinds, "")}">{"".join(f"<td>{c}</td>" for c in row)}</tr>' for row in rows)
    return f"<table><tr>{head}</tr>{lines}</table>"


def text_table(heads: Iterable[str], rows: Iterable[Iterable[object]], classes: Iterable[str] = ()) -> str:
    """A table of plain text."""
    return table(map(escaped, heads), (map(escaped, row) for row in rows), classes)


def pairs(rows: Sequence[tuple[str, object]]) -> str:
    """A table of names and values without a head; rows without a value are left out, and no rows are no table."""
    lines = "".join(
        f'<tr><th>{escaped(name)}</th><td class="long">{escaped(value)}</td></tr>' for name, value in rows if value
    )
    return f'<table class="pairs">{lines}</table>' if lines else ""


def image(png: bytes, alt: str) -> str:
    """A picture inside the page."""
    return f'<img alt="{escaped(alt)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def section(heading: str, *content: str) -> str:
    """A heading with what stands under it; nothing where that is nothing. The content is HTML."""
    inside = "".join(content)
    return f"<section><h3>{escaped(heading)}</h3>{inside}</section>" if inside else ""


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text, nothing for none."""
    mark = f' class="{kind}"' if kind else ""
    return f"<p{mark}>{escaped(text)}</p>" if text else ""
