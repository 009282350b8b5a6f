"""Model reduction by Skogestad's half rule: any stable or integrating process to first or second order + dead time.

    theta = dead time + inverse-response times + half of the largest neglected lag + all smaller lags
    the other half of that lag joins the smallest retained one            (Skogestad 2003, section 2, eqs. 10 and 11)

An integrator is a lag without bound and takes its half without changing. Numerator time constants:
- negative ones (inverse response) are dead time;
- positive ones not longer than the true dead time are taken from it, e^(-theta s)(T0 s + 1) ~ e^(-(theta - T0) s), as
  the textbooks do (Seborg, Edgar & Mellichamp 2011, section 6.3); leads = "rules" leaves this out. It is the bolder
  choice: the loop tuned for it is the less robust the nearer T0 is to the dead time;
- all others, the largest first, are set against a lag by rules T1 to T3. These ask for the
  effective dead time that comes out in the end, so it is guessed, and iterated until it agrees with itself. The guess
  is what subtracting would give, at least the true dead time: it leads to the answers printed for E3, E6, E12 and E13,
  where others agree with themselves as well. An answer without any dead time is given only if there is no other.
Skogestad (2003) prints 1.69 s for his integrating example E6, the whole of the largest neglected lag, where the half
rule as he states it gives half. E6 is the only one of them with leads (which hold up the gain at high frequencies where
the half rule counts on lags), so the whole is taken where a lead was set against a lag of a purely integrating result.

A pair of complex poles, 1 + c1 s + c2 s^2, becomes two lags of c1/2: the same sum of times, exact for a double lag.
It is refused below SMALLEST_DAMPING: no lags stand for a resonance.
"""

import math
from enum import StrEnum
from typing import NamedTuple

from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.schedule.late_dataclass import dataclass, replace

# Numerator time constants set against denominator ones: rules T1 to T3 of Skogestad (2003), section 2.3.
#
#     (T0 s + 1)/(tau0 s + 1)  ~  T0/tau0                               T0 >= tau0 >= theta           T1
#                                 T0/theta                              T0 >= theta >= tau0           T1a
#                                 1                                     theta >= T0 >= tau0           T1b
#                                 T0/tau0                               tau0 >= T0 >= 5 theta         T2
#                                 (t/tau0)/((t - T0) s + 1)             t = min(tau0, 5 theta) >= T0  T3
#
# theta is the effective dead time that comes out in the end, so the caller iterates. tau0 is the closest larger lag, or
# the closest smaller one when there is no larger one or when the smaller one is close: T0/small < large/T0 and
# T0/small < 1.6. An integrator is a lag without bound: its gain is k' = k/tau0, so the limits of T2 and T3 are
# k' T0 and k' 5 theta/((5 theta - T0) s + 1).

CLOSE = 1.6  # A smaller lag is close to a lead within this ratio (Skogestad 2003)
WITHIN = 5.0
"""Lags beyond this many dead times look like integrators to the closed loop (Skogestad 2003, rules T2 and T3)."""
ROUNDING = 1e-3
"""Ratios are compared with this relative slack: 0.08/0.05 is 1.6, not less, also when 0.05 is a polynomial's root."""


class LeadOverLag(NamedTuple):
    """A lead that has been set against a lag.

    rule : name of the rule. lead_s, against_s : what was set against what (infinite: an integrator).
    factor : on the gain; seconds where an integrator has gone. rest_s : lag that remains, 0 for none.
    """

    rule: str
    lead_s: float
    against_s: float
    factor: float
    rest_s: float

    def text(self) -> str:
        """The step in words."""
        against = "the integrator" if math.isinf(self.against_s) else f"lag {self.against_s:g} s"
        rest = f", lag {self.rest_s:g} s remains" if self.rest_s else ""
        return f"{self.rule}: lead {self.lead_s:g} s against {against}: gain x {self.factor:.6g}{rest}"


def against(lead_s: float, lags_s: list[float]) -> float:
    """The lag that a lead is set against; integrators are among lags_s as infinite ones.

    Raises ValueError: there is no lag left.
    """
    larger = [lag for lag in lags_s if lag >= lead_s]
    smaller = [lag for lag in lags_s if lag < lead_s]
    if not lags_s:
        raise ValueError(
            f"a numerator time constant of {lead_s:g} s has no lag to be set against: more zeros than "
            "poles; add the missing lags (sensor, actuator)"
        )
    if not smaller:
        return min(larger)
    near = max(smaller)
    ratio = lead_s / near * (1 + ROUNDING)
    if not larger or (ratio < min(larger) / lead_s and ratio < CLOSE):
        return near
    return min(larger)


