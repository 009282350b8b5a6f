"""The picture of a schedule: records, the process over the variable, gains, Ms and J before and after."""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from retuner.adaptive.schedule_design.places import OUT
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.decision_page.svg import BANDS, FAINT, MARK, settings, thinned
from retuner.report.plots import FIXED, PV, SP
from retuner.schedule.table import Lookup
from retuner.scheduling import ScheduleDesign

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FINE = 201
SHOWN_MS, SHOWN_J = 3.0, 3.0
"""Largest values that the axes make room for."""
MOST_POINTS = 2400
"""Points of a record that are drawn."""
CURVES = (("k", "process gain k"), ("tau", "lag [s]"), ("theta", "dead time [s]"))


SHOWS = "records, process, gains, Ms and J over the variable"


@settings("schedule")
def schedule_figure(found: ScheduleDesign, windows: Sequence[Window]) -> Figure:
    """Draw it."""
    figure = Figure(figsize=(14, 11))
    along = " and ".join(filter(None, (found.variable, found.second)))
    figure.suptitle(f"{along}: {found.reason}", x=0.06, ha="left", fontsize=14, weight="bold")
    grid = figure.add_gridspec(
        4, 2, height_ratios=(1.15, 1, 1, 1), hspace=0.28, wspace=0.14, left=0.06, right=0.955, top=0.94, bottom=0.05
    )
    _records(figure.add_subplot(grid[0, :]), found, windows)
    first: Axes | None = None
    for i, (name, label) in enumerate(CURVES):
        axes = figure.add_subplot(grid[1 + i, 0], sharex=first)
        first = first or axes
        # One parameter with its band of two standard deviations
        x = np.linspace(found.places[0].x, found.places[-1].x, FINE)
        top = 1e-300
        for x2, style in zip(found.slices, STYLES, strict=False):
            value, std = _parameter(found, name, x, x2)
            axes.fill_between(x, value * np.exp(-OUT * std), value * np.exp(OUT * std), color=PV, alpha=0.2, lw=0)
            axes.plot(x, value, color=PV, lw=1.6, ls=style, label=_at(found, x2))
            top = max(float(np.max(value)), top)
        if found.second:
            axes.legend(loc="upper right", fontsize=8, frameon=False, ncols=3)
        axes.set_ylim(0, 1.35 * top)
        axes.set_ylabel(label)
        _visited(axes, found)
        if name == "tau":
            axes.set_ylabel("lag [s], cut where it\nacts as an integrator", fontsize=9)
    panels = [figure.add_subplot(grid[1 + i, 1], sharex=first) for i in range(3)]
    _gains(panels[0], found)
    _judged(panels[1], found, "ms")
    _judged(panels[2], found, "j")
    for axes in figure.axes[1:]:
        _dress(axes, found)
    for axes in (figure.axes[3], figure.axes[6]):
        axes.set_xlabel(_axis_label(found))
    return figure


def _axis_label(found: ScheduleDesign) -> str:
    unit = found.table.regions.unit if found.table is not None else ""
    named = f"{found.variable} [{unit}]" if unit else found.variable
    middle = found.slices[len(found.slices) // 2]
    return named if middle is None else f"{named}; on the right at {_at(found, middle)}"


def _dress(axes: "Axes", found: ScheduleDesign) -> None:
    axes.grid(alpha=0.3)
    axes.set_xlim(found.places[0].x, found.places[-1].x)
    middle = found.slices[len(found.slices) // 2]
    for a, b in pairwise([place for place in found.places if place.x2 == middle]):
        if not (a.known and b.known):
            axes.axvspan(a.x, b.x, color=FAINT, alpha=0.15, lw=0, zorder=0)
    if found.table is None:
        return
    hard = found.table.lookup is Lookup.HARD
    edges = found.layout.edges
    marks = edges[1:-1] if hard else [(a + b) / 2 for a, b in pairwise(edges)]
    for x in marks:
        axes.axvline(x, color=MARK, lw=0.8, ls="--" if hard else ":")


def _records(axes: "Axes", found: ScheduleDesign, windows: Sequence[Window]) -> None:
    """pv and setpoint of all records, one after the other, coloured by the part of the table that is in force."""
    begin = 0.0
    for i, window in enumerate(windows):
        hours = (begin + window.t_s - window.t_s[0]) / 3600.0
        axes.plot(*thinned(hours, window.pv, MOST_POINTS), color=PV, lw=0.8, label=None if i else "pv")
        axes.plot(*thinned(hours, window.sp, MOST_POINTS), color=SP, lw=0.8, ls="--", label=None if i else "setpoint")
        begin += float(window.t_s[-1] - window.t_s[0]) * 1.02
    if found.table is not None and found.variable in {"sp", "pv"}:
        edges = [-1e9, *found.layout.edges[1:-1], 1e9]
        for i, (low, high) in enumerate(pairwise(edges)):
            axes.axhspan(low, high, color=BANDS[i % len(BANDS)], lw=0, zorder=0)
    every_pv = np.concatenate([window.pv for window in windows])
    room = 0.05 * float(np.ptp(every_pv))
    axes.set_ylim(float(every_pv.min()) - room, float(every_pv.max()) + room)
    axes.margins(x=0)
    axes.set_xlabel("time [h]")
    told = ", coloured by the regions that follow from them" if found.table is not None else ""
    axes.set_title(f"the records{told}", loc="left", fontsize=10)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.985), fontsize=8, frameon=False, ncols=2)


