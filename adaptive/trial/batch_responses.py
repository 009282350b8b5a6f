"""Responses of many closed loops at once, on few points: what a promise is worked out from.

    x+ = Phi x + Gamma (u(t - theta) + d),   u = kp (b r - y) + ki integral(r - y) - kd dy_f/dt

Each loop in its own unit of time, SPAN over its highest gain crossover in POINTS steps, so that one vectorised loop
over the points serves all of them. The hold of u over a step is half a step of dead time, which is taken off theta.
performance.py is exact, for one loop at a time, and takes as long for one as this for all.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.process.model import LinearProcess, exponentials, state_space
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

SPAN = 60.0
"""Length of a response over the inverse of the gain crossover: some nine swings of a loop that all but swings."""
POINTS = 800  # Steps; one is 0.075 over the gain crossover, so 2 degrees of phase there
GRID = 241  # frequencies at which the gain crossover is looked for, over eight decades round the loop's own times
LIMIT = 1e12  # where u stops growing: only so that the numbers of a loop that runs away stay finite
LEAST_LAG = 0.05  # A process without states gets a lag of this share of its dead time


@dataclass(frozen=True, slots=True)
class Upset:
    """What starts a response at time 0: a step of the setpoint, of the load at the process input, a pulse of it."""

    setpoint: float = 0.0
    load_step: float = 0.0
    pulse: float = 0.0

    def rest(self, process: LinearProcess) -> float:
        """Controller output at rest after it."""
        return (0.0 if process.integrators else self.setpoint / process.k) - self.load_step


@dataclass(frozen=True, slots=True)
class Trace:
    """One response: step_s, the error and the controller output at its points, each of shape (POINTS + 1,).

    rest_u : controller output at rest in the end, as the process says.
    """

    step_s: float
    e: FloatArray
    u: FloatArray
    rest_u: float


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """A process under a controller; b is the setpoint weight, tau_f_s the derivative's filter time."""

    process: LinearProcess
    gains: PidGains
    b: float = 1.0
    tau_f_s: float = 0.0


def traces(loops: Sequence[ClosedLoop], upsets: Sequence[Upset]) -> list[list[Trace]]:
    """The response of every loop to every upset: [loop][upset]."""
    loops, n = list(loops), len(upsets)
    for i, p in enumerate(loop.process for loop in loops):
        if not (p.integrators or p.lags_s or p.quadratics):  # a pure dead time is one with a short lag
            loops[i] = replace(loops[i], process=replace(p, lags_s=(LEAST_LAG * p.theta_s or 1.0,)))
    steps = [SPAN / (POINTS * crossover(loop)) for loop in loops]
    # All loops under all upsets are lanes side by side: phi (states, states, lanes), Gamma, C and the start (states,
    # lanes), each process n times, its states padded to the most
    spaces = [state_space(loop.process, step) for loop, step in zip(loops, steps, strict=True)]
    most = max(len(space.b) for space in spaces)
    whole, c = np.zeros((len(loops), most + 1, most + 1)), np.zeros((most, len(loops)))
    for i, space in enumerate(spaces):
        m = len(space.b)
        whole[i, :m, :m], whole[i, :m, most], c[:m, i] = space.a, space.b, space.c
    moved, h = exponentials(whole), np.repeat(steps, n)
    gamma, b = (np.repeat(part[:, :most, most], n, axis=0).T for part in (moved, whole))
    r, loads, pulse = (
        np.tile([getattr(upset, name) for upset in upsets], len(loops)) for name in ("setpoint", "load_step", "pulse")
    )
    phi = np.repeat(moved[:, :most, :most], n, axis=0).transpose(1, 2, 0)
    states = phi, gamma, np.repeat(c, n, axis=1), b * pulse / h
    # Each lane's law in its own unit of time, shape (lanes,); its dead time as whole steps and a share of one
    kp, ki, kd = (np.repeat([getattr(loop.gains, name) for loop in loops], n) for name in ("kp", "ki", "kd"))
    filter_s = np.maximum(np.repeat([loop.tau_f_s for loop in loops], n), h)
    delay = np.maximum(np.repeat([loop.process.theta_s for loop in loops], n) / h - 0.5, 0.0)
    weight, late = np.repeat([loop.b for loop in loops], n), np.floor(delay)
    laws = kp, ki * h, kd / filter_s, -np.expm1(-h / filter_s), weight, r, loads, late, delay - late
    if (engine := compiled()) is not None and all(np.isfinite(part).all() for part in states):
        e, u = engine.closed(states, np.column_stack(laws), LIMIT, POINTS + 1)
    else:
        e, u = _stepped(*states, laws)
    return [
        [Trace(steps[i], e[:, i * n + j], u[:, i * n + j], upset.rest(loop.process)) for j, upset in enumerate(upsets)]
        for i, loop in enumerate(loops)
    ]


@lru_cache(maxsize=64)  # each loop stands in several batches of a decision
def crossover(loop: ClosedLoop) -> float:
    """Highest frequency at which the loop's gain is 1, rad/s, on a grid: a scale, not a margin."""
    p, g = loop.process, loop.gains
    times = [x for x in (p.theta_s, *p.lags_s, *(c2**0.5 for _, c2 in p.quadratics)) if x > 0]
    times += [g.kp / g.ki] if g.ki and g.kp else []
    middle = float(np.exp(np.mean(np.log(times)))) if times else 1.0
    w = np.logspace(-4, 4, GRID) / middle
    s = 1j * w
    gain = np.abs(p.response(w) * (g.kp + g.ki / s + g.kd * s / (1 + loop.tau_f_s * s)))
    over = np.flatnonzero(gain >= 1.0)
    return float(w[over[-1]] if over.size else w[0])


def _stepped(
    phi: FloatArray, gamma: FloatArray, c: FloatArray, x: FloatArray, laws: tuple[FloatArray, ...]
) -> tuple[FloatArray, FloatArray]:
    """Errors and controller outputs, shape (POINTS + 1, lanes), without the compiled engine."""
    kp, ki, kd, follow, weight, r, loads, late, share = laws
    whole, lanes = late.astype(np.int64), np.arange(len(kp))
    lead = int(np.max(whole)) + 2
    e, u = np.zeros((POINTS + 1, len(lanes))), np.zeros((POINTS + 1 + lead, len(lanes)))
    z, filtered = np.zeros(len(lanes)), np.zeros(len(lanes))
    for i in range(POINTS + 1):
        y = np.sum(c * x, axis=0)
        e[i] = r - y
        if i:
            z += 0.5 * (e[i] + e[i - 1])
        raw = kp * (weight * r - y) + ki * z - kd * (y - filtered)
        filtered += follow * (y - filtered)
        at = i + lead
        u[at] = np.clip(raw, -LIMIT, LIMIT)
        row = at - whole
        arrives = (1 - share) * u[row, lanes] + share * u[row - 1, lanes] + loads
        x = np.einsum("ijn,jn->in", phi, x) + gamma * arrives
    return e, u[lead:]
