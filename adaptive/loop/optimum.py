"""The best PI or PID controller at a given robustness, by search on the exact loop.

    minimise J = 0.5 (IAE_ys/IAE_ys* + IAE_d/IAE_d*)   subject to Ms = m        (Grimholt & Skogestad 2012, section 3)

IAE_ys* and IAE_d* belong to the PI controllers that are best for setpoint steps alone and for load steps alone at
Ms = 1.59. For each integral (and derivative) time the gain follows from Ms = m: the largest such gain, since a loop on
an integrating process also has a small one. That leaves one free number for PI (bounded search) and two for PID.
"""

import math
from enum import StrEnum
from functools import lru_cache

import numpy as np

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.open_loop import bracketed_root, grid, open_loop, phase_crossovers
from retuner.adaptive.loop.performance import load_variation, setpoint_variation
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

MS_REFERENCE = 1.59  # Ms of the reference controllers (that of SIMC with tau_c = theta on a first order process)
GAIN_RATIO = 1.2  # steps in gain on the way down from the limit of stability
GAIN_ACCURACY = 1e-10  # accuracy of ln gain, relative
GAIN_STEPS = 70  # steps at the most: a factor of 3e5
GRID_POINTS = 15  # integral times tried before the search is refined
CENTRE = 10.0
"""Where the search for PID starts in its own coordinates: its first steps are 5 % of that, half a unit of ln tau."""
REFINED = 1e-4  # accuracy of ln tau_I; the optima are flat, so the cost is then exact to 1e-7


class Aim(StrEnum):
    """What is made small."""

    SETPOINT = "setpoint"
    LOAD = "load"
    BOTH = "both"


@dataclass(frozen=True, slots=True)
class Optimum:
    """A best controller, its IAE for unit steps, and the cost that was minimised."""

    gains: PidGains
    iae_setpoint: float
    iae_load: float
    cost: float


@dataclass(frozen=True, slots=True)
class References:
    """IAE_ys* and IAE_d* of a process."""

    iae_setpoint: float
    iae_load: float


@lru_cache(maxsize=512)
def gain_at_ms(process: LinearProcess, shape: PidGains, ms: float) -> PidGains | None:
    """The shape times the largest factor for which Ms = ms; None where there is none."""
    loop = open_loop(process, shape)
    first = [w for w in phase_crossovers(loop, grid(loop)) if abs(loop.phase_at(w) + math.pi) < 1e-6]
    limit = 1 / min((abs(loop.at(w)) for w in first), default=0.0) if first else math.inf
    limit = min(limit, 1 / loop.end_size if loop.end_size else math.inf)
    if limit == 0:
        return None  # the loop gain rises for ever: no dead time is allowed
    if math.isinf(limit):
        limit = 1e3 / abs(loop.at(max(loop.corners())))

    def robustness(log_gain: float) -> float:
        return 1 / sensitivity_peak(process, shape.times(math.exp(log_gain))) - 1 / ms

    high = math.log(limit)
    for _ in range(GAIN_STEPS):
        low = high - math.log(GAIN_RATIO)
        if robustness(low) >= 0:
            if robustness(high) >= 0:
                return None  # Ms stays below at any gain that was tried
            return shape.times(math.exp(bracketed_root(robustness, low, high, GAIN_ACCURACY)))
        high = low
    return None


@lru_cache(maxsize=512)
def _error(process: LinearProcess, gains: PidGains, aim: Aim) -> float:
    """IAE of one step; the three searches on one process meet at the same grid points."""
    return (setpoint_variation if aim == Aim.SETPOINT else load_variation)(process, gains, with_output=False).error


def _judged(process: LinearProcess, shape: PidGains, ms: float, aim: Aim, best: References | None) -> Optimum | None:
    """The controller of this shape at Ms = ms, with its cost; None where there is none."""
    gains = gain_at_ms(process, shape, ms)
    if gains is None:
        return None
    setpoint = math.inf if aim == Aim.LOAD else _error(process, gains, Aim.SETPOINT)
    load = math.inf if aim == Aim.SETPOINT else _error(process, gains, Aim.LOAD)
    if aim != Aim.BOTH:
        return Optimum(gains, setpoint, load, min(setpoint, load))
    assert best is not None
    return Optimum(gains, setpoint, load, 0.5 * (setpoint / best.iae_setpoint + load / best.iae_load))


