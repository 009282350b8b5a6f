"""SIMC under the names and wishes of the registry: plain, improved, smooth, and Haugen's faster integral time.

simc takes tau_c, or a demanded Ms or GM from which tau_c follows, and c. simc-smooth takes u0 and ymax. haugen is SIMC
with c = 1.44 (Haugen, appendix A), haugen-2010 with c = 2 (as quoted by Grimholt & Skogestad 2012); Haugen converts the
settings to the ideal form ("parallel" in his words), which --form ideal does.

The closed-loop time constant tau_c of a SIMC rule from what is wanted of the loop.

    smooth   Kc = Kc,min = |u0| / |y_max|: the slowest control that still holds y within y_max against the largest
             disturbance u0 (Skogestad 2003 and 2006); tau_c follows from Kc, and tau_I from tau_c by the same rule
    Ms, GM   the smallest tau_c >= 0 whose loop keeps the demanded sensitivity peak or gain margin

For tau_I = tau1 the gain margin is known: GM = (pi/2) (tau_c/theta + 1) (Grimholt & Skogestad 2012, equation 7), so GM
and tau_c say the same thing. In general both are found on the exact loop by bisection in log(tau_c + theta).
"""

import math
from collections.abc import Callable
from dataclasses import replace

from retuner.adaptive.loop.margins import gain_margin, sensitivity_peak
from retuner.adaptive.process.model import ZERO_SIDE, LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.rules import simc as table
from retuner.adaptive.rules.rule import ControllerKind, Rule, Tuning, Wishes, tuning
from retuner.adaptive.rules.simc import TAU_I_FACTOR, derivative_pays, simc, without_second_lag
from retuner.schedule.gains import PidGains

BISECTIONS = 45  # halvings of the range of ln tau_c: to 1e-12
SLOWEST = 1e4  # largest tau_c tried, in units of the process' own slowest time; beyond it the loop does nothing

TauCRule = Callable[[float | None], Tuning]  # SIMC settings at a given tau_c in seconds; None for its own choice


def _smallest(rule: TauCRule, process: LinearProcess, keeps: Callable[[PidGains], bool], what: str) -> Tuning:
    """Bisection on log(tau_c) between values that do not keep the demand and ones that do."""
    times = [process.theta_s, *process.lags_s, *(abs(x) for x in process.leads_s)]
    times += [math.sqrt(c2) for _, c2 in process.quadratics]
    unit = max(times, default=0.0) or 1.0
    low, high = math.log(min((x for x in times if x > 0), default=1.0) / SLOWEST), math.log(unit * SLOWEST)
    if keeps(rule(math.exp(low)).gains):
        raise ValueError(f"{what} is kept at any tau_c, however small; give tau_c")
    if not keeps(rule(math.exp(high)).gains):
        raise ValueError(f"{what} is not reached by any tau_c up to {math.exp(high):.3g} s; ask for less")
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (low, middle) if keeps(rule(math.exp(middle)).gains) else (middle, high)
    return rule(math.exp(high))


def tau_c_smooth(model: ProcessModel, u0: float, y_max: float) -> float:
    """tau_c in seconds of the slowest acceptable controller, Kc = |u0| / |y_max|.

    model : the model that the settings are made from (for PI with the second lag taken up by the half rule).
    u0 : largest disturbance, in co units at the process input. y_max : largest deviation allowed, in pv units.

    Raises ValueError: u0 or y_max is 0 or not finite, the process is a pure delay (SIMC has no Kc there), or Kc,min is
    more than the process allows (tau_c would be negative).
    """
    for name, value in (("u0", u0), ("ymax", y_max)):
        if value == 0 or not math.isfinite(value):
            raise ValueError(f"{name} = {value} must be a finite number other than 0")
    if model.type == ProcessType.DELAY:
        raise ValueError("SIMC has no proportional gain on a pure delay, so smooth tuning has no answer; give tau_c")
    kc_min = abs(u0) / abs(y_max)
    span = 1 / (abs(model.slope) * kc_min)
    if model.type == ProcessType.DOUBLE_INTEGRATING:
        span = math.sqrt(span) / 2
    if span <= model.theta_s:
        raise ValueError(
            f"Kc,min = |u0|/|ymax| = {kc_min:.4g} needs tau_c = {span - model.theta_s:.4g} s: this process cannot be"
            " held within ymax; allow more or reduce the dead time"
        )
    return span - model.theta_s


# Improved SIMC PI: tau1 is replaced by tau1 + theta/3 (Grimholt & Skogestad 2012, equations 10 and 11).
#
#     Kc = (tau1 + theta/3) / (k (tau_c + theta))    tau_I = min(tau1 + theta/3, 4 (tau_c + theta))
#
# Series form (PI: the same as ideal). The gain is in the most on a pure delay, where plain SIMC has no proportional
# action; on an integrating process nothing changes.


