"""Pictures of a loop: its trend, and a record before and after a change of settings."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from retuner.adaptive.loop.replayed import before_after
from retuner.adaptive.loop.simulate import step_response
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.decision_page.drawing_style import FIXED, MARK, PV, SP, time_axis
from retuner.decision_page.svg import settings
from retuner.report.change_of_settings import ShownChange, change_words, settling_s
from retuner.report.scores import axis_floors
from retuner.schedule.gains import PidGains
from retuner.simulation.loop_trend import LoopTrend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.gridspec import GridSpec

BAND = 0.22  # opacity of the band over the models
OUT_OF_SIGHT = 1e9  # where an unstable answer is cut off; the axes end long before


def floors(pv_axes: "Axes", co_axes: "Axes", pv: FloatArray) -> None:
    """Make no axis of values shorter than its floor."""
    for axes, floor in zip((pv_axes, co_axes), axis_floors(pv), strict=True):
        low, high = axes.get_ylim()
        if high - low < floor:
            axes.set_ylim((low + high - floor) / 2, (low + high + floor) / 2)


@settings()
def trend_figure(trend: LoopTrend) -> Figure:
    """Setpoint and pv above, co below; a line where gains changed. Raises ValueError: the trend has no samples."""
    if not len(trend.t_s):
        raise ValueError("no samples yet: nothing to draw")
    figure = Figure(figsize=(11, 5.6))
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1))
    x, unit = time_axis(trend.t_s)
    top.plot(x, trend.pv, color=PV, lw=0.9, label="pv")
    top.plot(x, trend.sp, color=SP, lw=0.9, ls="--", label="sp")
    bottom.plot(x, trend.co, color=PV, lw=0.8, drawstyle="steps-post")
    for i, t_s in enumerate(trend.changes_s):
        at = float(np.interp(t_s, trend.t_s, x))
        for axes in (top, bottom):
            axes.axvline(at, color=MARK, lw=1.0, label="gains changed" if i == 0 else None)
    floors(top, bottom, trend.pv)
    _finished(top, bottom, unit)
    top.legend(loc="upper left", bbox_to_anchor=(0.0, 1.13), ncols=3, frameon=False, fontsize=9)
    return figure


def change_into(figure: Figure, grid: "GridSpec", change: ShownChange) -> None:
    """Draw a change into a grid of two rows and three columns: the record, a setpoint step and a load step."""
    top = figure.add_subplot(grid[0, 0])
    # The record, and the same with the new settings, with the band over the models
    low = figure.add_subplot(grid[1, 0], sharex=top)
    found = before_after(change.window, change.processes, change.recommended, change.co_limits, change.active)
    x, unit = time_axis(found.record.t_s)
    for axes, name, before in ((top, "pv", found.record.pv), (low, "co", found.record.co)):
        axes.plot(x, before, color=FIXED, lw=0.9, label="as recorded")
        axes.fill_between(x, *found.band(name), color=PV, alpha=BAND, lw=0, label="on all plausible models")
        axes.plot(x, getattr(found.best, name), color=PV, lw=1.0, label="with the new settings")
        _keep_in_sight(axes, before, getattr(found.best, name))
    top.plot(x, found.record.sp, color=SP, lw=0.9, ls="--", label="sp")
    what = f"the same record with the new settings: {change_words(change.foreseen)}"
    top.set_title(what, fontsize=10, loc="left", pad=18)
    top.legend(loc="lower left", bbox_to_anchor=(-0.01, 0.975), ncols=4, frameon=False, fontsize=8)
    floors(top, low, found.record.pv)
    _finished(top, low, unit)
    for column, load in ((1, False), (2, True)):
        pv = figure.add_subplot(grid[0, column])
        step_panels(pv, figure.add_subplot(grid[1, column], sharex=pv), change, load=load)


def step_panels(top: "Axes", low: "Axes", change: ShownChange, *, load: bool) -> None:
    """A unit step of setpoint or load, before and after, with the band over the models."""
    until_s = settling_s(change.processes[0], change.recommended)
    for gains, colour, name in [(change.active, FIXED, "active"), (change.recommended, PV, "new")]:
        if gains is None:
            continue
        grid = np.linspace(0.0, until_s, 400)
        curves = [_answer(process, gains, grid, load=load) for process in change.processes]
        for axes, which in ((top, 0), (low, 1)):
            stacked = np.stack([curve[which] for curve in curves])
            axes.fill_between(grid, stacked.min(axis=0), stacked.max(axis=0), color=colour, alpha=BAND, lw=0)
            axes.plot(grid, stacked[0], color=colour, lw=1.2, label=name)
    best = _answer(change.processes[0], change.recommended, np.linspace(0.0, until_s, 400), load=load)
    for axes, curve in ((top, best[0]), (low, best[1])):
        axes.set_ylim(*_room(curve, axes.get_ylim()))
    top.set_title("load step of 1 co" if load else "setpoint step of 1", fontsize=10, loc="left")
    top.legend(loc="best", frameon=False, fontsize=8)
    _finished(top, low, "s")


def _room(curve: FloatArray, given: tuple[float, float]) -> tuple[float, float]:
    """Axes for the new settings' answer and its double; an old one that swings further leaves the picture."""
    low, high = min(float(curve.min()), 0.0), max(float(curve.max()), 0.0)
    size = max(high - low, 1e-12)
    return max(given[0], low - size), min(given[1], high + size)


def _keep_in_sight(axes: "Axes", *signals: FloatArray) -> None:
    """An axis for the signals, not for a band that runs away."""
    ends = [(float(np.nanmin(s)), float(np.nanmax(s))) for s in signals if np.any(np.isfinite(s))]
    low, high = min(a for a, _ in ends), max(b for _, b in ends)
    room = 0.25 * max(high - low, 1e-12)
    given = axes.get_ylim()
    axes.set_ylim(max(given[0], low - room), min(given[1], high + room))


def _answer(process: LinearProcess, gains: PidGains, grid: FloatArray, *, load: bool) -> tuple[FloatArray, FloatArray]:
    found = step_response(process, gains, float(grid[-1]), gains.kd / gains.kp / 10.0 if gains.kp else 0.0, load=load)
    pv, co = (np.interp(grid, found.t, values, left=0.0) for values in (found.pv, found.co))
    return np.clip(np.nan_to_num(pv), -OUT_OF_SIGHT, OUT_OF_SIGHT), np.clip(
        np.nan_to_num(co), -OUT_OF_SIGHT, OUT_OF_SIGHT
    )


def _finished(top: "Axes", low: "Axes", unit: str) -> None:
    top.set_ylabel("pv")
    low.set_ylabel("co")
    low.set_xlabel(f"time [{unit}]")
    top.tick_params(labelbottom=False)
    for axes in (top, low):
        axes.margins(x=0)
        axes.grid(alpha=0.3)
