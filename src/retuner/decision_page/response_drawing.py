"""The response that led to a decision: pv and sp with the peaks E1, E2, E3, the model over it, what is left, co."""

import numpy as np

from retuner.adaptive.signals.sample import FloatArray
from retuner.decision_page.decision_view import DecisionView, Samples
from retuner.decision_page.drawing_style import AFTER, FAINT, LIMIT, MODEL, SETPOINT, steps, thinned
from retuner.decision_page.panel import Panel, Place, Range, Stroke, page_of, room, stacked
from retuner.decision_page.row_values import number, numbers

FAR_SETPOINT_RANGES = 3.0  # A setpoint farther from pv than this many ranges of pv would leave no room for the curves
NOISE_STDS = 2.0  # half width of the band in which 95 % of what noise leaves lies
WIDTH, ROOM = 8208, (288, 120, 346, 616)  # of the drawing, and around its panels: above, right, below, left
SIGNALS, REMAINDER, OUTPUT = 1780, 610, 690  # heights of the panels
SHARE, PEAK_SHARE = 0.05, 0.12  # room above and below the curves, and where the peaks' names need some
BAND, LINE = Stroke(FAINT, 0, opacity=0.25), Stroke(AFTER, 10)


def response_svg(view: DecisionView) -> str:
    """The drawing, empty where the samples were not kept."""
    samples = view.samples
    if samples is None:
        return ""
    # All panels on one time axis that begins with the response
    start = number(view.response, "t_start_s")
    zero = samples.t_s[0] if start is None else start
    since = "time" if start is None else "time since the response began"
    scale, name = time_unit(float(samples.t_s[-1] - samples.t_s[0]))
    x = (samples.t_s - zero) / scale
    heights = (SIGNALS, OUTPUT) if samples.explained is None else (SIGNALS, REMAINDER, OUTPUT)
    size, places = stacked(heights, WIDTH, ROOM)
    over = (float(x[0]), float(x[-1]))
    top = _signals(places[0], over, view, samples, x)
    for i, peak in enumerate(view.peaks, 1):
        sp = float(samples.sp[min(int(np.searchsorted(samples.t_s, peak.t_s)), len(samples.sp) - 1)])
        at = (peak.t_s - zero) / scale
        top.curve([at, at], [sp, sp - peak.e], Stroke(SETPOINT, 9))
        top.note((at, sp - peak.e), f"E{i} = {peak.e:.3g}", (60, 160 if peak.e > 0 else -90), SETPOINT, dot=True)
    if samples.explained is None:
        remainder = []
    else:
        left, noise = samples.pv - samples.explained, number(view.estimate, "noise") or 0.0
        panel = Panel(places[1], over, room([left, [0.0, NOISE_STDS * noise, -NOISE_STDS * noise]], SHARE))
        if noise:
            panel.band(over, [-NOISE_STDS * noise] * 2, [NOISE_STDS * noise] * 2, BAND)
        panel.curve(over, (0.0, 0.0), Stroke(FAINT, 8))
        panel.curve(*thinned(x, left), LINE)
        remainder = [panel]
    output = Panel(places[-1], over, room([samples.co], SHARE))
    output.curve(*thinned(*steps(x, samples.co)), LINE)
    panels = [top, *remainder, output]
    for times, dash, label in (
        (numbers(view.estimate, "loads"), "80 20 13 20", "load step as the fit places it"),
        (samples.changed_s, "13 21", "other gains run"),
    ):
        for i, t_s in enumerate(times):
            for panel in panels:
                at = (t_s - zero) / scale
                panel.curve([at, at], panel.y, Stroke(LIMIT, 13, dash), label * (panel is top and not i))
    names = [f"pv, sp [{view.unit}]", *[f"pv - model\n[{view.unit}]"] * len(remainder), "co [%]"]
    below = [*[""] * (len(panels) - 1), f"{since} [{name}]"]
    drawn = [
        panel.drawn(f"response-{view.number}-{i}", *labels)
        for i, (panel, *labels) in enumerate(zip(panels, below, names, strict=True))
    ]
    return page_of(drawn, size, "The response with its peaks, the model over it, the residual, controller output")


def time_unit(span_s: float) -> tuple[float, str]:
    """Seconds in the unit that suits a length of time, and its name."""
    for seconds, name in ((3600.0, "h"), (60.0, "min")):
        if span_s > 10 * seconds:
            return seconds, name
    return 1.0, "s"


def _signals(place: Place, over: Range, view: DecisionView, samples: Samples, x: FloatArray) -> Panel:
    band = number(view.response, "band") or 0.0
    near = abs(float(np.median(samples.sp - samples.pv))) < FAR_SETPOINT_RANGES * float(np.ptp(samples.pv))
    with_setpoint = near or np.ptp(samples.sp) > 0
    edges = [samples.sp - band, samples.sp + band] if with_setpoint else []
    explained = [] if samples.explained is None else [samples.explained]
    panel = Panel(place, over, room([samples.pv, *edges, *explained], PEAK_SHARE))
    if with_setpoint:
        if band:
            at, low = thinned(*steps(x, samples.sp - band))
            panel.band(at, low, low + 2 * band, BAND, "noise band")
        panel.curve(*thinned(*steps(x, samples.sp)), Stroke(SETPOINT, 10, "37 16"), "sp")
    panel.curve(*thinned(x, samples.pv), Stroke(AFTER, 13), "pv")
    for one in explained:
        panel.curve(*thinned(x, one), Stroke(MODEL, 15, "60 30"), "pv as the model has it")
    return panel
