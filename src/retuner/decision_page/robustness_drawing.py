"""How robust a loop is and how it answers, before and after: Nyquist curves with the Ms circle, step responses.

    |1 + L(jw)| >= 1/Ms for every w

so the curve stays outside the circle of radius 1/Ms round -1 (Astrom & Hagglund 2006, section 4.6). Faint curves: the
other models that the records still allow, with the new gains.
"""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.open_loop import grid, open_loop
from retuner.adaptive.loop.simulate import StepResponse, step_response
from retuner.adaptive.process.model import ComplexArray, LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.decision_page.decision_sentences import new_name, old_name
from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.response_drawing import time_unit
from retuner.decision_page.svg import AFTER, BEFORE, FAINT, LIMIT, SETPOINT, settings, svg, thinned
from retuner.schedule.gains import PidGains

REAL, IMAGINARY = (-2.3, 0.7), (-1.75, 0.75)  # the part of the plane that is drawn: round -1
FAR_OUT = 4.0  # points of a curve farther out than this are left out
MOST_MODELS = 24  # other models whose curves are drawn; the first are the most likely ones
MOST_RESPONSES = 8  # other models whose step responses make the spread
SHOWN = 2.0  # largest setpoint response that the axes make room for; an unstable one leaves the picture


def robustness_svg(view: DecisionView, ms_limit: float) -> str:
    """The drawing, empty without a model or gains.

    ms_limit : radius of the circle is its inverse.
    """
    if view.process is None or view.before is None:
        return ""
    with settings(f"robustness {view.number}"):
        figure = Figure(figsize=(11.4, 4.1))
        places = figure.add_gridspec(
            2,
            3,
            width_ratios=(1.35, 1, 1),
            height_ratios=(1.7, 1),
            wspace=0.27,
            hspace=0.14,
            left=0.055,
            right=0.985,
            top=0.85,
            bottom=0.12,
        )
        _nyquist(figure.add_subplot(places[:, 0]), view, view.process, view.before, ms_limit)
        for column, load in ((1, False), (2, True)):
            top = figure.add_subplot(places[0, column])
            bottom = figure.add_subplot(places[1, column], sharex=top)
            top.tick_params(labelbottom=False)
            # Predicted responses to one step, before and after, with the spread over the other models
            gains = view.tried or view.before
            assert gains is not None
            # Time in which the loop answers both steps: a few integral times and dead times
            tau_i = gains.kp / gains.ki if gains.ki and gains.kp else 0.0
            lags = sum(view.process.lags_s)
            until = 3 * tau_i + 8 * view.process.theta_s or 5 * lags or 1.0
            scale, unit = time_unit(until)
            if view.tried:
                _spread(top, view.allowed[:MOST_RESPONSES], view.tried, until, scale, load=load)
            looks = ((old_name(view), view.before, BEFORE, (0, (4, 2))), (new_name(view), view.tried, AFTER, "-"))
            reach = []
            for label, one, colour, style in looks:
                if one is None:
                    continue
                found = _from_zero(step_response(view.process, one, until, load=load), until)
                for axes, values in ((top, found.pv), (bottom, found.co)):
                    axes.plot(*thinned(found.t / scale, values, 300), color=colour, ls=style, lw=1.5, label=label)
                if one is gains or math.isfinite(sensitivity_peak(view.process, one)):
                    reach.append(found)
            top.set_xlim(0, until / scale)
            _frame(top, bottom, reach, view.unit, unit, load=load)
        return svg(figure, "Nyquist curves before and after with the Ms circle; predicted setpoint and load responses")


