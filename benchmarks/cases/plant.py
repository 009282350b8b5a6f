"""The process of a loop: how it moves, what it is drawn from, how robust it truly is, and its best settings."""

import math
from dataclasses import dataclass, replace

import numpy as np

from cases.case import FloatArray
from retuner import LinearProcess, PidGains, ProcessModel, ProcessType
from retuner.adaptive.loop.simulate import HeldInput
from retuner.adaptive.process.model import ComplexArray
from retuner.schedule.gains import from_form


class HeldPlant(HeldInput):
    """The process in steps of h_s, about zero; `move` holds an input for one step (closed forms: test_cases.py)."""

    move = HeldInput.step


# ---- Processes drawn from families of the literature and from some that no published batch has.
#
# All are drawn with an effective dead time of about one, then put on a time scale over four decades, in units over five
# decades and with a gain of either sign.

DECADES_OF_TIME = (-2.0, 2.0)
"""Exponents of ten of the time scale in seconds: from an effective dead time of 10 ms to 100 s."""
DECADES_OF_GAIN = (-2.0, 3.0)  # Exponents of ten of pv units per co unit
FAMILIES = (
    "first",
    "second",
    "oscillatory",
    "integrating",
    "integrating-lag",
    "equal-lags",
    "lag-series",
    "inverse",
    "batch-p3",
    "batch-p5",
    "batch-p6",
    "batch-p7",
    "batch-p9",
    "diffusion",
    "integrating-lags",
    "two-lags-inverse",
)
INTEGRATING = frozenset({"integrating", "integrating-lag", "batch-p6", "integrating-lags"})

Shape = tuple[tuple[float, ...], tuple[float, ...], tuple[tuple[float, float], ...], float, int]
"""lags, leads, quadratics, dead time, integrators"""


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Between low and high, every factor equally likely."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def draw(rng: np.random.Generator, family: str) -> LinearProcess:
    """One process of a family, with its time scale, units and sign drawn too."""
    # Time constants with an effective dead time of the order of one
    simple = {
        "first": lambda: ((log_uniform(rng, 0.3, 50.0),), (), (), 1.0, 0),
        "second": lambda: (_two_lags(rng), (), (), 1.0, 0),
        "oscillatory": lambda: ((), (), (_pair(rng, log_uniform(rng, 0.5, 6.0), 0.4),), 1.0, 0),
        "integrating": lambda: ((), (), (), 1.0, 1),
        "integrating-lag": lambda: ((log_uniform(rng, 0.1, 5.0),), (), (), 1.0, 1),
        "equal-lags": lambda: ((1.0,) * int(rng.integers(3, 9)), (), (), 0.0, 0),
        "lag-series": lambda: (tuple(log_uniform(rng, 0.1, 5.0) for _ in range(rng.integers(3, 7))), (), (), 0.2, 0),
        "inverse": lambda: ((1.0, 1.0, 1.0), (-float(rng.uniform(0.1, 1.1)),), (), 0.0, 0),
    }
    lags, leads, quadratics, theta, integrators = simple[family]() if family in simple else _more(rng, family)
    scale = 10 ** rng.uniform(*DECADES_OF_TIME)
    k = float(rng.choice([-1.0, 1.0])) * 10 ** rng.uniform(*DECADES_OF_GAIN) / scale**integrators
    return LinearProcess(
        k,
        tuple(x * scale for x in lags),
        tuple(x * scale for x in leads),
        theta * scale,
        integrators,
        tuple((c1 * scale, c2 * scale**2) for c1, c2 in quadratics),
    )


def _more(rng: np.random.Generator, family: str) -> Shape:
    """Families of the Astrom-Hagglund batch with parameters drawn anew, and others beyond it."""
    a, t = float(rng.uniform(0.1, 0.9)), log_uniform(rng, 1.0, 10.0)
    length = float(rng.uniform(0.05, 0.95))
    quick = log_uniform(rng, 0.3, 3.0)
    far = {
        "batch-p3": lambda: ((1.0, *(log_uniform(rng, 0.02, 10.0),) * 2), (), (), 0.0, 0),
        "batch-p5": lambda: (tuple(a**i for i in range(4)), (), (), 0.0, 0),
        "batch-p6": lambda: ((1 - length,), (), (), length, 1),
        "batch-p7": lambda: ((t, 1 - length), (), (), length, 0),
        "batch-p9": lambda: ((1.0,), (), (_pair(rng, float(rng.uniform(0.1, 1.0)), 0.7, 0.7),), 0.0, 0),
        "diffusion": lambda: (tuple(8.0 / (2 * i - 1) ** 2 for i in range(1, 7)), (), (), float(rng.uniform(0, 1)), 0),
        "integrating-lags": lambda: (tuple(log_uniform(rng, 0.1, 2.0) for _ in range(3)), (), (), 0.3, 1),
        "two-lags-inverse": lambda: ((4.0 * quick, quick), (-float(rng.uniform(0.1, 0.8)) * quick,), (), 0.5, 0),
    }
    return far[family]()


