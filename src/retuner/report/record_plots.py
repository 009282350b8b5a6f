"""The picture of one record: setpoint, pv and its explanations, co, what is left, pv over co, evidence."""

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.decision_page.drawing_style import FAINT, MARK, MODEL, PV, SP, time_axis
from retuner.decision_page.svg import settings
from retuner.report.change_of_settings import ShownChange
from retuner.report.loop_plots import change_into, floors
from retuner.schedule.late_dataclass import dataclass

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAR_SETPOINT_RANGES = 2.0  # A setpoint further from pv than this many ranges of pv would leave no room for the curves
HEIGHT, HEIGHT_OF_CHANGE = 8.2, 5.4  # inches of the picture, and of what before and after add to it
BELOW = 0.57  # inches for the labels of time
WHOLE: dict[str, Any] = {"width_ratios": (2.1, 1), "height_ratios": (2, 1.3, 1), "wspace": 0.08}
CHANGED: dict[str, Any] = {"width_ratios": (2.1, 0.75, 0.75), "height_ratios": (1.6, 1), "wspace": 0.16}
"""Shapes of the two grids of panels."""
MOST_POINTS = 300  # points of pv over co
LINE_WIDTH, MOST_LINES = 72, 27  # characters in a line of the text beside the curves, and lines that fit