STYLES = ("-", "--", ":")
"""Of lines at the low end, the middle and the high end of a second variable."""


def _at(found: ScheduleDesign, x2: float | None) -> str:
    """Where the second variable stands; empty where there is none."""
    return "" if x2 is None else f"{found.second} {x2:.4g}"


def _parameter(found: ScheduleDesign, name: str, x: FloatArray, x2: float | None) -> tuple[FloatArray, FloatArray]:
    """Values and standard deviations of their logarithm."""
    models = [found.model_at(float(v), x2) for v in x]
    values = {
        "k": [abs(m.k) for m in models],
        "tau": [m.tau1_s + m.tau2_s for m in models],
        "theta": [m.theta_s for m in models],
    }[name]
    row = {"theta": (0, 1, 0), "tau": (0, 0, 1), "k": (1, 0, 1)}[name]
    way = np.array([*row, *[0] * (len(found.places[0].ln_std) - 3)], dtype=np.float64)
    std = [float(np.sqrt(way @ found.design.curves.ln_covariance(float(v), x2) @ way)) for v in x]
    return np.array(values), np.array(std)


def _visited(axes: "Axes", found: ScheduleDesign) -> None:
    """Where the records have been: a tick for every stretch's mean at the foot."""
    means = [float(np.mean(stretch.x)) for stretch in found.design.curves.joint.stretches]
    axes.plot(means, np.full(len(means), 0.03), "|", color=SP, ms=8, transform=axes.get_xaxis_transform())


def _gains(axes: "Axes", found: ScheduleDesign) -> None:
    """Kc and tau_I over the variable: the table's, every place's own, and those in force before."""
    x = np.linspace(found.places[0].x, found.places[-1].x, FINE)
    middle = found.slices[len(found.slices) // 2]
    known = [place for place in found.places if place.known and place.x2 == middle]
    axes.plot([p.x for p in known], [p.own.kp for p in known], color=SP, lw=0.9, ls=":", label="Kc, best at each place")
    if found.table is not None:
        for x2, style in zip(found.slices, STYLES, strict=False):
            if x2 != middle:
                axes.plot(x, [found.gains_at(float(v), x2).kp for v in x], color=PV, lw=1.0, ls=style)
        sets = [found.gains_at(float(v), middle) for v in x]
        axes.plot(x, [g.kp for g in sets], color=PV, lw=1.8, label="Kc of the schedule")
        twin = axes.twinx()
        twin.plot(x, [g.kp / g.ki for g in sets], color=MARK, lw=1.2, label="tau_I of the schedule [s]")
        twin.set_ylim(bottom=0)
        twin.tick_params(axis="y", colors=MARK)
        twin.legend(loc="lower right", fontsize=8, frameon=False)
    before = [found.before_at(float(v)) for v in x]
    if all(g is not None for g in before):
        axes.plot(x, [g.kp for g in before if g is not None], color=FIXED, lw=1.2, label="Kc before")
    axes.set_ylabel("Kc")
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.legend(loc="upper left", fontsize=8, frameon=False)


def _judged(axes: "Axes", found: ScheduleDesign, what: str) -> None:
    """Ms or J along the variable, before and after."""
    middle = found.slices[len(found.slices) // 2]
    known = [place for place in found.places if place.known and place.x2 == middle]
    x = [place.x for place in known]
    most = SHOWN_MS if what == "ms" else SHOWN_J
    if found.table is not None:
        after = [place.judged(found.gains_at(place.x, place.x2)) for place in known]
        axes.plot(x, [min(getattr(a, what), most) for a in after], color=PV, lw=1.8, label="with the schedule")
        if what == "ms":
            worst = [min(a.ms_worst, most) for a in after]
            axes.plot(x, worst, color=PV, lw=0.8, ls="--", label="worst that the records allow")
    before = [(p.x, p.judged(g)) for p in known if (g := found.before_at(p.x)) is not None]
    if before:
        axes.plot(
            [v for v, _ in before],
            [min(getattr(b, what), most) for _, b in before],
            color=FIXED,
            lw=1.4,
            label="before",
        )
    limit = found.limits.ms if what == "ms" else found.limits.j
    axes.axhline(limit, color=MARK, lw=0.9, label=f"limit {limit:g}")
    axes.set_ylabel("Ms" if what == "ms" else "J over the place's own")
    axes.set_ylim(1.0 if what == "ms" else 0.0, most)
    axes.legend(loc="upper left", fontsize=8, frameon=False, ncols=2)
