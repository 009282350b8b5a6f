"""How robust a loop is and how it answers, before and after: Nyquist curves with the Ms circle, step responses.

    |1 + L(jw)| >= 1/Ms for every w

so the curve stays outside the circle of radius 1/Ms round -1 (Astrom & Hagglund 2006, section 4.6). Faint curves: the
other models that the records still allow, with the new gains.
"""

import math

import numpy as np

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.open_loop import grid, open_loop
from retuner.adaptive.loop.simulate import StepResponse, step_response
from retuner.adaptive.process.model import ComplexArray, LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.decision_page.decision_sentences import new_name, old_name
from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.drawing_style import AFTER, BEFORE, FAINT, LIMIT, SETPOINT, thinned
from retuner.decision_page.panel import Panel, Stroke, page_of, room
from retuner.decision_page.response_drawing import time_unit
from retuner.schedule.gains import PidGains

REAL, IMAGINARY = (-2.3, 0.7), (-1.75, 0.75)  # the part of the plane that is drawn: round -1
FAR_OUT = 4.0  # points of a curve farther out than this are left out
MOST_MODELS = 24  # other models whose curves are drawn; the first are the most likely ones
MOST_RESPONSES = 8  # other models whose step responses make the spread
SHOWN = 2.0  # largest setpoint response that the axes make room for; an unstable one leaves the picture
SIZE, PLANE = (8208, 2952), (458, 443, 2508, 2090)  # of the drawing, and where Nyquist's curves are in it
RESPONSES = (3640, 6090)  # where the panels of the step responses begin
PV, CO = (443, 1210), (1790, 710)  # tops and heights of their panels
WIDTH, SHARE = 1990, 0.08  # of these panels; room above and below the curves
DASHED, WHOLE, PLUS = "64 32", "", 0.06  # half length of the cross at -1


def robustness_svg(view: DecisionView, ms_limit: float) -> str:
    """The drawing, empty without a model or gains.

    ms_limit : radius of the circle is its inverse.
    """
    if view.process is None or view.before is None:
        return ""
    drawn = [_nyquist(view, view.process, view.before, ms_limit)]
    for left, load in zip(RESPONSES, (False, True), strict=True):
        drawn += _responses(left, view, view.process, view.before, load=load)
    alt = "Nyquist curves before and after with the Ms circle; predicted setpoint and load responses"
    return page_of(drawn, SIZE, alt)


def _responses(left: int, view: DecisionView, process: LinearProcess, before: PidGains, *, load: bool) -> list[str]:
    """Predicted responses of pv and co to one step, before and after, with the spread over the other models."""
    gains = view.tried or before
    # Time in which the loop answers both steps: a few integral times and dead times
    tau_i = gains.kp / gains.ki if gains.ki and gains.kp else 0.0
    until = 3 * tau_i + 8 * process.theta_s or 5 * sum(process.lags_s) or 1.0
    scale, time = time_unit(until)
    looks = ((old_name(view), before, Stroke(BEFORE, 15, DASHED)), (new_name(view), view.tried, Stroke(AFTER, 15)))
    found = [
        (name, one, _from_zero(step_response(process, one, until, load=load), until), look)
        for name, one, look in looks
        if one is not None
    ]
    reach = [to for _, one, to, _ in found if one is gains or math.isfinite(sensitivity_peak(process, one))]
    over, within = (0.0, until / scale), (-math.inf, math.inf) if load else (1 - SHOWN, SHOWN + 0.2)
    top = Panel((left, PV[0], WIDTH, PV[1]), over, room([one.pv for one in reach], SHARE, *within))
    bottom = Panel((left, CO[0], WIDTH, CO[1]), over, room([one.co for one in reach], SHARE))
    if view.tried:
        t = np.linspace(0, until, 200)
        others = [
            np.interp(t, one.t, one.pv, left=0.0)
            for one in (step_response(model, view.tried, until, load=load) for model in view.allowed[:MOST_RESPONSES])
        ]
        if others:
            look = Stroke(AFTER, 0, opacity=0.2)
            top.band(t / scale, np.min(others, axis=0), np.max(others, axis=0), look, "other models")
    for name, _, to, look in found:
        for panel, values, label in ((top, to.pv, name), (bottom, to.co, "")):
            panel.curve(*thinned(to.t / scale, values, 300), look, label)
    if not load:
        top.curve(over, (1.0, 1.0), Stroke(SETPOINT, 8, "30 13"))
    title = f"predicted: {'load step of 1 % co' if load else f'setpoint step of 1 {view.unit}'}"
    ident = f"{'load' if load else 'setpoint'}-{view.number}"
    return [
        top.drawn(f"{ident}-pv", "", f"pv [{view.unit}]", title=title, columns=3),
        bottom.drawn(f"{ident}-co", f"time [{time}]", "co [%]"),
    ]


def _nyquist(view: DecisionView, process: LinearProcess, before: PidGains, ms_limit: float) -> str:
    panel = Panel(PLANE, REAL, IMAGINARY)
    turn = np.exp(2j * np.pi * np.linspace(0, 1, 181))
    around = turn / ms_limit - 1
    panel.curve(around.real, around.imag, Stroke(LIMIT, 0, opacity=0.22))
    panel.curve(around.real, around.imag, Stroke(LIMIT, 13), f"Ms = {ms_limit:.3g}")
    panel.curve(turn.real, turn.imag, Stroke(FAINT, 8, "8 13"))
    for across, up in ((PLUS, 0.0), (0.0, PLUS)):
        panel.curve([-1 - across, -1 + across], [-up, up], Stroke(SETPOINT, 14))
    tried, name = view.tried, new_name(view)
    others = view.allowed[:MOST_MODELS] if tried else ()
    for i, model in enumerate(others):
        assert tried is not None
        label = f"{name}, {len(others)} other plausible model{'s' * (len(others) != 1)}" if not i else ""
        panel.curve(*_curve(model, tried), Stroke(AFTER, 6, opacity=0.45), label)
    panel.curve(*_curve(process, before), Stroke(BEFORE, 16, DASHED), f"{old_name(view)}: {_ms(process, before)}")
    if tried:
        panel.curve(*_curve(process, tried), Stroke(AFTER, 18), f"{name}: {_ms(process, tried)}")
    return panel.drawn(f"plane-{view.number}", "real part of L(jw)", "imaginary part", columns=2)


def _ms(process: LinearProcess, gains: PidGains) -> str:
    ms = sensitivity_peak(process, gains)
    return f"Ms {ms:.2f}" if math.isfinite(ms) else "UNSTABLE"


def _curve(process: LinearProcess, gains: PidGains) -> tuple[FloatArray, FloatArray]:
    """L(jw) near the origin, NaN where it is far out so that no line is drawn across."""
    loop = open_loop(process, gains)
    value: ComplexArray = loop.along(grid(loop))
    value = value[np.convolve(np.abs(value) < FAR_OUT, np.ones(3), "same") > 0]
    return value.real, value.imag


def _from_zero(found: StepResponse, until_s: float) -> StepResponse:
    """The response from the step on (a load's is known from a dead time later on) until then."""
    inside = found.t <= until_s
    t, pv, co = found.t[inside], found.pv[inside], found.co[inside]
    if t[0] > 0:
        t, pv, co = (np.concatenate([[0.0, first], rest]) for first, rest in ((t[0], t), (0.0, pv), (0.0, co)))
    return StepResponse(t, pv, co)
