"""Panels of curves as SVG, written here: a page has dozens, and a plotting library takes a tenth of a second for each.

Lengths are tenths of a point, so that coordinates are whole numbers. Colours are those of drawing_style.py.
"""

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from retuner.decision_page.drawing_style import TONES

Range: TypeAlias = tuple[float, float]
Place: TypeAlias = tuple[int, int, int, int]
BETWEEN = 140  # room between panels one above the other
FONT, LETTER = 90, 50  # height of letters, and how wide one is about
KEY, GAP, ROW = 200, 60, 125  # length of a sample of line beside its name, room after it, distance of rows of names
TICK, TICKS_APART = 35, (500, 240)  # length of a tick; how far from each other ticks are at the least, along x and y
ROUND = (1.0, 2.0, 2.5, 5.0, 10.0)  # ticks are multiples of one of these times a power of ten
FAR = 30_000  # where a curve that leaves the drawing is cut off, long after its panel has ended


class Stroke(NamedTuple):
    """colour : of drawing_style.py. width : of the line, 0 where the curve's inside is filled. dash : as SVG has it."""

    colour: str
    width: float = 10.0
    dash: str = ""
    opacity: float = 1.0

    @property
    def style(self) -> str:
        """How SVG says it."""
        colour = f"var(--{TONES[self.colour]})" if self.colour in TONES else self.colour
        if not self.width:
            return f"fill:{colour};opacity:{self.opacity}"
        dash = f";stroke-dasharray:{self.dash}" * bool(self.dash)
        return f"stroke:{colour};stroke-width:{self.width:g};opacity:{self.opacity}{dash}"


INK, GRID = Stroke("#000000", 8), Stroke("#b0b0b0", 6, opacity=0.35)


