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
    loops = list(loops)
    for i, p in enumerate(loop.process for loop in loops):
        if not (p.integrators or p.lags_s or p.quadratics):  # a pure dead time is one with a short lag
            loops[i] = replace(loops[i], process=replace(p, lags_s=(LEAST_LAG * p.theta_s or 1.0,)))
    steps = [SPAN / (POINTS * crossover(loop)) for loop in loops]
    made = _Lanes(loops, steps, upsets)
    e, u = made.run()
    n = len(upsets)
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


class _Lanes:
    """All loops under all upsets, side by side; arrays of shape (lanes,) or (states, lanes)."""

    def __init__(self, loops: Sequence[ClosedLoop], steps: Sequence[float], upsets: Sequence[Upset]) -> None:
        n = len(upsets)
        # phi (states, states, lanes), Gamma, B and C (states, lanes), each process n times; states padded to the most
        spaces = [state_space(loop.process, step) for loop, step in zip(loops, steps, strict=True)]
        most = max(len(space.b) for space in spaces)
        whole = np.zeros((len(loops), most + 1, most + 1))
        c = np.zeros((most, len(loops)))
        for i, space in enumerate(spaces):
            m = len(space.b)
            whole[i, :m, :m], whole[i, :m, most], c[:m, i] = space.a, space.b, space.c
        moved = exponentials(whole)
        phi, gamma, b = moved[:, :most, :most], moved[:, :most, most], whole[:, :most, most]
        spread = (
            np.repeat(phi, n, axis=0).transpose(1, 2, 0),
            np.repeat(gamma, n, axis=0).T,
            np.repeat(b, n, axis=0).T,
        )
        self.phi, self.gamma, start, self.c = *spread, np.repeat(c, n, axis=1)
        h = np.repeat(steps, n)
        gains = [loop.gains for loop in loops]
        self.kp = np.repeat([g.kp for g in gains], n)
        self.ki = np.repeat([g.ki for g in gains], n) * h
        filter_s = np.maximum(np.repeat([loop.tau_f_s for loop in loops], n), h)
        self.kd = np.repeat([g.kd for g in gains], n) / filter_s
        self.follow = -np.expm1(-h / filter_s)
        self.b = np.repeat([loop.b for loop in loops], n)
        self.r, self.loads, pulse = (
            np.tile([getattr(upset, name) for upset in upsets], len(loops))
            for name in ("setpoint", "load_step", "pulse")
        )
        self.x = start * pulse / h
        delay = np.maximum(np.repeat([loop.process.theta_s for loop in loops], n) / h - 0.5, 0.0)
        self.whole = delay.astype(np.int64)
        self.share = delay - self.whole
        self.lead = int(np.max(self.whole)) + 2

    def run(self) -> tuple[FloatArray, FloatArray]:
        """Errors and controller outputs, shape (POINTS + 1, lanes)."""
        whole = all(np.isfinite(part).all() for part in (self.phi, self.gamma, self.c, self.x))
        if (engine := compiled()) is not None and whole:
            laws = (self.kp, self.ki, self.kd, self.follow, self.b, self.r, self.loads, self.whole, self.share)
            e, u = engine.closed((self.phi, self.gamma, self.c, self.x), np.column_stack(laws), LIMIT, POINTS + 1)
            return e, u
        lanes = np.arange(len(self.kp))
        e, u = np.zeros((POINTS + 1, len(lanes))), np.zeros((POINTS + 1 + self.lead, len(lanes)))
        z, filtered = np.zeros(len(lanes)), np.zeros(len(lanes))
        for i in range(POINTS + 1):
            y = np.sum(self.c * self.x, axis=0)
            e[i] = self.r - y
            if i:
                z += 0.5 * (e[i] + e[i - 1])
            raw = self.kp * (self.b * self.r - y) + self.ki * z - self.kd * (y - filtered)
            filtered += self.follow * (y - filtered)
            at = i + self.lead
            u[at] = np.clip(raw, -LIMIT, LIMIT)
            row = at - self.whole
            arrives = (1 - self.share) * u[row, lanes] + self.share * u[row - 1, lanes] + self.loads
            self.x = np.einsum("ijn,jn->in", self.phi, self.x) + self.gamma * arrives
        return e, u[self.lead :]