def _two_lags(rng: np.random.Generator) -> tuple[float, float]:
    tau1 = log_uniform(rng, 0.6, 30.0)
    return tau1, tau1 * log_uniform(rng, 0.1, 1.0)


def _pair(rng: np.random.Generator, t: float, low: float, high: float = 1.0) -> tuple[float, float]:
    """c1, c2 of a pair of poles with the natural period 2 pi t and a damping between low and high."""
    return 2 * float(rng.uniform(low, high)) * t, t * t


# ---- Stability, Ms and gain margin of a true loop, written apart from retuner's own margins, which are being judged.
#
#     L = C G,   Ms = max 1/|1 + L|,   gain margin = least factor on L that reaches -1
#
# Stable by the argument principle: with n poles of L at the origin and none to the right, arg(1 + L) grows by n
# pi/2 from w = 0+ on (Astrom & Murray 2008, section 9.2). The dead time is exact.

POINTS_PER_DECADE = 150
DECADES_BEYOND = 3.0
TURN_OF_DELAY = 0.3  # Largest turn of the dead time, rad, between two points of the grid while |L| is above SMALL
SMALL = 0.3


@dataclass(frozen=True, slots=True)
class Robustness:
    """ms is infinite for an unstable loop; gm is infinite where the loop never turns to -180 degrees."""

    ms: float
    gm: float

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable."""
        return math.isfinite(self.ms)


def robustness(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> Robustness:
    """Robustness of a process under these gains; tau_f_s filters the derivative."""
    # logarithmic, round every frequency of the loop
    times = [process.theta_s, *process.lags_s, *(abs(x) for x in process.leads_s)]
    times += [math.sqrt(c2) for _, c2 in process.quadratics]
    times += [abs(gains.kp / gains.ki)] if gains.ki and gains.kp else []
    corners = [1 / x for x in times if x > 0]
    corners += [
        abs(process.k * g) ** (1 / n)
        for g, n in ((gains.ki, process.integrators + 1), (gains.kp, process.integrators))
        if g and n
    ]
    low, high = math.log10(min(corners)) - DECADES_BEYOND, math.log10(max(corners)) + DECADES_BEYOND
    w = np.logspace(low, high, int((high - low) * POINTS_PER_DECADE) + 1)
    loop = _loop(process, gains, tau_f_s, w)
    big = np.flatnonzero(np.abs(loop) > SMALL)
    if big.size and big[-1] == len(w) - 1 and abs(loop[-1]) >= 1:
        return Robustness(math.inf, 0.0)
    last = int(big[-1]) + 1 if big.size else 1
    if process.theta_s:
        step = TURN_OF_DELAY / process.theta_s
        count = int(min((w[last - 1] - w[0]) / step, 2e5)) + 1
        w = np.union1d(w, w[0] + step * np.arange(count))
        loop = _loop(process, gains, tau_f_s, w)
        last = int(np.flatnonzero(np.abs(loop) > SMALL)[-1]) + 1 if big.size else 1
    near = (1 + loop)[: min(last + 1, len(w))]
    turned = float(np.sum(np.angle(near[1:] / near[:-1]))) - float(np.angle(near[-1]))
    poles = process.integrators + (1 if gains.ki else 0)
    if abs(turned - poles * math.pi / 2) > math.pi / 2:
        return Robustness(math.inf, 0.0)
    # largest |S|, looked at closely round the grid's best
    values = 1 / np.abs(1 + loop)
    i = int(np.argmax(values))
    fine = np.geomspace(w[max(i - 1, 0)], w[min(i + 1, len(w) - 1)], 60)
    # between two points the crossing of the real axis is found on the straight line
    x, y = loop.real, loop.imag
    at = np.flatnonzero(y[:-1] * y[1:] < 0)
    crossing = x[at] - y[at] * (x[at + 1] - x[at]) / (y[at + 1] - y[at])
    inside = crossing[(crossing < 0) & (crossing > -1)]
    return Robustness(
        float(max(np.max(values), np.max(1 / np.abs(1 + _loop(process, gains, tau_f_s, fine))))),
        float(1 / np.max(-inside)) if inside.size else math.inf,
    )


def _loop(process: LinearProcess, gains: PidGains, tau_f_s: float, w: FloatArray) -> ComplexArray:
    s = 1j * w
    return (gains.kp + gains.ki / s + gains.kd * s / (1 + tau_f_s * s)) * process.response(w)


# ---- SIMC with perfect knowledge: the half rule on the true process, tau_c = theta, theta + dt/2 for the sampling.
#
# Written apart from retuner's own rule and reduction, which must not be judged by themselves. Lags and negative leads
# only. For pairs of complex poles SIMC is not made and reaches Ms of 6; there tau_c is raised until Ms is 1.8.

MS_OF_COMPLEX_POLES = 1.8
TAU_C_STEP = 1.05
TAU_I_FACTOR = 4.0


def half_rule(process: LinearProcess, order: int = 1) -> ProcessModel:
    """Model of first or second order (Skogestad 2003, section 2).

    A pair of poles 1 + c1 s + c2 s^2 counts as two lags of sqrt(c2), which have the same size and, at 1/sqrt(c2), the
    same phase.
    """
    pairs = [math.sqrt(c2) for _, c2 in process.quadratics for _ in range(2)]
    lags = sorted([*(x for x in process.lags_s if x > 0), *pairs], reverse=True)
    theta = process.theta_s + sum(-x for x in process.leads_s if x < 0)
    kept = order - process.integrators  # an integrator is the first lag of an integrating process
    if kept < len(lags):
        neglected = lags[kept]
        theta += sum(lags[kept + 1 :]) + (neglected if kept == 0 else neglected / 2)
        if kept > 0:
            lags = [*lags[: kept - 1], lags[kept - 1] + neglected / 2]
    lags = lags[:kept]
    if process.integrators:
        if lags:
            return ProcessModel(ProcessType.INTEGRATING_LAG, process.k, 0.0, lags[0], theta)
        return ProcessModel(ProcessType.INTEGRATING, process.k, 0.0, 0.0, theta)
    tau1, tau2 = (*lags, 0.0)[:2]
    tau1, tau2 = max(tau1, tau2), min(tau1, tau2)
    return ProcessModel(ProcessType.SOPDT if tau2 else ProcessType.FOPDT, process.k, tau1, tau2, theta)


def later(model: ProcessModel, delay_s: float) -> ProcessModel:
    return replace(model, theta_s=model.theta_s + delay_s)


def sampled(process: LinearProcess, dt_s: float) -> LinearProcess:
    """The process as a sampled controller meets it: half a sample more dead time."""
    return replace(process, theta_s=process.theta_s + dt_s / 2)


def simc_of(model: ProcessModel, tau_c_s: float) -> PidGains:
    """Table 1 of Skogestad (2003), series form."""
    span = tau_c_s + model.theta_s
    tau_i = min(model.tau1_s, TAU_I_FACTOR * span) if model.tau1_s else TAU_I_FACTOR * span
    return from_form("series", 1 / (model.slope * span), tau_i, model.tau2_s)


def best_pi(process: LinearProcess, dt_s: float) -> PidGains:
    """SIMC PI settings."""
    return _tuned(process, later(half_rule(process), dt_s / 2), dt_s)


def best_pid(process: LinearProcess, dt_s: float) -> PidGains | None:
    """SIMC PID settings, None where the process has no second lag."""
    model = half_rule(process, 2)
    return _tuned(process, later(model, dt_s / 2), dt_s) if model.tau2_s else None


def _tuned(process: LinearProcess, model: ProcessModel, dt_s: float) -> PidGains:
    """At tau_c = theta, or at the smallest larger one that keeps Ms where there are complex poles."""
    tau_c = model.theta_s
    found = simc_of(model, tau_c)
    if any(c1 * c1 < 4 * c2 for c1, c2 in process.quadratics):
        while robustness(sampled(process, dt_s), found).ms > MS_OF_COMPLEX_POLES:
            tau_c *= TAU_C_STEP
            found = simc_of(model, tau_c)
    return found