def optimal_pi(process: LinearProcess, ms: float, aim: Aim = Aim.BOTH) -> Optimum:
    """The best PI (or P, or I) controller at Ms = ms.

    Raises ValueError: ms is not above 1, or no controller reaches it on this process.
    """
    # Refuse an Ms that no loop has, and a process without a limit of stability, whose best gain is infinite
    turn = len(process.lags_s) + 2 * len(process.quadratics) + process.integrators - len(process.leads_s)
    turn += 2 * sum(1 for lead in process.leads_s if lead < 0)
    if not process.theta_s and turn <= 2:
        raise ValueError("theta = 0: nothing limits the gain of this process, so no controller is best; give theta")
    if not 1 < ms < math.inf:
        raise ValueError(f"ms = {ms} must be more than 1 and finite; 1.59 is the usual demand")
    best, sign = references(process) if aim == Aim.BOTH else None, math.copysign(1.0, process.k)

    def judged(log_tau_i: float) -> Optimum | None:
        return _judged(process, PidGains(sign, sign * math.exp(-log_tau_i)), ms, aim, best)

    low, high = _range(process)
    tried = np.linspace(low, high, GRID_POINTS)
    found = [judged(float(x)) for x in tried]
    costs = [math.inf if one is None else one.cost for one in found]
    i = int(np.argmin(costs))
    pure = [_judged(process, PidGains(sign, 0.0), ms, aim, best), _judged(process, PidGains(0.0, sign), ms, aim, best)]
    candidates = [one for one in (*found, *pure) if one is not None and math.isfinite(one.cost)]
    if not candidates:
        raise ValueError(
            f"no PI controller has Ms = {ms:g} on this process; ask for another Ms, or give more dead time"
        )
    bracket = float(tried[max(i - 1, 0)]), float(tried[min(i + 1, len(tried) - 1)])
    from scipy.optimize import minimize_scalar

    refined = minimize_scalar(lambda x: _cost(judged(x)), bounds=bracket, method="bounded", options={"xatol": REFINED})
    candidates += [one for one in [judged(float(refined.x))] if one is not None]
    return min(candidates, key=lambda one: one.cost)


def optimal_pid(process: LinearProcess, ms: float) -> Optimum:
    """The best PID controller (ideal form, derivative without filter, on the error) at Ms = ms, for both aims.

    Raises ValueError: as optimal_pi.
    """
    start, best, sign = optimal_pi(process, ms), references(process), math.copysign(1.0, process.k)

    low, high = _range(process)
    tau_i = start.gains.kp / start.gains.ki if start.gains.ki and start.gains.kp else math.exp((low + high) / 2)
    tau_d = max(process.theta_s, 1e-3 * tau_i) / 3

    def judged(x: FloatArray) -> Optimum | None:
        i, d = tau_i * math.exp(x[0] - CENTRE), tau_d * math.exp(x[1] - CENTRE)
        return _judged(process, PidGains(sign, sign / i, sign * d), ms, Aim.BOTH, best)

    def cost(x: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        return _cost(judged(x))

    from scipy.optimize import minimize

    refined = minimize(cost, [CENTRE, CENTRE], method="Nelder-Mead", tol=1e-3, options={"maxiter": 80})
    found = judged(refined.x)
    return start if found is None or found.cost > start.cost else found


def _cost(found: Optimum | None) -> float:
    """The cost, large and finite where there is no controller, so that a search turns back."""
    return 1e9 if found is None or not math.isfinite(found.cost) else found.cost


def _range(process: LinearProcess) -> tuple[float, float]:
    """Logarithms of the shortest and longest integral time that could be best."""
    times = [process.theta_s, *process.lags_s, *(math.sqrt(c2) for _, c2 in process.quadratics)]
    times += [abs(x) for x in process.leads_s]
    longest = sum(times) or 1.0
    shortest = process.theta_s or min((x for x in times if x > 0), default=1.0)
    return math.log(0.1 * shortest), math.log((40.0 if process.integrators else 4.0) * longest)


@lru_cache(maxsize=64)
def references(process: LinearProcess) -> References:
    """IAE_ys* and IAE_d* of a process, for unit steps.

    Raises ValueError: no PI controller has Ms = 1.59 on this process (one without dead time and of low order, or too
    hard).
    """
    setpoint = optimal_pi(process, MS_REFERENCE, Aim.SETPOINT)
    return References(setpoint.cost, optimal_pi(process, MS_REFERENCE, Aim.LOAD).cost)
