"""A decision in one readable line: what was seen, the cause, what the process is, what changes."""

import math

from retuner.adaptive.decision import Action, Decision
from retuner.schedule.forms import in_form
from retuner.schedule.gains import PidGains

WHOLE_STEP = 0.999
"""A step of at least this share is the whole one to a reader."""


def settings_text(gains: PidGains) -> str:
    """Gains as people write them: series form where it exists, else ideal, else the integral gain alone."""
    if gains.kp == 0:
        return f"Ki {gains.ki:.3g}/s (integral only)"
    form = "series"
    try:
        shown = in_form(gains, form)
    except ValueError:
        form = "ideal"
        shown = in_form(gains, form)
    text = f"Kc {shown['kc']:.3g}"
    if shown["tau_i"] is not None:
        text += f" tau_I {shown['tau_i']:.3g} s"
    if shown["tau_d"]:
        text += f" tau_D {shown['tau_d']:.3g} s ({form})"
    return text


def short_settings(gains: PidGains) -> str:
    """Gains for a narrow table: the numbers of settings_text without their names."""
    return settings_text(gains).replace("Kc ", "").replace(" tau_I ", ", ").replace(" tau_D ", ", ").replace(" s", "")


def response_text(decision: Decision) -> str:
    """What was recognised."""
    r = decision.response
    if r is None:
        return ""
    text = f"{'setpoint' if r.sp_changed else 'load'} response"
    if r.overshoot is not None:
        text += f", overshoot {r.overshoot:.0%}"
    if r.damping is not None:
        text += f", damping {r.damping:.2f}"
    if r.period_s is not None:
        text += f", period {r.period_s:.3g} s"
    return text


def model_text(decision: Decision) -> str:
    """What the process is, and how many records say so."""
    if decision.estimate is None:
        return ""
    m = decision.estimate.log.model()
    records = f"{decision.records} record{'s' if decision.records != 1 else ''}" if decision.records else "not enough"
    return f"k {m.k:.3g} tau {m.tau1_s:.3g} s theta {m.theta_s:.3g} s ({records})"


def cause_text(decision: Decision) -> str:
    """The cause, or that there was none to name."""
    return str(decision.diagnosis.cause).replace("_", " ") if decision.diagnosis else "undecided"


def change_text(decision: Decision) -> str:
    """What changes, from what to what, with Ms."""
    v = decision.verdict
    if decision.action == Action.NONE or v is None or v.gains is None:
        return "no change"
    verb = "write" if decision.action == Action.COMMIT else "advise"
    before, after = (f"{ms:.2f}" if math.isfinite(ms) else "unstable" for ms in (v.ms_before, v.ms_nominal))
    step = "" if v.step > WHOLE_STEP else f", {v.step:.0%} of the step"
    worst = "unstable at worst" if math.isinf(v.ms_worst) else f"at worst {v.ms_worst:.2f}"
    return (f"{verb} {settings_text(decision.gains_before)} -> {settings_text(v.gains)}, "
            f"Ms {before} -> {after} ({worst}{step})")  # fmt: skip


def one_line(decision: Decision) -> str:
    """The decision in one line."""
    parts = [
        response_text(decision),
        f"{cause_text(decision)}: {decision.reason}",
        model_text(decision),
        change_text(decision),
    ]
    return " | ".join(part for part in parts if part)
