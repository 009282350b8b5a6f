"""The pictures of a report: trend with region bands and retune marks, and before and after for each region."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray
from retuner.decision_page.svg import AFTER, BANDS, BEFORE, MARK, SETPOINT, settings, svg, thinned
from retuner.report.scores import CO_FLOOR, NOISE_BANDS, Columns, Twin
from retuner.schedule.regions import Regions

PV, SP, FIXED = AFTER, SETPOINT, BEFORE
DENSE = 2400
"""Points of a curve over a whole run."""


def at_least(axes: Axes, floor: float) -> None:
    """Make the axis of values no shorter than that, about its middle."""
    low, high = axes.get_ylim()
    if high - low < floor:
        axes.set_ylim((low + high - floor) / 2, (low + high + floor) / 2)


def floors(pv_axes: Axes, co_axes: Axes, pv: FloatArray) -> None:
    """The floors of pv's and of co's axis."""
    known = pv[np.isfinite(pv)]
    if len(known) > 2:
        at_least(pv_axes, NOISE_BANDS * noise_sigma(known))
    at_least(co_axes, CO_FLOOR)


class Mark(NamedTuple):
    """A change of gains, or the way back, at t_s; number : of its decision, 0 where none is known."""

    t_s: float
    number: int
    rolled_back: bool


def trend_svg(run: Columns, fixed: Columns | None, marks: Sequence[Mark], regions: Regions, unit: str) -> str:
    """`trend_figure` as SVG for a page."""
    with settings("trend"):
        return svg(trend_figure(run, fixed, marks, regions, unit), "Trend with the regions")


def time_axis(t_s: np.ndarray) -> tuple[np.ndarray, str]:
    """Time in the unit that suits the length: hours, minutes or seconds."""
    span = float(t_s[-1] - t_s[0]) if len(t_s) else 0.0
    for seconds, name in ((3600.0, "hours"), (60.0, "minutes")):
        if span > 3 * seconds:
            return (t_s - t_s[0]) / seconds, name
    return t_s - t_s[0], "seconds"


def trend_figure(run: Columns, fixed: Columns | None, marks: Sequence[Mark], regions: Regions, unit: str) -> Figure:
    """Process value, setpoint and output over the whole run; red marks for changes of gains (dotted: undone), each with
    the number of its decision.
    """
    # The panels of a trend from the top: pv and sp, co, and the second scheduling variable where there is one
    with_second = "x2" in run and len(regions.axes) > 1
    heights = (2.0, 1.1, 0.7) if with_second else (2.0, 1.1)
    figure = Figure(figsize=(13, 7.4 if with_second else 6.2))
    figure.subplots_adjust(left=0.055, right=0.99, top=0.89, bottom=0.085, hspace=0.08)
    top, bottom, *further = tuple(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
    x, x_unit = time_axis(run["t"])
    for axes, axis in zip(further, regions.axes[1:], strict=False):
        axes.plot(*thinned(x, run["x2"], DENSE), color=PV, lw=0.5)
        axes.set_ylabel(f"{axis.label} [{axis.unit}]")
    # colour the time spent in each region, with its name once at the top
    region = run["region"]
    starts = np.flatnonzero(np.diff(region, prepend=region[0] - 1))
    ends = [*starts[1:].tolist(), len(region) - 1]
    named: set[int] = set()
    for start, end in zip(starts.tolist(), ends, strict=True):
        i = int(region[start])
        top.axvspan(x[start], x[end], color=BANDS[i % len(BANDS)], lw=0)
        if i not in named and x[end] - x[start] > 0.05 * (x[-1] - x[0]):
            named.add(i)
            top.text(
                (x[start] + x[end]) / 2,
                1.01,
                regions.names[i],
                transform=top.get_xaxis_transform(),
                ha="center",
                va="bottom",
                fontsize=10,
            )
    if fixed is not None:
        n = min(len(x), len(fixed["t"]))
        top.plot(*thinned(x[:n], fixed["pv"][:n], DENSE), color=FIXED, lw=0.8, label="pv with fixed gains")
        bottom.plot(*thinned(x[:n], fixed["co"][:n], DENSE), color=FIXED, lw=0.5)
    top.plot(*thinned(x, run["pv"], DENSE), color=PV, lw=0.9, label="pv retuned")
    top.plot(*thinned(x, run["sp"], DENSE), color=SP, lw=0.9, ls="--", label="sp")
    bottom.plot(*thinned(x, run["co"], DENSE), color=PV, lw=0.7)
    scale = (run["t"][-1] - run["t"][0]) / max(float(x[-1]), 1e-12)
    _marks((top, bottom, *further), marks, float(run["t"][0]), scale)
    top.set_ylabel(f"pv, sp [{unit}]")
    bottom.set_ylabel("co [%]")
    (bottom, *further)[-1].set_xlabel(f"time [{x_unit}]")
    top.legend(loc="lower left", bbox_to_anchor=(0.0, 1.06), ncols=5, fontsize=9, frameon=False)
    for axes in (top, bottom, *further):
        axes.margins(x=0)
        axes.grid(alpha=0.3)
    floors(top, bottom, run["pv"])
    figure = top.get_figure()
    assert isinstance(figure, Figure)
    return figure


def _marks(panels: Sequence[Axes], marks: Sequence[Mark], start_s: float, scale: float) -> None:
    """A line through all panels for each mark, its decision's number beside it in the first one."""
    labelled: set[bool] = set()
    for mark in marks:
        at = (mark.t_s - start_s) / scale
        style, name = (":", "change rolled back") if mark.rolled_back else ("-", "gains changed")
        for axes in panels:
            axes.axvline(at, color=MARK, lw=1.1, ls=style, label=None if mark.rolled_back in labelled else name)
            labelled.add(mark.rolled_back)
        if mark.number:
            place = panels[0].get_xaxis_transform()
            panels[0].text(at, 0.015, f" {mark.number}", transform=place, color=MARK, fontsize=8, va="bottom")


