"""The response that led to a decision: pv and sp with the peaks E1, E2, E3, the model over it, what is left, co."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from retuner.adaptive.signals.sample import FloatArray
from retuner.decision_page.decision_view import DecisionView, Samples
from retuner.decision_page.row_values import number, numbers
from retuner.decision_page.svg import AFTER, FAINT, LIMIT, MODEL, SETPOINT, settings, steps, svg, thinned

FAR_SETPOINT_RANGES = 3.0  # A setpoint farther from pv than this many ranges of pv would leave no room for the curves
NOISE_STDS = 2.0  # half width of the band in which 95 % of what noise leaves lies
LABEL_SHIFT = 9  # distance of a peak's name from it, in points


def response_svg(view: DecisionView) -> str:
    """The drawing, empty where the samples were not kept."""
    if view.samples is None:
        return ""
    modelled = view.samples.explained is not None
    with settings(f"response {view.number}"):
        height = 5.6 if modelled else 4.7
        figure = Figure(figsize=(11.4, height))
        heights = (2.6, 0.9, 1.0) if modelled else (2.6, 1.0)
        panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
        figure.subplots_adjust(left=0.075, right=0.985, top=1 - 0.4 / height, bottom=0.48 / height, hspace=0.13)
        # All panels on one time axis that begins with the response
        start = number(view.response, "t_start_s")
        zero = view.samples.t_s[0] if start is None else start
        since = "time" if start is None else "time since the response began"
        scale, name = time_unit(float(view.samples.t_s[-1] - view.samples.t_s[0]))
        x = (view.samples.t_s - zero) / scale
        _signals(panels[0], view, view.samples, x)
        _peaks(panels[0], view, view.samples, zero, scale)
        if view.samples.explained is not None:
            _remainder(panels[1], view, view.samples, x)
        panels[-1].plot(*thinned(*steps(x, view.samples.co)), color=AFTER, lw=1.0)
        panels[-1].set_ylabel("co [%]")
        panels[-1].set_xlabel(f"{since} [{name}]")
        marks = (
            (numbers(view.estimate, "loads"), "-.", "load step as the fit places it"),
            (view.samples.changed_s, ":", "other gains run"),
        )
        for times, style, label in marks:
            for i, t_s in enumerate(times):
                for axes in panels:
                    axes.axvline((t_s - zero) / scale, color=LIMIT, lw=1.3, ls=style, label=None if i else label)
        panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.985), ncols=6, borderaxespad=0.2)
        panels[0].figure.align_ylabels(panels)
        return svg(figure, "The response with its peaks, the model over it, the residual, controller output")


def time_unit(span_s: float) -> tuple[float, str]:
    """Seconds in the unit that suits a length of time, and its name."""
    for seconds, name in ((3600.0, "h"), (60.0, "min")):
        if span_s > 10 * seconds:
            return seconds, name
    return 1.0, "s"


def _signals(axes: Axes, view: DecisionView, samples: Samples, x: FloatArray) -> None:
    """pv, setpoint with the band in which the error counted as zero, and the model's pv."""
    band = number(view.response, "band")
    near = abs(float(np.median(samples.sp - samples.pv))) < FAR_SETPOINT_RANGES * float(np.ptp(samples.pv))
    if near or np.ptp(samples.sp) > 0:
        if band:
            at, low = thinned(*steps(x, samples.sp - band))
            axes.fill_between(at, low, low + 2 * band, color=FAINT, alpha=0.25, lw=0, label="noise band")
        axes.plot(*thinned(*steps(x, samples.sp)), color=SETPOINT, lw=1.0, ls="--", label="sp")
    axes.plot(*thinned(x, samples.pv), color=AFTER, lw=1.3, label="pv")
    if samples.explained is not None:
        axes.plot(*thinned(x, samples.explained), color=MODEL, lw=1.5, ls=(0, (4, 2)), label="pv as the model has it")
    axes.set_ylabel(f"pv, sp [{view.unit}]")
    low_y, high_y = axes.get_ylim()
    axes.set_ylim(low_y - 0.06 * (high_y - low_y), high_y + 0.06 * (high_y - low_y))


def _peaks(axes: Axes, view: DecisionView, samples: Samples, zero: float, scale: float) -> None:
    """E1, E2, E3: the error at each as a line from the setpoint to pv."""
    for i, peak in enumerate(view.peaks, 1):
        sp = float(samples.sp[min(int(np.searchsorted(samples.t_s, peak.t_s)), len(samples.sp) - 1)])
        at = (peak.t_s - zero) / scale
        axes.plot([at, at], [sp, sp - peak.e], color=SETPOINT, lw=0.9)
        axes.plot([at], [sp - peak.e], "o", color=SETPOINT, ms=4.5)
        below = peak.e > 0
        axes.annotate(
            f"E{i} = {peak.e:.3g}",
            (at, sp - peak.e),
            (6, -LABEL_SHIFT if below else LABEL_SHIFT),
            textcoords="offset points",
            va="top" if below else "bottom",
            fontsize=9,
        )


def _remainder(axes: Axes, view: DecisionView, samples: Samples, x: FloatArray) -> None:
    """What the model leaves of pv, in the band of the noise."""
    assert samples.explained is not None
    noise = number(view.estimate, "noise")
    if noise:
        axes.axhspan(-NOISE_STDS * noise, NOISE_STDS * noise, color=FAINT, alpha=0.25, lw=0)
    axes.axhline(0, color=FAINT, lw=0.8)
    axes.plot(*thinned(x, samples.pv - samples.explained), color=AFTER, lw=0.9)
    axes.set_ylabel(f"pv - model\n[{view.unit}]")