@dataclass(frozen=True, slots=True)
class ExplainedCurve:
    """pv as something explains it. t_s, pv : shape (m,), m samples of the record or as many as it was condensed to."""

    name: str
    t_s: FloatArray
    pv: FloatArray

    @classmethod
    def of(cls, name: str, window: Window, pv: FloatArray) -> "ExplainedCurve":
        """An explanation of every n-th sample of a window."""
        return cls(name, window.t_s[:: -(-len(window.t_s) // len(pv))], np.asarray(pv, dtype=np.float64))


@dataclass(frozen=True, slots=True)
class RecordPicture:
    """What is drawn.

    window : the record. title, subtitle : the finding and its sentence. lines : text beside the curves.
    explanations : pv as rivals explain it, the one that is believed last. loads_s : when load steps entered.
    limits : of co, None where not known. noise_std : of pv's noise, for the band round the remainder.
    closed_loop : there was a controller with a setpoint. change : what the recommended settings would have done.
    """

    window: Window
    title: str
    subtitle: str
    lines: Sequence[str]
    explanations: Sequence[ExplainedCurve] = ()
    loads_s: Sequence[float] = ()
    limits: tuple[float | None, float | None] = (None, None)
    noise_std: float = 0.0
    closed_loop: bool = True
    change: ShownChange | None = None


@settings()
def record_figure(picture: RecordPicture) -> Figure:
    """Draw it: the record with its explanations, and below it before and after where a change is recommended."""
    height = HEIGHT if picture.change is None else HEIGHT + HEIGHT_OF_CHANGE
    figure = Figure(figsize=(15, height))

    def down(inches: float) -> float:
        return 1 - inches / height

    figure.suptitle(picture.title, x=0.06, y=down(0.16), ha="left", fontsize=14, weight="bold")
    figure.text(0.06, down(0.53), picture.subtitle, ha="left", va="top", fontsize=10.5, wrap=True)
    sides: dict[str, Any] = {"left": 0.06, "hspace": 0.12}
    grid = figure.add_gridspec(3, 2, **WHOLE, **sides, right=0.955, top=down(0.98), bottom=down(HEIGHT - BELOW))
    top = figure.add_subplot(grid[0, 0])
    middle, bottom = (figure.add_subplot(grid[i, 0], sharex=top) for i in (1, 2))
    _over_time(picture, (top, middle, bottom))
    # pv over co: an ellipse, a parallelogram, a cloud
    axes = figure.add_subplot(grid[0, 1])
    every = -(-len(picture.window.co) // MOST_POINTS)
    co, pv = picture.window.co[::every], picture.window.pv[::every]
    axes.plot(co, pv, color=FAINT, lw=0.6)
    axes.scatter(co, pv, c=np.arange(len(co)), s=3, cmap="viridis", linewidths=0)
    axes.set_title("pv over co", fontsize=10)
    axes.yaxis.tick_right()
    axes.grid(alpha=0.3)
    axes = figure.add_subplot(grid[1:, 1])
    axes.set_axis_off()
    lines = [part for line in picture.lines for part in wrap(line, LINE_WIDTH, subsequent_indent="      ") or [""]]
    axes.text(0, 0.95, "\n".join(lines[:MOST_LINES]), va="top", fontsize=7.8, family="monospace", linespacing=1.3)
    if picture.change is not None:
        under: dict[str, Any] = {"top": down(HEIGHT + 0.75), "bottom": down(height - BELOW)}
        change_into(figure, figure.add_gridspec(2, 3, **CHANGED, **sides, **under, right=0.985), picture.change)
    return figure


def _over_time(picture: RecordPicture, panels: tuple["Axes", "Axes", "Axes"]) -> None:
    top, middle, bottom = panels
    x, unit = time_axis(picture.window.t_s)
    # pv, setpoint, and the explanations of pv
    window = picture.window
    top.plot(x, window.pv, color=PV, lw=0.9, label="pv")
    near = abs(float(window.sp[0]) - float(np.mean(window.pv))) < FAR_SETPOINT_RANGES * float(np.ptp(window.pv))
    if picture.closed_loop and (near or np.ptp(window.sp) > 0):
        top.plot(x, window.sp, color=SP, lw=0.9, ls="--", label="sp")
    for i, curve in enumerate(picture.explanations):
        believed = i == len(picture.explanations) - 1
        place = np.interp(curve.t_s, window.t_s, x)
        top.plot(place, curve.pv, color=MODEL if believed else FAINT, lw=1.3 if believed else 1.0, label=curve.name)
    top.set_ylabel("pv, sp")
    # co with its limits where it comes near them
    co = picture.window.co
    middle.plot(x, co, color=PV, lw=0.9, drawstyle="steps-post")
    room = 0.3 * float(np.ptp(co))
    for limit in picture.limits:
        if limit is not None and np.min(co) - room <= limit <= np.max(co) + room:
            middle.axhline(limit, color=FAINT, lw=1.0, ls=":")
    middle.set_ylabel("co")
    window = picture.window
    if not picture.explanations:
        bottom.plot(x, window.sp - window.pv, color=PV, lw=0.8)
        bottom.set_ylabel("sp - pv")
    for i, curve in enumerate(picture.explanations):
        believed = i == len(picture.explanations) - 1
        left = window.pv[np.searchsorted(window.t_s, curve.t_s)] - curve.pv
        bottom.plot(np.interp(curve.t_s, window.t_s, x), left, color=PV if believed else FAINT, lw=0.8)
        bottom.set_ylabel("pv residual")
    bottom.axhspan(-2 * picture.noise_std, 2 * picture.noise_std, color=MODEL, alpha=0.2, lw=0)
    bottom.axhline(0, color=FAINT, lw=0.8)
    floors(top, middle, picture.window.pv)
    for j, t_s in enumerate(picture.loads_s):
        place = float(np.interp(t_s, picture.window.t_s, x))
        for axes in (top, middle, bottom):
            axes.axvline(place, color=MARK, lw=0.9, ls="--", label="load step" if not j else None)
    # the names of the curves above them, where they hide nothing
    top.legend(loc="lower right", bbox_to_anchor=(1.0, 0.985), fontsize=9, frameon=False, ncols=6)
    for axes in (top, middle):
        axes.tick_params(labelbottom=False)
    for axes in (top, middle, bottom):
        axes.margins(x=0)
        axes.grid(alpha=0.3)
    bottom.set_xlabel(f"time [{unit}]")