def twin_svg(run: Columns, fixed: Columns | None, twin: Twin, name: str, unit: str, *, commissioned: bool) -> str:
    """One setpoint step with the commissioned gains and with the final ones, as SVG for a page."""
    with settings(f"twin {name}"):
        # The same setpoint step with the commissioned gains and with the final ones, on one time axis.
        # fixed : the same run with the commissioned gains, where there is one: then the same step of it is drawn;
        # else the first such step of this run, and commissioned says whether it still ran on those gains.
        figure = Figure(figsize=(6.3, 4.6))
        figure.subplots_adjust(left=0.11, right=0.985, top=0.93, bottom=0.11, hspace=0.1)
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1))
        length = min(twin.first[1] - twin.first[0], twin.last[1] - twin.last[0])
        first = "first time, with the baseline gains" if commissioned else "first time, already retuned"
        before = (run, twin.first[0], first)
        if fixed is not None and len(fixed["t"]) >= twin.last[1]:
            before = (fixed, twin.last[0], "with the baseline gains")
        after = (run, twin.last[0], "with the final gains")
        for (columns, start, label), colour in ((before, FIXED), (after, PV)):
            lead = min(start, length // 20)
            part = slice(start - lead, start + length)
            t = columns["t"][part] - columns["t"][start]
            top.plot(t, columns["pv"][part], color=colour, lw=1.4, label=label)
            bottom.plot(t, columns["co"][part], color=colour, lw=0.9)
        start, _ = twin.last
        lead = min(start, length // 20)
        part = slice(start - lead, start + length)
        top.plot(run["t"][part] - run["t"][start], run["sp"][part], color=SP, lw=0.9, ls="--", label="sp")
        top.set_title(f"{name}: {twin.text} {unit}", fontsize=10)
        top.set_ylabel(f"pv [{unit}]")
        bottom.set_ylabel("co [%]")
        bottom.set_xlabel("seconds after the step")
        top.legend(fontsize=9)
        for axes in (top, bottom):
            axes.margins(x=0)
            axes.grid(alpha=0.3)
        floors(top, bottom, run["pv"][part])
        return svg(figure, f"{name}: with the baseline gains and with the final ones")