def _nyquist(axes: Axes, view: DecisionView, process: LinearProcess, before: PidGains, ms_limit: float) -> None:
    """L(jw) round -1."""
    axes.set_aspect("equal", adjustable="box")
    axes.add_patch(Circle((-1, 0), 1 / ms_limit, facecolor=LIMIT, alpha=0.22, lw=0))
    axes.add_patch(Circle((-1, 0), 1 / ms_limit, fill=False, edgecolor=LIMIT, lw=1.3, label=f"Ms = {ms_limit:.3g}"))
    axes.add_patch(Circle((0, 0), 1, fill=False, edgecolor=FAINT, lw=0.8, ls=":"))
    axes.plot([-1], [0], "+", color=SETPOINT, ms=9, mew=1.4)
    tried, name = view.tried, new_name(view)
    others = view.allowed[:MOST_MODELS] if tried else ()
    for i, model in enumerate(others):
        assert tried is not None
        label = f"{name}, {len(others)} other plausible model{'s' * (len(others) != 1)}" if not i else None
        axes.plot(*_curve(model, tried), color=AFTER, lw=0.6, alpha=0.45, label=label)
    axes.plot(
        *_curve(process, before),
        color=BEFORE,
        lw=1.6,
        ls=(0, (4, 2)),
        label=f"{old_name(view)}: {_ms(process, before)}",
    )
    if tried:
        axes.plot(*_curve(process, tried), color=AFTER, lw=1.8, label=f"{name}: {_ms(process, tried)}")
    axes.set_xlim(*REAL)
    axes.set_ylim(*IMAGINARY)
    axes.set_xlabel("real part of L(jw)")
    axes.set_ylabel("imaginary part")
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, borderaxespad=0.1, handlelength=1.8, columnspacing=1.0
    )


def _ms(process: LinearProcess, gains: PidGains) -> str:
    """Ms, or that the loop is unstable."""
    ms = sensitivity_peak(process, gains)
    return f"Ms {ms:.2f}" if math.isfinite(ms) else "UNSTABLE"


def _curve(process: LinearProcess, gains: PidGains) -> tuple[FloatArray, FloatArray]:
    """L(jw) near the origin, NaN where it is far out so that no line is drawn across."""
    loop = open_loop(process, gains)
    value: ComplexArray = loop.along(grid(loop))
    near = np.abs(value) < FAR_OUT
    value = value[np.convolve(near, np.ones(3), "same") > 0]
    return value.real, value.imag


def _from_zero(found: StepResponse, until_s: float) -> StepResponse:
    """The response from the step on (a load's is known from a dead time later on) until then."""
    inside = found.t <= until_s
    t, pv, co = found.t[inside], found.pv[inside], found.co[inside]
    if t[0] > 0:
        t, pv, co = (np.concatenate([[0.0, first], rest]) for first, rest in ((t[0], t), (0.0, pv), (0.0, co)))
    return StepResponse(t, pv, co)


def _spread(
    axes: Axes, models: tuple[LinearProcess, ...], gains: PidGains, until_s: float, scale: float, *, load: bool
) -> None:
    """The band between the lowest and the highest response of the other models."""
    t = np.linspace(0, until_s, 200)
    found = [
        np.interp(t, one.t, one.pv, left=0.0)
        for one in (step_response(model, gains, until_s, load=load) for model in models)
    ]
    if found:
        low, high = np.min(found, axis=0), np.max(found, axis=0)
        axes.fill_between(t / scale, low, high, color=AFTER, alpha=0.2, lw=0, label="other models")


def _frame(top: Axes, bottom: Axes, reach: list[StepResponse], unit: str, time: str, *, load: bool) -> None:
    """Titles, units, and axes that an unstable response does not blow up; reach : what they must show."""
    top.set_title(f"predicted: {'load step of 1 % co' if load else f'setpoint step of 1 {unit}'}", loc="left", pad=20)
    _limit(top, [one.pv for one in reach], *((-math.inf, math.inf) if load else (1 - SHOWN, SHOWN + 0.2)))
    _limit(bottom, [one.co for one in reach], -math.inf, math.inf)
    if not load:
        top.axhline(1, color=SETPOINT, lw=0.8, ls="--")
    top.set_ylabel(f"pv [{unit}]")
    bottom.set_ylabel("co [%]")
    bottom.set_xlabel(f"time [{time}]")
    top.legend(
        loc="lower left", bbox_to_anchor=(-0.02, 0.98), ncols=3, borderaxespad=0.1, handlelength=1.6, columnspacing=0.9
    )


def _limit(axes: Axes, curves: list[FloatArray], lowest: float, highest: float) -> None:
    """Room for these curves, between those limits."""
    low = max(min(float(np.min(one)) for one in curves), lowest)
    high = min(max(float(np.max(one)) for one in curves), highest)
    room = 0.08 * (high - low) or 0.1
    axes.set_ylim(low - room, high + room)
