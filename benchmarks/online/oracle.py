"""What could be known of a loop that sees loads only: the Cramer-Rao bound of the settings, for the loads of loads.py.

The oracle knows the structure of the process (second order at most), the controller, and what kind of load enters the
process' input; unknown to it are gain, dead time and lags, how strong the load and the noise are, and a coloured load's
lag. Two things tell it of the process: pv's spectrum under feedback, and a known step of the setpoint, if there is one.

    pv = T r + S (G d + n),   T = G C S,   S = 1/(1 + G C)
    I_ij = 1/2 sum (d ln phi/di)(d ln phi/dj) + 2 Re sum (dT/di r)(dT/dj r)* / (N phi)      (Whittle 1953)

with phi the spectrum of S (G d + n). That is the information of the direct prediction-error method with the right noise
model (Forssell & Ljung 1999). No estimator without other knowledge does better: where the bound of ln Kc or ln ki is
over 0.25, settings in spec are luck. A sinusoid of unknown size and phase tells nothing, for it has as many unknowns.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from cases.best import half_rule, later, simc_of
from cases.case import FloatArray
from cases.processes import FAMILIES, log_uniform
from cases.setting import draw_loop, scaled

from online.batch import NOISE, SAMPLES_PER_THETA, STARTS
from online.counting import counted
from online.judge import Judge
from online.loads import CALM, LENGTH_THETA, PERIODS
from retuner.adaptive.nudge.planner import HOLDS
from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains

Row = dict[str, Any]
Complex = npt.NDArray[np.complex128]
KINDS = ("walk", "coloured", "calm walk", "calm coloured")
KNOWN = 0.25
"""Standard deviation of ln Kc and ln ki with which settings may come out in spec."""
STEP = 1e-4
BUMP_THETA = 20.0
HALF_THETA = 1.6
"""Dead times in which the error after a setpoint step falls to half, where the gain is the best one."""
MOVES = {"one": (BUMP_THETA / HALF_THETA,), "even": (sum(HOLDS) / 5,) * 5, "uneven": HOLDS}
"""Times for which the setpoints of a bump are held, in such times: one to one side, five at even times, as they are."""
PV_SPAN = 10.0


@dataclass(frozen=True, slots=True)
class Task:
    """One loop. bump : of the setpoint once a period, percent of pv's range, or 0. moves : of MOVES."""

    kind: str
    seed: int
    index: int
    bump: float = 0.0
    moves: str = "one"


@dataclass(frozen=True, slots=True)
class Seen:
    """One period as the oracle meets it. load : spectrum's size. corner : of a coloured load, samples; 0 for a walk."""

    process: LinearProcess
    gains: PidGains
    dt_s: float
    load: float
    corner: float
    r: FloatArray


def run(task: Task) -> Row:
    """One loop; keys known (the larger of both standard deviations after each period)."""
    rng = np.random.default_rng([task.seed, task.index, 43])
    loop = draw_loop(rng, str(rng.choice(FAMILIES)), (SAMPLES_PER_THETA, SAMPLES_PER_THETA + 1e-9))
    kc, tau_i = STARTS[int(rng.integers(len(STARTS)))]
    while not loop.margins(scaled(loop.best, kc, tau_i)).stable:
        kc, tau_i = STARTS[int(rng.integers(len(STARTS)))]
    slow = max(1.0, 1 / kc)
    n = int(LENGTH_THETA * SAMPLES_PER_THETA * slow)
    r = _moved(n, MOVES[task.moves], HALF_THETA * SAMPLES_PER_THETA * slow, task.bump / 100 * PV_SPAN)
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    size = judge.load_like_setpoint() * (CALM if task.kind.startswith("calm") else 1.0)
    walks = task.kind.endswith("walk")
    corner = 0.0 if walks else log_uniform(rng, 1.0, 10.0) * SAMPLES_PER_THETA
    load = size * (0.3 / math.sqrt(SAMPLES_PER_THETA) if walks else 0.7)
    known = bound(Seen(_reduced(loop.process), scaled(loop.best, kc, tau_i), loop.dt_s, load, corner, r))
    return {
        "part": "oracle",
        "kind": task.kind,
        "bump": task.bump,
        "moves": task.moves,
        "seed": task.seed,
        "index": task.index,
        "known": [known / math.sqrt(i + 1) for i in range(PERIODS)],
    }


def _moved(n: int, holds: tuple[float, ...], half: float, size: float) -> FloatArray:
    """The setpoint of a period, shape (n,): from a tenth of it on to one side and the other. half : samples."""
    r, at = np.zeros(n), n // 10
    for i, hold in enumerate(holds):
        r[at : at + round(hold * half)] = size if i % 2 == 0 else -size
        at += round(hold * half)
    return r


