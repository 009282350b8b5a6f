"""Process models: the few-parameter models that rules tune for, and the general linear process behind them.

    G(s) = k  prod(1 + lead_i s) / (s^n prod(1 + lag_i s) prod(1 + c1_i s + c2_i s^2))  e^(-theta s)

k is the steady-state gain; for integrating types it is the slope gain k' per second (k'' per second squared).
"""

import math
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values

ComplexArray = npt.NDArray[np.complex128]


class ProcessType(StrEnum):
    """The six structures of Skogestad (2003), under the names of the command line, and three that only fits have.

    Attributes
    ----------
    SOPDT_INVERSE : second order behind a zero in the right half-plane, 1 - b s: pv answers the wrong way first.
    SOPDT_LEAD : second order and a lead, a zero in the left half-plane: pv jumps, or overshoots, then creeps.
    TOPDT : second order and a third lag. Rules take it as the second order that the half rule makes of it.
    """

    FOPDT = "fopdt"
    SOPDT = "sopdt"
    INTEGRATING = "integrating"
    INTEGRATING_LAG = "integrating-lag"
    DOUBLE_INTEGRATING = "double-integrating"
    DELAY = "delay"
    SOPDT_INVERSE = "sopdt-inverse"
    SOPDT_LEAD = "sopdt-lead"
    TOPDT = "topdt"


def _plain(of: object, *names: str) -> None:
    """Make numbers of numpy plain ones: a repr then shows numbers, and JSON takes them."""
    for name in names:
        value = getattr(of, name)
        if type(value) is not float:
            object.__setattr__(of, name, float(value))