def set_against(lead_s: float, lag_s: float, theta_s: float) -> LeadOverLag:
    """Apply the rule that holds for a lead, a lag (infinite for an integrator) and an effective dead time, all in s."""
    if lead_s > lag_s:
        rule = "T1" if theta_s <= lag_s else "T1a" if theta_s <= lead_s else "T1b"
        return LeadOverLag(rule, lead_s, lag_s, lead_s / min(max(theta_s, lag_s), lead_s), 0.0)
    unit = 1.0 if math.isinf(lag_s) else lag_s
    if lead_s >= WITHIN * theta_s:
        return LeadOverLag("T2", lead_s, lag_s, lead_s / unit, 0.0)
    reach = min(lag_s, WITHIN * theta_s)
    return LeadOverLag("T3", lead_s, lag_s, reach / unit, reach - lead_s)


SMALLEST_DAMPING = 0.5
"""Pairs of poles with less damping (a step overshoots by more than 16 %) are not reduced; dimensionless."""
ITERATIONS = 100  # far more than the effective dead time needs: it moves between the few levels that the rules have
SETTLED = 1e-12  # relative change of the effective dead time below which it agrees with itself


class Leads(StrEnum):
    """What becomes of positive numerator time constants: see the head of this file."""

    AUTO = "auto"
    RULES = "rules"
    SUBTRACT = "subtract"


@dataclass(frozen=True, slots=True)
class Reduction:
    """A reduced model and how it came about.

    model : the result. steps : one line each, in the order taken.
    """

    model: ProcessModel
    steps: tuple[str, ...]

    def to_dict(self) -> dict[str, object]:
        """Keys model {type, k, tau1, tau2, theta}, steps."""
        return {"model": self.model.to_dict(), "steps": list(self.steps)}


@dataclass(frozen=True, slots=True)
class _Parts:
    """A process taken to pieces: lags from the longest (infinite: integrators), leads from the longest, dead time."""

    k: float
    lags_s: list[float]
    leads_s: list[float]
    theta_s: float
    steps: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Half:
    """Outcome of the half rule for one guess of the effective dead time."""

    k: float
    retained_s: list[float]
    theta_s: float
    settings: tuple[LeadOverLag, ...]


def reduce(process: LinearProcess, order: int = 1, leads: Leads = Leads.AUTO) -> Reduction:
    """First- or second-order model of a process.

    Parameters
    ----------
    process : any stable or integrating process. order : 1 (for PI) or 2 (for PID): lags and integrators that remain.
    leads : what becomes of positive numerator time constants; "subtract" takes all of them from the dead time.

    Returns
    -------
    Reduction
        The model, and the steps that led to it (Skogestad 2003, half rule).

    Raises
    ------
    ValueError
        The order is neither 1 nor 2, there are more integrators than that, a pair of poles swings, the zeros outnumber
        the poles, or the dead time is shorter than what is to be subtracted from it.
    """
    if order not in {1, 2}:
        raise ValueError(f"order = {order}: the half rule reduces to order 1 (for PI) or 2 (for PID)")
    if process.integrators > order:
        remedy = "give order 2" if process.integrators == 2 else "there is no rule for them"
        raise ValueError(f"{process.integrators} integrators do not fit into order {order}; {remedy}")
    parts = _parts(process, leads)
    # The effective dead time that agrees with itself; see the head of this file for which one, if there are more
    if not parts.leads_s:
        found = _half(parts, order, parts.theta_s)
    else:
        finite = sum(lag for lag in parts.lags_s if math.isfinite(lag))
        subtracted = _half(replace(parts, leads_s=[]), order, 0.0).theta_s - sum(parts.leads_s)
        found = _iterated(parts, order, max(subtracted, parts.theta_s))
        if found.theta_s <= SETTLED * finite:
            found = _iterated(parts, order, abs(parts.theta_s) + 2 * finite + sum(parts.leads_s))
    if found.theta_s < 0:
        raise ValueError(
            f"the effective dead time would be {found.theta_s:g} s: the numerator time constants are too "
            'large to be subtracted; use rules T1 to T3 (leads = "rules")'
        )
    steps = [*parts.steps, *(s.text() for s in found.settings)]
    more = len(parts.lags_s) - sum(not s.rest_s for s in found.settings) - order
    if more > 0:
        lags = f"{more} lag{'s' if more > 1 else ''}"
        steps.append(f"half rule: {lags} neglected, effective dead time {found.theta_s:.6g} s")
    return Reduction(_model(found), tuple(steps))