THETA_SHARE = 1 / 3
"""Share of the dead time that joins tau1 (the paper's choice for a pure delay, where it is nearly optimal)."""


def simc_improved(model: ProcessModel, tau_c_s: float | None = None, c: float = TAU_I_FACTOR) -> Tuning:
    """Improved SIMC PI settings; tau_c_s and c as for simc.

    Raises ValueError: tau_c is missing for a process without dead time, or not positive together with the dead time;
    the process has two integrators, which PI cannot hold.
    """
    model = without_second_lag(model)
    if model.type == ProcessType.DOUBLE_INTEGRATING:
        raise ValueError("a double integrating process needs derivative action; use rule simc")
    if tau_c_s is None:
        if model.theta_s == 0:
            raise ValueError("theta = 0: SIMC's default tau_c = theta does not exist; give tau_c (--tau-c)")
        tau_c_s = model.theta_s
    span = tau_c_s + model.theta_s
    if not 0 < span < math.inf or not 0 < c < math.inf:
        raise ValueError(f"tau_c + theta = {span} s and c = {c} must be positive and finite")
    if model.type == ProcessType.INTEGRATING:
        return tuning("simc-improved", "series", 1 / (model.k * span), c * span, 0.0, tau_c_s)
    lag = model.tau1_s + THETA_SHARE * model.theta_s
    if lag == 0:
        raise ValueError("tau1 and theta are both 0: there is no time to tune for; use rule simc")
    return tuning("simc-improved", "series", lag / (model.k * span), min(lag, c * span), 0.0, tau_c_s)


PI, PID = ControllerKind.PI, ControllerKind.PID


def _chosen(rule: TauCRule, model: ProcessModel, wishes: Wishes) -> Tuning:
    """Settings at the tau_c that the wishes ask for, directly or through Ms or GM; else at the rule's own."""
    asked = [name for name in ("tau_c_s", "ms", "gm") if getattr(wishes, name) is not None]
    if len(asked) > 1:
        raise ValueError("tau_c, ms and gm exclude each other: each of them fixes tau_c; give one")
    if wishes.tau_c_s is not None and wishes.tau_c_s < 0:
        raise ValueError(f"tau_c = {wishes.tau_c_s} s must not be negative")
    process, ms, gm = model.linear(), wishes.ms, wishes.gm
    if ms is not None:
        if not 1 < ms < math.inf:
            raise ValueError(f"ms = {ms} must be more than 1 and finite; 1.6 is a usual demand")
        return _smallest(rule, process, lambda gains: sensitivity_peak(process, gains) <= ms, f"Ms = {ms:g}")
    if gm is not None:
        if not 1 < gm < math.inf:
            raise ValueError(f"gm = {gm} must be more than 1 and finite; 3 is a usual demand")
        return _smallest(rule, process, lambda gains: gain_margin(process, gains) >= gm, f"GM = {gm:g}")
    return rule(wishes.tau_c_s)


def _checked(model: ProcessModel, kind: ControllerKind) -> None:
    if model.type == ProcessType.DOUBLE_INTEGRATING and kind == PI:
        raise ValueError("a double integrating process needs derivative action; give --kind pid")


def _with_notes(found: Tuning, model: ProcessModel, kind: ControllerKind) -> Tuning:
    """The tuning with what the source says of derivative action here."""
    notes = []
    if kind == PI and derivative_pays(model):
        notes.append(f"tau2 = {model.tau2_s:g} s is more than theta = {model.theta_s:g} s: derivative action would pay")
    if kind == PID and 0 < model.tau2_s <= model.theta_s:
        notes.append(
            f"tau2 = {model.tau2_s:g} s is not more than theta = {model.theta_s:g} s: derivative action hardly"
            " pays, PI is enough"
        )
    if kind == PID and found.gains.kd == 0:
        notes.append("a model without a second lag gives no derivative action: these settings are PI")
    return replace(found, notes=(*found.notes, *notes))


def _plain(name: str, c: float) -> Callable[[ProcessModel, ControllerKind, Wishes], Tuning]:
    def work(model: ProcessModel, kind: ControllerKind, wishes: Wishes) -> Tuning:
        _checked(model, kind)
        factor = c if wishes.c is None else wishes.c
        found = _chosen(lambda tau_c_s: simc(model, tau_c_s, kind, factor), model, wishes)
        return _with_notes(replace(found, rule=name), model, kind)

    return work


def _improved(model: ProcessModel, _kind: ControllerKind, wishes: Wishes) -> Tuning:
    factor = TAU_I_FACTOR if wishes.c is None else wishes.c
    return _with_notes(_chosen(lambda tau_c_s: simc_improved(model, tau_c_s, factor), model, wishes), model, PI)


