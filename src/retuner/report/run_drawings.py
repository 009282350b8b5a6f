"""The drawings of a report: trend with region bands and retune marks, and before and after for each region."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from retuner.decision_page.drawing_style import AFTER, BANDS, BEFORE, MARK, SETPOINT, thinned, time_axis
from retuner.decision_page.panel import Panel, Stroke, page_of, room, stacked
from retuner.report.scores import Columns, Twin, axis_floors
from retuner.schedule.regions import Regions

DENSE = 2400  # Points of a curve over a whole run
NAMED_SHARE = 0.05  # a region is named over the first stay in it that takes such a share of the run
TREND, TREND_HEIGHTS, TREND_ROOM = 9360, (2250, 1240, 790), (490, 94, 380, 520)  # width; panels; room around them
TWIN, TWIN_HEIGHTS, TWIN_ROOM = 4536, (1700, 1000), (340, 70, 370, 500)
SHARE = 0.05  # room above and below the curves
ABOVE = 125  # room above the first panel for the names of the regions
DASHES = "37 16"


class Mark(NamedTuple):
    """A change of gains, or the way back, at t_s; number : of its decision, 0 where none is known."""

    t_s: float
    number: int
    rolled_back: bool


def trend_svg(run: Columns, fixed: Columns | None, marks: Sequence[Mark], regions: Regions, unit: str) -> str:
    """Process value, setpoint and output over the whole run; red marks for changes of gains (dotted: undone), each with
    the number of its decision.
    """
    # The panels of a trend from the top: pv and sp, co, and the second scheduling variable where there is one
    second = [run["x2"]] if "x2" in run and len(regions.axes) > 1 else []
    size, places = stacked(TREND_HEIGHTS[: 2 + len(second)], TREND, TREND_ROOM)
    x, x_unit = time_axis(run["t"])
    n = 0 if fixed is None else min(len(x), len(fixed["t"]))
    old = {name: [fixed[name][:n]] if fixed is not None else [] for name in ("pv", "co")}
    over = (float(x[0]), float(x[-1]))
    floor = axis_floors(run["pv"])
    top = Panel(places[0], over, room([run["pv"], run["sp"], *old["pv"]], SHARE, floor=floor[0]))
    bottom = Panel(places[1], over, room([run["co"], *old["co"]], SHARE, floor=floor[1]))
    # colour the time spent in each region, with its name once at the top
    region = run["region"]
    starts = np.flatnonzero(np.diff(region, prepend=region[0] - 1))
    named: set[int] = set()
    for start, end in zip(starts.tolist(), [*starts[1:].tolist(), len(region) - 1], strict=True):
        i = int(region[start])
        top.band((x[start], x[end]), (top.y[0],) * 2, (top.y[1],) * 2, Stroke(BANDS[i % len(BANDS)]))
        if i not in named and x[end] - x[start] > NAMED_SHARE * (x[-1] - x[0]):
            named.add(i)
            top.note(((x[start] + x[end]) / 2, top.y[1]), regions.names[i], (0, -30))
    for one in old["pv"]:
        top.curve(*thinned(x[:n], one, DENSE), Stroke(BEFORE, 8), "pv with fixed gains")
    for one in old["co"]:
        bottom.curve(*thinned(x[:n], one, DENSE), Stroke(BEFORE, 5))
    top.curve(*thinned(x, run["pv"], DENSE), Stroke(AFTER, 9), "pv retuned")
    top.curve(*thinned(x, run["sp"], DENSE), Stroke(SETPOINT, 9, DASHES), "sp")
    bottom.curve(*thinned(x, run["co"], DENSE), Stroke(AFTER, 7))
    further = [Panel(places[2], over, room(second, SHARE))] if second else []
    for panel in further:
        panel.curve(*thinned(x, second[0], DENSE), Stroke(AFTER, 5))
    panels = [top, bottom, *further]
    _marks(panels, marks, float(run["t"][0]), (run["t"][-1] - run["t"][0]) / max(float(x[-1]), 1e-12))
    names = [f"pv, sp [{unit}]", "co [%]", *(f"{axis.label} [{axis.unit}]" for axis in regions.axes[1:])]
    below = [*[""] * (len(panels) - 1), f"time [{x_unit}]"]
    drawn = [
        panel.drawn(f"trend-{i}", *labels, up=ABOVE)
        for i, (panel, *labels) in enumerate(zip(panels, below, names, strict=False))
    ]
    return page_of(drawn, size, "Trend with the regions")


def _marks(panels: Sequence[Panel], marks: Sequence[Mark], start_s: float, scale: float) -> None:
    labelled: set[bool] = set()
    for mark in marks:
        at = (mark.t_s - start_s) / scale
        dash, name = ("11 18", "change rolled back") if mark.rolled_back else ("", "gains changed")
        for panel in panels:
            panel.curve((at, at), panel.y, Stroke(MARK, 11, dash), "" if mark.rolled_back in labelled else name)
            labelled.add(mark.rolled_back)
        if mark.number:
            panels[0].note((at, panels[0].y[0]), f"{mark.number}", (30, -40), MARK)


def twin_svg(run: Columns, fixed: Columns | None, twin: Twin, name: str, unit: str, *, commissioned: bool) -> str:
    """One setpoint step with the commissioned gains and with the final ones, on one time axis.

    fixed : the same run with the commissioned gains, where there is one: then the same step of it is drawn; else the
    first such step of this run, and commissioned says whether it still ran on those gains.
    """
    length = min(twin.first[1] - twin.first[0], twin.last[1] - twin.last[0])
    first = "first time, with the baseline gains" if commissioned else "first time, already retuned"
    before = (run, twin.first[0], first)
    if fixed is not None and len(fixed["t"]) >= twin.last[1]:
        before = (fixed, twin.last[0], "with the baseline gains")
    drawn = []
    for columns, start, label in (before, (run, twin.last[0], "with the final gains")):
        part = slice(start - min(start, length // 20), start + length)
        drawn.append(
            ({one: columns[one][part] for one in ("pv", "co", "sp")}, columns["t"][part] - columns["t"][start], label)
        )
    (old, old_t, _), (new, new_t, _) = drawn
    size, places = stacked(TWIN_HEIGHTS, TWIN, TWIN_ROOM)
    over = (float(min(old_t[0], new_t[0])), float(max(old_t[-1], new_t[-1])))
    floor = axis_floors(new["pv"])
    top = Panel(places[0], over, room([old["pv"], new["pv"], new["sp"]], SHARE, floor=floor[0]))
    bottom = Panel(places[1], over, room([old["co"], new["co"]], SHARE, floor=floor[1]))
    for (columns, t, label), colour in zip(drawn, (BEFORE, AFTER), strict=True):
        top.curve(t, columns["pv"], Stroke(colour, 14), label)
        bottom.curve(t, columns["co"], Stroke(colour, 9))
    top.curve(new_t, new["sp"], Stroke(SETPOINT, 9, DASHES), "sp")
    head, ident = f"{name}: {twin.text} {unit}", f"twin-{twin.region}"
    panels = [
        top.drawn(f"{ident}-pv", "", f"pv [{unit}]", title=head, columns=3),
        bottom.drawn(f"{ident}-co", "seconds after the step", "co [%]"),
    ]
    return page_of(panels, size, f"{name}: with the baseline gains and with the final ones")