@dataclass(frozen=True, slots=True)
class LinearProcess:
    """A linear process of any order with dead time: what a plant truly is at one operating point.

    Parameters
    ----------
    k : gain (see the head of this file).
    lags_s, leads_s : time constants of poles and zeros in seconds; a negative lead is an inverse response.
    theta_s : dead time in seconds.
    integrators : number of pure integrators.
    quadratics : pairs (c1_s, c2_s2) of factors 1 + c1 s + c2 s^2 of the denominator: pairs of poles, complex ones too.

    Raises
    ------
    ValueError
        A number is not finite, k is zero, a lag, theta or a coefficient of a pair is negative.
    """

    k: float
    lags_s: tuple[float, ...] = ()
    leads_s: tuple[float, ...] = ()
    theta_s: float = 0.0
    integrators: int = 0
    quadratics: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        _plain(self, "k", "theta_s")
        for name in ("lags_s", "leads_s"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        object.__setattr__(self, "quadratics", tuple((float(c1), float(c2)) for c1, c2 in self.quadratics))
        for name, value in (
            ("k", self.k),
            ("theta_s", self.theta_s),
            *(("lags_s", x) for x in self.lags_s),
            *(("leads_s", x) for x in self.leads_s),
            *(("quadratics", x) for pair in self.quadratics for x in pair),
        ):
            if not math.isfinite(value):
                raise ValueError(f"{name} = {value} is not a finite number")
        if self.k == 0:
            raise ValueError("k = 0: the controller output does not move this process")
        if min((self.theta_s, *self.lags_s)) < 0:
            raise ValueError(f"theta_s = {self.theta_s}, lags_s = {self.lags_s}: times must not be negative")
        if min(map(min, self.quadratics), default=0.0) < 0:
            raise ValueError(f"quadratics = {self.quadratics}: a negative coefficient makes the process unstable")

    def seen_by_controller(self, sample_time_s: float) -> "LinearProcess":
        """The process as a sampled controller sees it: half an interval more dead time (Skogestad 2003, section 2)."""
        return replace(self, theta_s=self.theta_s + sample_time_s / 2)

    def response(self, w: FloatArray) -> ComplexArray:
        """G(jw) at the frequencies w in rad/s, shape (n,)."""
        s = 1j * np.asarray(w, dtype=np.float64)
        g = self.k * np.exp(-self.theta_s * s) / s**self.integrators
        for lead in self.leads_s:
            g = g * (1 + lead * s)
        for lag in self.lags_s:
            g = g / (1 + lag * s)
        for c1, c2 in self.quadratics:
            g = g / (1 + c1 * s + c2 * s * s)
        return np.asarray(g, dtype=np.complex128)


ZERO_SIDE = {ProcessType.SOPDT_INVERSE: 1, ProcessType.SOPDT_LEAD: -1}  # sign of b in the zero 1 - b s
W_THETA = 0.5
"""w theta at the crossover of SIMC with tau_c = theta: there k' e^(-theta s)/s lags by so much and a quarter turn."""
BISECTIONS = 40  # halvings of the range of w: its twelfth digit
NO_TIME = 1e-9  # share of the lag below which a dead time is none


@dataclass(frozen=True, slots=True)
class ProcessModel:
    """A model that a tuning rule takes: one of the structures.

    Parameters
    ----------
    type : structure, or its name.
    k : steady-state gain, or k', k'' for one or two integrators.
    tau1_s, tau2_s : lags, tau1_s >= tau2_s; 0 where the structure has none. For integrating-lag the lag is tau2_s.
    theta_s : (effective) dead time.
    zeta : damping of a second-order process that swings, 0 < zeta <= 1: its denominator is
        1 + 2 zeta tau s + tau^2 s^2 with tau = tau1_s = tau2_s. 1 for two real lags and for all other structures.
    inverse_s : b of a zero 1 - b s, above 0 for sopdt-inverse, below 0 for sopdt-lead and 0 for all others.
    tau3_s : the third lag, of any length, above 0 for topdt and 0 for all others.

    Raises
    ------
    ValueError
        There is no such structure, a value is not finite, of the wrong sign, or the structure has no place for it.
    """

    type: ProcessType
    k: float
    tau1_s: float = 0.0
    tau2_s: float = 0.0
    theta_s: float = 0.0
    zeta: float = 1.0
    inverse_s: float = 0.0
    tau3_s: float = 0.0

    def __post_init__(self) -> None:
        if type(self.type) is not ProcessType:
            if self.type not in list(ProcessType):
                raise ValueError(f"type = {self.type!r} is no process type; use one of {', '.join(ProcessType)}")
            object.__setattr__(self, "type", ProcessType(self.type))
        _plain(self, "k", "tau1_s", "tau2_s", "theta_s", "zeta", "inverse_s", "tau3_s")
        times = (self.theta_s, self.tau1_s, self.tau2_s)
        if not (self.k and math.isfinite(self.k + sum(times)) and min(times) >= 0):
            LinearProcess(self.k, times[1:], (), self.theta_s)  # says what is wrong
        second = self.type in {ProcessType.SOPDT, ProcessType.TOPDT, *ZERO_SIDE}
        has_tau1 = second or self.type == ProcessType.FOPDT
        has_tau2 = second or self.type == ProcessType.INTEGRATING_LAG
        if has_tau1 != (self.tau1_s > 0):
            raise ValueError(f"tau1_s = {self.tau1_s}: type {self.type} {'needs' if has_tau1 else 'has no'} tau1")
        if self.tau2_s > 0 and not has_tau2:
            raise ValueError(f"tau2_s = {self.tau2_s}: type {self.type} has no tau2")
        if has_tau1 and self.tau2_s > self.tau1_s:
            raise ValueError(f"tau2_s = {self.tau2_s} is larger than tau1_s = {self.tau1_s}; exchange them")
        if not 0 < self.zeta <= 1:
            raise ValueError(f"zeta = {self.zeta} is outside 0 to 1; two real lags have zeta = 1")
        if self.zeta < 1 and not (second and self.tau1_s == self.tau2_s):
            raise ValueError(f"zeta = {self.zeta}: only type sopdt with tau1 = tau2 can swing")
        if not (0 <= self.tau3_s < math.inf) or (self.tau3_s > 0) != (self.type == ProcessType.TOPDT):
            raise ValueError(f"tau3_s = {self.tau3_s}: type topdt needs one above 0, no other has one")
        side = (self.inverse_s > 0) - (self.inverse_s < 0)
        if not math.isfinite(self.inverse_s) or side != ZERO_SIDE.get(self.type, 0):
            needed = "sopdt-inverse needs one above 0, sopdt-lead one below"
            raise ValueError(f"inverse_s = {self.inverse_s}: type {needed}, no other has one")

    @property
    def slope(self) -> float:
        """Initial slope gain k' = k / tau1 per second (k itself for the other structures)."""
        return self.k / self.tau1_s if self.tau1_s > 0 else self.k

    def seen_by_controller(self, sample_time_s: float) -> "ProcessModel":
        """The process as a sampled controller sees it: half an interval more dead time (Skogestad 2003, section 2)."""
        return replace(self, theta_s=self.theta_s + sample_time_s / 2)

    def linear(self) -> LinearProcess:
        """The model as a general linear process."""
        integrators = {ProcessType.INTEGRATING: 1, ProcessType.INTEGRATING_LAG: 1, ProcessType.DOUBLE_INTEGRATING: 2}
        leads, third = (-self.inverse_s,) if self.inverse_s else (), (self.tau3_s,) if self.tau3_s else ()
        if self.zeta < 1:
            pair = (2 * self.zeta * self.tau1_s, self.tau1_s**2)
            return LinearProcess(self.k, third, leads, self.theta_s, 0, (pair,))
        lags = (*(lag for lag in (self.tau1_s, self.tau2_s) if lag > 0), *third)
        return LinearProcess(self.k, lags, leads, self.theta_s, integrators.get(self.type, 0))

    def without_inverse(self) -> "ProcessModel":
        """An inverse response taken as so much dead time (Skogestad 2003, section 2); other structures as they are."""
        if self.inverse_s < 0:
            # The first order with the same gain at rest that an integral loop cannot tell from it where it lives
            times = (self.inverse_s, *self.lags_s())
            low, high = 0.0, math.pi / max(self.theta_s, NO_TIME * self.tau1_s)
            for _ in range(BISECTIONS):
                w = (low + high) / 2
                lag = w * self.theta_s + sum(math.atan(w * time) for time in times)
                low, high = (w, high) if lag < W_THETA + math.pi / 2 else (low, w)
            slope = high * abs(self.linear().response(np.array([high]))[0])
            k, theta = self.k * max(-self.inverse_s / self.tau1_s, 1.0), max(W_THETA / high, self.theta_s)
            return ProcessModel(ProcessType.FOPDT, k, abs(k) / slope, 0.0, theta)
        if not self.inverse_s:
            return self
        return replace(self, type=ProcessType.SOPDT, theta_s=self.theta_s + self.inverse_s, inverse_s=0.0)

    def of_second_order(self) -> "ProcessModel":
        """An inverse response taken as so much dead time, a third lag by the half rule (Skogestad 2003, section 2)."""
        if not self.tau3_s:
            return self.without_inverse()
        long, middle, short = self.lags_s()
        tau2 = min(middle + short / 2, long)
        return ProcessModel(ProcessType.SOPDT, self.k, long, tau2, self.theta_s + short / 2)

    @property
    def times_s(self) -> dict[str, float]:
        """The time constants that the process has but for its dead time, as people name them; all above 0."""
        zero = "lead" if self.inverse_s < 0 else "inverse"
        lags = {"tau1": self.tau1_s, "tau2": self.tau2_s, "tau3": self.tau3_s, zero: abs(self.inverse_s)}
        return {name: time for name, time in lags.items() if time}

    def lags_s(self) -> tuple[float, ...]:
        """The lags, the longest first; of a pair of complex poles two of half their sum (reduction.py)."""
        pair = (self.zeta * self.tau1_s, self.zeta * self.tau2_s)
        return tuple(sorted((lag for lag in (*pair, self.tau3_s) if lag > 0), reverse=True))

    def to_dict(self) -> dict[str, float | str]:
        """Keys as in every JSON output: type, k, tau1, tau2, theta (seconds); zeta where the process swings,
        inverse where it answers the wrong way first (above 0) or leads (below), tau3 where it has a third lag.
        """
        swings = {"zeta": self.zeta} if self.zeta < 1 else {}
        swings |= {"inverse": self.inverse_s} if self.inverse_s else {}
        swings |= {"tau3": self.tau3_s} if self.tau3_s else {}
        return plain_values(self, "type k tau1=tau1_s tau2=tau2_s theta=theta_s") | swings


# ---- A linear process without its dead time as states:  dx/dt = A x + B v,  y = C x + D v.
#
# Built as a cascade of first and second order sections, each with the zeros that fit into it, so that time
# constants far apart do no harm (a polynomial of high order would lose digits).


@dataclass(frozen=True, slots=True)
class StateSpace:
    """A, B, C of shapes (n, n), (n,), (n,) and the number D; time in units of the builder's choice."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: float


def state_space(process: LinearProcess, unit_s: float) -> StateSpace:
    """The process without its dead time; time counts in units of unit_s seconds.

    Raises ValueError: the process has more zeros than poles, so no real plant can be it.
    """
    # The cascade: fastest poles first, so that rates of the output cancel no digits; slow zeros go to slow poles
    lags = [x / unit_s for x in process.lags_s if x]
    lags = sorted([*lags, *(c1 / unit_s for c1, c2 in process.quadratics if c2 == 0 and c1)])
    pairs = [(1.0, c1 / unit_s, c2 / unit_s**2) for c1, c2 in process.quadratics if c2]
    sections: list[Section] = [((1.0, lag), []) for lag in lags] + [(pair, []) for pair in pairs]
    sections += [((0.0, 1.0), []) for _ in range(process.integrators)]
    zeros = sorted((x / unit_s for x in process.leads_s if x), key=abs, reverse=True)
    for rates, held in reversed(sections):
        held += [zeros.pop(0) for _ in range(min(len(rates) - 1, len(zeros)))]
    if zeros:
        raise ValueError("the process has more zeros than poles: its response to a step is not a function; add lags")
    n = sum(len(section) - 1 for section, _ in sections)
    a, b, c, d = np.zeros((n, n)), np.zeros(n), np.zeros(n), 1.0
    first = 0
    for rates, zeros in sections:
        # Drive a section from the signal c x + d v; the row and number of its output
        last = first + len(rates) - 2
        if last > first:
            a[first, last] = 1.0
        a[last] += c / rates[-1]
        b[last] = d / rates[-1]
        for j, rate in enumerate(rates[:-1]):
            a[last, first + j] -= rate / rates[-1]
        powers = np.array([1.0, sum(zeros), zeros[0] * zeros[1] if len(zeros) == 2 else 0.0])
        c, d = np.zeros(len(b)), 0.0
        c[first] = 1.0
        for order in range(1, len(zeros) + 1):
            if order == len(rates) - 1:  # the highest derivative is the right hand side itself
                c, d = c + powers[order] * a[last], d + powers[order] * b[last]
            else:
                c[first + order] += powers[order]
        first += len(rates) - 1
    gain = process.k * unit_s**process.integrators
    return StateSpace(a, b, gain * c, gain * d)


Section = tuple[tuple[float, ...], list[float]]
"""Denominator coefficients a0 + a1 s (+ a2 s^2), and the zeros' time constants put into the section."""


def exponentials(a: FloatArray) -> FloatArray:
    """e^A of each matrix, shape (n, m, m): Taylor's series of A / 2^s, squared s times (Moler & Van Loan 2003).

    That of scipy goes from matrix to matrix, wakes all threads of its algebra, and takes as long to load as numpy.
    """
    most = float(np.max(np.sum(np.abs(a), axis=2), initial=0.0))
    if not math.isfinite(most):
        return np.full_like(a, math.nan)
    halvings = max(math.ceil(math.log2(most / NORM)), 0) if most > 0.0 else 0
    small, one = a / 2.0**halvings, np.eye(a.shape[1])
    found = one + small / TERMS
    for k in range(TERMS - 1, 0, -1):
        found = one + (small / k) @ found
    for _ in range(halvings):
        found = found @ found
    return np.asarray(found)


NORM, TERMS = 0.5, 14  # the series is taken up to this norm, with so many terms: what is left is below the last digit
