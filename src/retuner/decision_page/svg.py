"""Line drawings: as SVG for a page, as an SVG file that is light or dark as its reader's screen is, or as PNG.

SVG is sharp on paper, a few ten kilobytes each, and alike for equal numbers.

Coordinates keep one decimal (a tenth of a point), curves of many samples keep the extremes of every stretch, and the
font is the reader's own: what takes room and cannot be seen is left out.
"""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.figure import Figure

from retuner.adaptive.signals.sample import FloatArray
from retuner.templates import palette

BEFORE, AFTER, MODEL, SETPOINT, FAINT, LIMIT = "#d55e00", "#0072b2", "#d55e00", "#222222", "#9a9a9a", "#cc79a7"
"""Colours that colour-blind readers tell apart (Okabe & Ito 2008), each with a line style of its own beside it."""
BANDS = ("#e4eef7", "#f8f0df", "#f5e4ec", "#e2f1ea", "#ecebf5")
"""Behind the time spent in each region."""
MARK = "#a3261b"
"""Colour of a change of gains."""
TONES = {
    "#000000": "ink",
    "#ffffff": "paper",
    "#b0b0b0": "line",
    BEFORE: "before",
    AFTER: "pv",
    SETPOINT: "sp",
    FAINT: "faint",
    MARK: "bad",
} | {band: f"band{i}" for i, band in enumerate(BANDS)}
"""Which colour of the pages' palette (templates/palette.css) each is: drawings follow light and dark."""
_COLOUR = re.compile("|".join(TONES))
MOST_POINTS = 900
"""Points of a drawn curve."""
DPI = 110
KINDS = (".png", ".svg")
"""Endings of the files that a drawing is written to."""
_PATH = re.compile(r' d="[^"]*"')
_DECIMALS = re.compile(r"(\.\d)\d+")
_HEAD = re.compile(r"^.*?(?=<svg)", re.DOTALL)
_METADATA = re.compile(r"\s*<metadata>.*?</metadata>", re.DOTALL)
_SIZE = re.compile(r'<svg ([^>]*?)width="[^"]*" height="[^"]*"', re.DOTALL)


@contextmanager
def settings(name: str) -> Iterator[None]:
    """The look of these drawings; name : tells the ids of one drawing on a page from those of another."""
    with rc_context(
        {
            "svg.fonttype": "none",
            "text.parse_math": False,
            "font.size": 9.0,
            "axes.titlesize": 9.5,
            "axes.titley": 1.0,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "font.family": ["DejaVu Sans", "sans-serif"],
            "axes.grid": True,
            "grid.alpha": 0.35,
            "grid.linewidth": 0.6,
            "axes.axisbelow": True,
            "legend.frameon": False,
            "legend.fontsize": 8.5,
            "axes.xmargin": 0.0,
            "svg.hashsalt": name,
        }
    ):
        yield


def svg(figure: Figure, alt: str, *, tight: bool = False) -> str:
    """The drawing as an <svg> element that fills the width it is given; tight : cut or grown to what is drawn."""
    buffer, nothing = io.StringIO(), {"Date": None, "Creator": None, "Format": None, "Type": None}
    with settings(rcParams["svg.hashsalt"] or alt):  # the name of who draws on a page, else its own
        figure.savefig(buffer, format="svg", metadata=nothing, bbox_inches="tight" if tight else None)
    text = _METADATA.sub("", _HEAD.sub("", buffer.getvalue()))
    text = _COLOUR.sub(lambda found: f"var(--{TONES[found[0]]})", text)
    text = _PATH.sub(lambda found: _DECIMALS.sub(r"\1", found[0]), text)
    label = alt.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return _SIZE.sub(rf'<svg role="img" aria-label="{label}" \1', text, count=1)


def svg_file(figure: Figure, alt: str) -> str:
    """The drawing as a file of its own, which brings the pages' colours along."""
    return svg(figure, alt, tight=True).replace(">", f"><style>{palette()} text{{fill:var(--ink)}}</style>", 1)


def drawn(figure: Figure, alt: str, kind: str) -> bytes:
    """The drawing as a file of a kind (KINDS); without the date, so that equal numbers give equal bytes."""
    if kind.lower() == ".svg":
        return svg_file(figure, alt).encode()
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, bbox_inches="tight", metadata={"Software": None})
    return buffer.getvalue()


def thinned(x: FloatArray, y: FloatArray, most: int = MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """A curve with at most about so many points: the lowest and the highest of every stretch are kept in order."""
    stretch = 2 * len(x) // most
    if stretch < 2:
        return x, y
    whole = len(x) // stretch * stretch
    rows = y[:whole].reshape(-1, stretch)
    places = np.stack([rows.argmin(axis=1), rows.argmax(axis=1)], axis=1) + stretch * np.arange(len(rows))[:, None]
    kept = np.unique(np.concatenate([[0], places.ravel(), [len(x) - 1]]))
    return x[kept], y[kept]


def steps(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A held signal as a line: the value stays until the next sample."""
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