class Panel:
    """Curves in a rectangle. place : its left, top, width and height. x, y : the values at its edges."""

    def __init__(self, place: Place, x: Range, y: Range) -> None:
        self.place, self.x, self.y = place, x if x[0] < x[1] else (x[0] - 0.5, x[0] + 0.5), y
        self._shapes: list[str] = []
        self._texts: list[str] = []
        self._keys: list[tuple[str, Stroke]] = []

    def curve(self, x: ArrayLike, y: ArrayLike, look: Stroke, label: str = "") -> None:
        """A line through points, broken where one is not known; label : its name above the panel."""
        points = self._at(x, y)
        known = np.isfinite(points).all(axis=1)
        starts = np.flatnonzero(np.diff(known)) + 1
        drawn = [part for part, ok in zip(np.split(points, starts), np.split(known, starts), strict=True) if ok[:1]]
        path = "".join("M" + " ".join(map(str, part.astype(int).ravel().tolist())) for part in drawn)
        self._shapes.append(f'<path d="{path}" style="{look.style}"/>')
        if label:
            self._keys.append((label, look))

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, look: Stroke, label: str = "") -> None:
        """What lies between two curves, filled."""
        across, up = (np.concatenate([one, np.asarray(back)[::-1]]) for one, back in ((x, x), (low, high)))
        self.curve(across, up, look._replace(width=0), label)

    def note(self, at: Range, text: str, away: tuple[int, int], colour: str = INK.colour, *, dot: bool = False) -> None:
        """A text so far away from a point, which may be marked by a dot."""
        (across, down), style = self._at(at[:1], at[1:])[0].astype(int).tolist(), Stroke(colour, 0).style
        self._shapes += [f'<circle cx="{across}" cy="{down}" r="24" style="{style}"/>'] * dot
        self._texts.append(_text(across + away[0], down + away[1], text, "start" if away[0] else "middle", style))

    def _at(self, x: ArrayLike, y: ArrayLike) -> np.ndarray:
        left, top, width, height = self.place
        across = left + width * (np.asarray(x, float) - self.x[0]) / (self.x[1] - self.x[0])
        down = top + height * (self.y[1] - np.asarray(y, float)) / (self.y[1] - self.y[0])
        return np.clip(np.stack([across, down], axis=1).round(), -FAR, FAR)

    def drawn(self, ident: str, x_label: str, y_label: str, *, title: str = "", columns: int = 6, up: int = 0) -> str:
        """The panel with ticks, names of the axes (that of x also where no number stands at it) and of the curves.

        ident : of its edges, one of a kind on a page. columns : of names so far up above it, over these the title.
        """
        left, top, width, height = self.place
        bottom, middle, grid, ticks, numbers = top + height, top + height // 2, "", "", []
        for value in ticks_of(self.x, width / TICKS_APART[0]):
            at = int(self._at([value], [self.y[0]])[0, 0])
            grid, ticks = f"{grid}M{at} {bottom}v-{height}", f"{ticks}M{at} {bottom}v{TICK}"
            numbers += [_text(at, bottom + 140, f"{value:.8g}", "middle")] * bool(x_label)
        for value in ticks_of(self.y, height / TICKS_APART[1]):
            at = int(self._at([self.x[0]], [value])[0, 1])
            grid, ticks = f"{grid}M{left} {at}h{width}", f"{ticks}M{left} {at}h-{TICK}"
            numbers.append(_text(left - 60, at + 32, f"{value:.8g}", "end"))
        start, above = left, top - 50 - up
        rows = -(-len(self._keys) // columns)
        for first in range(min(columns, len(self._keys))):  # column by column, beside a sample of each line
            for row, (label, look) in enumerate(self._keys[first::columns], 1 - rows):
                at = above + ROW * row
                sample = f"M{start} {at - 30}h{KEY}" if look.width else f"M{start} {at - 10}h{KEY}v-50h-{KEY}z"
                numbers.append(f'<path d="{sample}" style="{look.style}"/>{_text(start + KEY + GAP, at, label)}')
            start += KEY + 2 * GAP + LETTER * max(len(label) for label, _ in self._keys[first::columns])
        lines = y_label.split("\n")
        return "".join([
            f'<clipPath id="{ident}"><path d="M{left} {top}h{width}v{height}h-{width}z"/></clipPath>',
            f'<path d="{grid}" style="{GRID.style}"/><g clip-path="url(#{ident})">{"".join(self._shapes)}</g>',
            f'<path d="M{left} {top}v{height}h{width}{ticks}" style="{INK.style}"/>', *numbers, *self._texts,
            _text(left + width // 2, bottom + 265, x_label, "middle"),
            f'<g transform="translate({left - 390} {middle}) rotate(-90)">',
            *(_text(0, 110 * (i + 1 - len(lines)), line, "middle") for i, line in enumerate(lines)), "</g>",
            _text(left, above - 20 - ROW * rows, title),
        ])  # fmt: skip


def stacked(heights: Sequence[int], width: int, room: Place) -> tuple[tuple[int, int], list[Place]]:
    """The size of a drawing of panels one above the other, and their places; room : above, right, below and left."""
    above, right, below, left = room
    tops = [above + sum(heights[:i]) + BETWEEN * i for i in range(len(heights))]
    places = [(left, top, width - left - right, height) for top, height in zip(tops, heights, strict=True)]
    return (width, tops[-1] + heights[-1] + below), places


def page_of(panels: Sequence[str], size: tuple[int, int], alt: str) -> str:
    """The drawing as an <svg> element that fills the width it is given."""
    width, height = size
    return (
        f'<svg role="img" aria-label="{escape(alt)}" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg" '
        f'style="font:{FONT}px DejaVu Sans,sans-serif;fill:none;stroke-linejoin:round">{"".join(panels)}</svg>'
    )


def ticks_of(over: Range, most: float) -> list[float]:
    """Round values in a range, about so many at the most."""
    raw = (over[1] - over[0]) / max(most, 1.0)
    power = 10.0 ** math.floor(math.log10(raw))
    step = power * next(one for one in ROUND if one * power >= raw * (1 - 1e-9))
    return [i * step for i in range(math.ceil(over[0] / step), math.floor(over[1] / step) + 1)]


def room(
    curves: Sequence[ArrayLike], share: float, least: float = -math.inf, most: float = math.inf, *, floor: float = 0.0
) -> Range:
    """The range that these curves need, within limits, with a share of it as room on both sides, and no shorter."""
    known = np.concatenate([np.ravel(one) for one in curves])
    known = known[np.isfinite(known)]
    low, high = (float(np.min(known)), float(np.max(known))) if len(known) else (0.0, 0.0)
    low, high = max(low, least), min(high, most)
    wide = max(share * (high - low), (floor - high + low) / 2) or 0.1 * max(abs(high), 1.0)
    return low - wide, high + wide


def _text(x: int, y: int, text: str, anchor: str = "start", style: str = "") -> str:
    look = f' style="{style}"' * bool(style)
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}"{look}>{escape(text)}</text>' if text else ""
