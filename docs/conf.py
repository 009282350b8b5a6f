"""The documentation site: `make docs` builds it, strict, from these pages, the commands, and the Python interface.

Sphinx, because it is kept up by many hands, reads the Markdown pages as they stand (MyST), holds links and their
anchors to be right, takes the Python reference from the docstrings, and makes pages that load nothing from the net and
can be searched from a folder, without a server. (Material for MkDocs is in maintenance; its successor is at 0.1.)
"""

import re
import runpy
import sys
from importlib.metadata import version as installed
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(ROOT / "scripts"))
from docstring_markup import as_rst  # noqa: E402  stands in scripts/

project = "retuner"
author = "The retuner developers"
copyright = "the retuner developers, MIT licence"  # noqa: A001  Sphinx's name
version = release = installed("retuner")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx_copybutton"]
exclude_patterns = ["_build"]
nitpicky = False  # names in docstrings are words for readers; links between pages are checked all the same

myst_heading_anchors = 4  # links to page.md#section are checked against the headings
myst_fence_as_directive = ["mermaid"]
nb_execution_mode = "off"  # the notebooks are run, and held to what they show, by tests/pages

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
maximum_signature_line_length = 60  # longer ones have one parameter a line

ARRAY = "~numpy.ndarray[tuple[~typing.Any, ...], ~numpy.dtype[~numpy.{}]]"
NUMBERS = f"~collections.abc.Sequence[float] | {ARRAY.format('floating')}"
MOMENTS = (
    f"~collections.abc.Sequence[~datetime.datetime] | {ARRAY.format('datetime64')} | {ARRAY.format('timedelta64')}"
)
LONG_TYPES = ((f"{NUMBERS} | {MOMENTS}", "Times"), (NUMBERS, "Numbers"))
REPOSITORY = "https://github.com/retuner/retuner"

toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"retuner {release}"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_theme_options = {"source_repository": f"{REPOSITORY}/", "source_branch": "main", "source_directory": "docs/"}
html_copy_source = False
html_show_sourcelink = False


class StateDiagram(Directive):
    """A state diagram as GitHub draws it (```mermaid), here as the table of its transitions: no script, no net."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """A row for each arrow."""
        rows = [("from", "to", "on")]
        for line in self.content:
            arrow = re.fullmatch(r"\s*(\S+) --> (\S+?)(?:: (.*))?", line)
            if arrow:
                rows.append(tuple("start or end" if part == "[*]" else part or "" for part in arrow.groups()))
        return [_table(rows)]


def _table(rows: list[tuple[str, ...]]) -> nodes.table:
    group = nodes.tgroup(cols=len(rows[0]))
    group += [nodes.colspec(colwidth=1) for _ in rows[0]]
    parts = nodes.thead(), nodes.tbody()
    for number, row in enumerate(rows):
        line = nodes.row()
        line += [nodes.entry("", nodes.paragraph(text=cell)) for cell in row]
        parts[number > 0].append(line)
    group += parts
    table = nodes.table()
    table += group
    return table


def _write_reference(_app: Sphinx) -> None:
    """The pages that are the code's own: not in the repository, so they cannot fall behind it."""
    for name in ("commands", "python"):
        text = runpy.run_path(str(ROOT / "scripts" / f"document_{name}.py"))["page"]()
        page = HERE / f"{name}.md"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def _link_to_repository(_app: Sphinx, name: str, source: list[str]) -> None:
    """Pages of the repository that are no pages of the site are linked where they stand."""

    def told(link: re.Match[str]) -> str:
        path = (HERE / name).parent.joinpath(link[1]).resolve()
        if path.is_relative_to(HERE):
            return link[0]
        if not path.is_file():
            raise FileNotFoundError(f"{name}: no file {link[1]}")
        return f"]({REPOSITORY}/blob/main/{path.relative_to(ROOT).as_posix()}"

    source[0] = re.sub(r"\]\((\.\./[^)#]+\.md)(?=[)#])", told, source[0])


def _marked_up(_app: Sphinx, _what: str, _name: str, _of: object, _options: object, lines: list[str]) -> None:
    """Docstrings of the Python interface."""
    lines[:] = as_rst("\n".join(lines))


def _short_types(*event: object) -> tuple[str, str] | None:
    """Types without their modules, arrays under the names that the code has for them."""
    signature, returned = event[-2:]
    if not isinstance(signature, str):
        return None
    for long, short in LONG_TYPES:
        signature = signature.replace(long, short)
    signature = re.sub(r"<(?:function |[\w.]+: )([^>]+)>", r"\1", signature).replace("mappingproxy({})", "{}")
    bare = re.compile(r"~?\b(?:[a-z_][a-z0-9_]*\.)+(?=[A-Za-z_])")
    return bare.sub("", signature), bare.sub("", str(returned or ""))


def setup(app: Sphinx) -> None:
    """What Sphinx asks this file for."""
    app.add_directive("mermaid", StateDiagram)
    app.connect("builder-inited", _write_reference)
    app.connect("source-read", _link_to_repository)
    app.connect("autodoc-process-docstring", _marked_up)
    app.connect("autodoc-process-signature", _short_types)
