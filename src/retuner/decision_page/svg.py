"""Line drawings: as SVG for a page, as an SVG file that is light or dark as its reader's screen is, or as PNG.

SVG is sharp on paper, a few ten kilobytes each, and alike for equal numbers.

Coordinates keep one decimal (a tenth of a point), curves of many samples keep the extremes of every stretch, and the
font is the reader's own: what takes room and cannot be seen is left out.
"""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager

from matplotlib import rc_context
from matplotlib.figure import Figure

from retuner.decision_page.drawing_style import TONES
from retuner.templates import palette

_COLOUR = re.compile("|".join(TONES))
DPI = 110
KINDS = (".png", ".svg")  # Endings of the files that a drawing is written to
_PATH = re.compile(r' d="[^"]*"')
_DECIMALS = re.compile(r"(\.\d)\d+")
_HEAD = re.compile(r"^.*?(?=<svg)", re.DOTALL)
_METADATA = re.compile(r"\s*<metadata>.*?</metadata>", re.DOTALL)
_SIZE = re.compile(r'<svg ([^>]*?)width="[^"]*" height="[^"]*"', re.DOTALL)


@contextmanager
def settings() -> Iterator[None]:
    """The look of these drawings."""
    with rc_context({
        "svg.fonttype": "none", "svg.hashsalt": "retuner", "text.parse_math": False, "font.size": 9.0,
        "font.family": ["DejaVu Sans", "sans-serif"], "axes.titlesize": 9.5, "axes.titley": 1.0,
        "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True,
        "axes.xmargin": 0.0, "grid.alpha": 0.35, "grid.linewidth": 0.6, "legend.frameon": False, "legend.fontsize": 8.5,
    }):  # fmt: skip
        yield


def svg(figure: Figure, alt: str, *, tight: bool = False) -> str:
    """The drawing as an <svg> element that fills the width it is given; tight : cut or grown to what is drawn."""
    buffer, nothing = io.StringIO(), {"Date": None, "Creator": None, "Format": None, "Type": None}
    with settings():
        figure.savefig(buffer, format="svg", metadata=nothing, bbox_inches="tight" if tight else None)
    text = _METADATA.sub("", _HEAD.sub("", buffer.getvalue()))
    text = _COLOUR.sub(lambda found: f"var(--{TONES[found[0]]})", text)
    text = _PATH.sub(lambda found: _DECIMALS.sub(r"\1", found[0]), text)
    label = alt.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return _SIZE.sub(rf'<svg role="img" aria-label="{label}" \1', text, count=1)


def svg_file(drawing: str) -> str:
    """The <svg> element as a file of its own, which brings the pages' colours along."""
    return drawing.replace(">", f"><style>{palette()} text{{fill:var(--ink)}}</style>", 1)


def drawn(figure: Figure, alt: str, kind: str) -> bytes:
    """The drawing as a file of a kind (KINDS); without the date, so that equal numbers give equal bytes."""
    if kind.lower() == ".svg":
        return svg_file(svg(figure, alt, tight=True)).encode()
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, bbox_inches="tight", metadata={"Software": None})
    return buffer.getvalue()