def half_rule(process: LinearProcess, order: int = 1) -> ProcessModel:
    """The model of `reduce` alone."""
    return reduce(process, order).model


def _parts(process: LinearProcess, leads: Leads) -> _Parts:
    """Everything that needs no iteration: pairs of poles, inverse response, leads taken from the dead time."""
    steps: list[str] = []
    lags = [lag for lag in process.lags_s if lag > 0]
    for c1, c2 in process.quadratics:
        root, pair = c1 * c1 - 4 * c2, (c1 / 2, c1 / 2)
        if root >= 0:  # two real lags
            larger = (c1 + math.sqrt(root)) / 2
            pair = larger, c2 / larger if larger else 0.0
        elif (damping := c1 / (2 * math.sqrt(c2))) < SMALLEST_DAMPING:
            raise ValueError(
                f"poles 1 + {c1:g} s + {c2:g} s^2 oscillate with a zeta of {damping:.2g}, below {SMALLEST_DAMPING:g}: "
                "lags cannot stand for a resonance; damp it or filter it out first"
            )
        else:
            steps.append(f"complex poles 1 + {c1:g} s + {c2:g} s^2: two lags of {pair[0]:g} s")
        lags += [lag for lag in pair if lag > 0]
    theta, kept = process.theta_s, []
    for lead in sorted((x for x in process.leads_s if x > 0), reverse=True):
        if leads == Leads.SUBTRACT or (leads == Leads.AUTO and lead <= theta):
            theta -= lead
            steps.append(f"lead {lead:g} s: taken from the dead time")
        else:
            kept.append(lead)
    inverse = sum(-x for x in process.leads_s if x < 0)
    if inverse:
        steps.append(f"inverse response: {inverse:g} s of dead time")
    ordered = [math.inf] * process.integrators + sorted(lags, reverse=True)
    if len([x for x in process.leads_s if x]) > len(ordered):
        raise ValueError(
            f"{len(process.leads_s)} numerator time constants, but only {len(ordered)} of lags and "
            "integrators: more zeros than poles; add the missing lags (sensor, actuator)"
        )
    return _Parts(process.k, ordered, kept, theta + inverse, tuple(steps))


def _iterated(parts: _Parts, order: int, guess_s: float) -> _Half:
    """The effective dead time that agrees with itself, from a first guess: more dead time leaves more lag."""
    found = _half(parts, order, guess_s)
    for _ in range(ITERATIONS):
        before, found = found, _half(parts, order, found.theta_s)
        if abs(found.theta_s - before.theta_s) <= SETTLED * before.theta_s:
            break
    return found


def _half(parts: _Parts, order: int, theta_s: float) -> _Half:
    """Leads set against lags, then the half rule, for one guess of the effective dead time."""
    k, lags, settings = parts.k, list(parts.lags_s), []
    for lead in parts.leads_s:
        setting = set_against(lead, against(lead, lags), theta_s)
        lags.remove(setting.against_s)
        if setting.rest_s > 0:
            lags.append(setting.rest_s)
            lags.sort(reverse=True)
        k *= setting.factor
        settings.append(setting)
    retained, neglected = lags[:order], lags[order:]
    theta = parts.theta_s + sum(neglected)
    # Whether the largest neglected lag counts in full: a purely integrating result after T3, see the head
    if neglected and not (all(math.isinf(lag) for lag in retained) and any(s.rest_s for s in settings)):
        theta -= neglected[0] / 2
        retained[-1] += neglected[0] / 2
    return _Half(k, retained, theta, tuple(settings))


def _model(found: _Half) -> ProcessModel:
    """The structure that the retained lags make."""
    integrators = sum(math.isinf(lag) for lag in found.retained_s)
    finite = sorted((lag for lag in found.retained_s if math.isfinite(lag)), reverse=True)
    tau1, tau2 = ([*finite, 0.0, 0.0])[:2]
    theta = found.theta_s
    if integrators == 2:
        return ProcessModel(ProcessType.DOUBLE_INTEGRATING, found.k, theta_s=theta)
    if integrators == 1:
        kind = ProcessType.INTEGRATING_LAG if tau1 else ProcessType.INTEGRATING
        return ProcessModel(kind, found.k, tau2_s=tau1, theta_s=theta)
    kind = ProcessType.SOPDT if tau2 else ProcessType.FOPDT if tau1 else ProcessType.DELAY
    return ProcessModel(kind, found.k, tau1, tau2, theta)