def bound(seen: Seen) -> float:
    """Smallest standard deviation of ln Kc or ln ki, the larger of both, from one period."""
    unknowns = 2 + len(seen.process.lags_s)
    free = unknowns + 3
    slopes = [_difference(seen, e) for e in np.eye(free) * STEP]
    _, phi = _told(seen, np.zeros(free))
    by_step = np.array([s for s, _ in slopes]) / np.sqrt(np.exp(phi) * len(seen.r))
    by_colour = np.array([s for _, s in slopes])
    information = 2 * np.real(by_step @ by_step.conj().T) + by_colour @ by_colour.T
    covariance = np.linalg.pinv(information, rcond=1e-13)[:unknowns, :unknowns]
    found = []
    for name in ("kp", "ki"):
        g = np.array([_ln(seen, e, name) - _ln(seen, -e, name) for e in np.eye(unknowns) * STEP]) / (2 * STEP)
        found.append(math.sqrt(float(g @ covariance @ g)))
    return max(found)


def _difference(seen: Seen, e: FloatArray) -> tuple[Complex, FloatArray]:
    (up, above), (down, below) = _told(seen, e), _told(seen, -e)
    return (up - down) / (2 * STEP), (above - below) / (2 * STEP)


def _told(seen: Seen, p: FloatArray) -> tuple[Complex, FloatArray]:
    """T r, and ln phi, with the logarithms of all unknowns moved by p."""
    n, dt = len(seen.r), seen.dt_s
    w = 2 * np.pi * np.arange(1, n // 2) / n
    z, s = np.exp(1j * w), 1j * w / dt
    lags = 2 + len(seen.process.lags_s)
    g = _response(_varied(seen.process, p[:lags]), s) * (1 - 1 / z) / (s * dt)
    c = seen.gains.kp + seen.gains.ki * dt / (1 - 1 / z)
    pole = math.exp(-1 / (seen.corner * math.exp(p[lags + 2]))) if seen.corner else 1.0
    size = (1 - pole**2) if seen.corner else 1.0
    load = seen.load**2 * size * math.exp(p[lags]) / np.abs(1 - pole / z) ** 2
    phi = (np.abs(g) ** 2 * load + NOISE**2 * math.exp(p[lags + 1])) / np.abs(1 + g * c) ** 2
    return g * c / (1 + g * c) * np.fft.fft(seen.r)[1 : n // 2], np.log(phi)


def _response(process: LinearProcess, s: Complex) -> Complex:
    g = process.k * np.exp(-process.theta_s * s) / s**process.integrators
    for lag in process.lags_s:
        g = g / (1 + lag * s)
    return np.asarray(g, dtype=np.complex128)


def _varied(process: LinearProcess, p: FloatArray) -> LinearProcess:
    f = [float(x) for x in np.exp(p)]
    lags = tuple(lag * x for lag, x in zip(process.lags_s, f[2:], strict=True))
    return replace(process, k=process.k * f[0], theta_s=process.theta_s * f[1], lags_s=lags)


def _ln(seen: Seen, p: FloatArray, name: str) -> float:
    model = later(half_rule(_varied(seen.process, p)), seen.dt_s / 2)
    return math.log(abs(getattr(simc_of(model, model.theta_s), name)))


def _reduced(process: LinearProcess) -> LinearProcess:
    """The process with two lags at most: no oracle could know more of them."""
    model = half_rule(process, 2)
    lags = tuple(lag for lag in (model.tau1_s, model.tau2_s) if lag)
    return LinearProcess(process.k, lags, (), model.theta_s, process.integrators)


def tasks(seed: int, count: int, bump: float, moves: str = "one") -> list[Task]:
    """The first `count` loops of every kind."""
    return [Task(kind, seed, index, bump, moves) for kind in KINDS for index in range(count)]


def line(row: Row) -> str:
    """A loop for people."""
    return f"{row['kind']:<14}{row['index']:>4} " + " ".join(f"{x:.2f}" for x in row["known"])


def table(rows: list[Row]) -> list[str]:
    """Shares that could be known after 1, 3 and 6 periods."""
    lines = []
    for kind in KINDS:
        of = [row for row in rows if row["kind"] == kind]
        for after in (1, 3, 6) if of else ():
            good = sum(row["known"][after - 1] <= KNOWN for row in of)
            lines.append(f"{kind:<14} known to {KNOWN:g} after {after}  {counted(good, len(of))}")
    return lines