def _smooth(model: ProcessModel, kind: ControllerKind, wishes: Wishes) -> Tuning:
    if wishes.u0 is None or wishes.y_max is None:
        raise ValueError("rule simc-smooth needs u0 (largest disturbance, co units) and ymax (allowed deviation)")
    _checked(model, kind)
    reduced = without_second_lag(model) if kind == PI else model
    tau_c_s = tau_c_smooth(reduced, wishes.u0, wishes.y_max)
    found = simc(model, tau_c_s, kind, TAU_I_FACTOR if wishes.c is None else wishes.c)
    if tau_c_s < reduced.theta_s:
        note = (
            f"tau_c = {tau_c_s:.4g} s is less than theta = {reduced.theta_s:.4g} s: ymax asks for more than tight"
            " control gives with good robustness"
        )
        found = replace(found, notes=(note,))
    return _with_notes(replace(found, rule="simc-smooth"), model, kind)


EVERY = tuple(t for t in ProcessType if t not in {*ZERO_SIDE, ProcessType.TOPDT})
"""An inverse response is so much dead time, a third lag goes by the half rule, a lead as a first order: registry.py."""
GAIN = "Kc = tau1/(k (tau_c + theta)) = 1/(k' (tau_c + theta))"


def _formulas(c: str) -> dict[ControllerKind, tuple[str, ...]]:
    """The formulas with this factor c: those of the first and second order, then those of the other structures."""
    reset, slow = f"tau_I = min(tau1, {c} (tau_c + theta))", f"Kc = 1/(k' (tau_c + theta)), tau_I = {c} (tau_c + theta)"
    double = "double integrating: Kc = 1/(4 k'' (tau_c + theta)^2), tau_I = tau_D = 4 (tau_c + theta)"
    pi = (GAIN, reset, f"integrating: {slow}", "pure delay: Ki = 1/(k (tau_c + theta))")
    return {PI: pi, PID: (GAIN, reset, "tau_D = tau2", f"integrating with lag: {slow}, tau_D = tau2", double)}


SMOOTH = ("Kc = Kc,min = |u0|/|ymax|", "tau_c = 1/(k' Kc) - theta", "tau_I = min(tau1, c (tau_c + theta))")
SLOW = "Kc = Kc,min = |u0|/|ymax|, tau_c = 1/(k' Kc) - theta, tau_I = c (tau_c + theta)"
SMOOTH_PI = (*SMOOTH, f"integrating: {SLOW}")
SMOOTH_PID = (
    *SMOOTH,
    "tau_D = tau2",
    f"integrating with lag: {SLOW}, tau_D = tau2",
    "double integrating: Kc = Kc,min = |u0|/|ymax|, tau_c = sqrt(1/(4 k'' Kc)) - theta,"
    " tau_I = tau_D = 4 (tau_c + theta)",
)
SKOGESTAD = "Skogestad 2003, J. Process Control 13, 291, table 1"
TIGHT = "any; tau_c = theta is tight control with Ms 1.6 to 1.7; derivative action pays when tau2 > theta"
WISHES = ("tau_c_s", "ms", "gm", "c")
RULES = (
    Rule("simc", "series", _formulas("c"), SKOGESTAD, TIGHT,
         types=EVERY, wishes=WISHES, from_model=_plain("simc", TAU_I_FACTOR)),
    Rule("simc-improved", "series",
         {PI: ("Kc = (tau1 + theta/3)/(k (tau_c + theta))", "tau_I = min(tau1 + theta/3, c (tau_c + theta))",
               "integrating: Kc = 1/(k' (tau_c + theta)), tau_I = c (tau_c + theta)")},
         "Grimholt & Skogestad 2012, IFAC PID'12, equations 10 and 11",
         "any but two integrators; better than SIMC for tau1 < theta",
         types=tuple(t for t in EVERY if t != ProcessType.DOUBLE_INTEGRATING), wishes=WISHES, from_model=_improved),
    Rule("simc-smooth", "series", {PI: SMOOTH_PI, PID: SMOOTH_PID},
         "Skogestad 2003, and his slides 'Simple rules for PID tuning' (smooth control)", "tau_c >= theta",
         types=tuple(t for t in EVERY if t != ProcessType.DELAY), wishes=("u0", "y_max", "c"), from_model=_smooth),
    Rule("haugen", "series", _formulas("1.44"),
         "Haugen, appendix A 'Skogestad's method for PID tuning', k1 = 1.44", "faster load rejection, Ms about 2",
         types=EVERY, wishes=WISHES, from_model=_plain("haugen", table.TAU_I_FACTOR_HAUGEN)),
    Rule("haugen-2010", "series", _formulas("2"),
         "Haugen 2010, as quoted by Grimholt & Skogestad 2012, equation 9", "faster load rejection, Ms up to 2",
         types=EVERY, wishes=WISHES, from_model=_plain("haugen-2010", table.TAU_I_FACTOR_HAUGEN_2010)),
)  # fmt: skip
