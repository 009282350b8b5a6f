"""What a loop of somebody else's plant truly is: the answer of the plant itself to a step of its controller's output.

The plant stands at rest under the published gains, without noise; then the output is held, and stepped by little. The
other loops go on. Ms and J are worked out from the answer itself (answered.py), J over the best settings. These are
SIMC with perfect knowledge of a process fitted to the answer; where the half rule does not reduce that, the best PI
with Ms 1.6; and where the plant needs more gain than that to stand (an exothermic reactor), the published gains.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from cases.case import FloatArray
from cases.loop import Upsets, run_manual
from online.judge import perfect
from scipy.optimize import least_squares

from plants_of_others.answered import Answered
from plants_of_others.loop import Card, Controlled, Plant, Stepped
from retuner.adaptive.process.model import LinearProcess

POINTS = 600  # Samples of the answer that are fitted
GOOD = 0.01  # Misfit below which no further structure is tried
FLOOR = 0.02  # Share of the largest answer that the shares are taken over at least


@dataclass(frozen=True, slots=True)
class StepTest:
    """How the answer is taken. settle_s : until rest; seconds : of the answer; share : of co's range.

    best : which settings are the best: "simc", "search" or "published".
    """

    settle_s: float
    seconds: float
    share: float = 0.01
    best: str = "simc"


@dataclass(frozen=True, slots=True)
class Truth:
    """process : fitted, for SIMC. misfit : largest deviation as a share of the answer. co0 : output of rest."""

    process: LinearProcess
    misfit: float
    co0: float
    judge: Answered


def answer(plant: Plant, card: Card, test: StepTest) -> tuple[FloatArray, float, float]:
    """pv about rest after a unit step of the output, one value a sample from the step on; the output of rest; dt."""
    settle, n = int(test.settle_s / card.dt_s), int(test.seconds / card.dt_s)
    found = []
    for sign in (1.0, -1.0):
        step = sign * test.share * (card.co_range[1] - card.co_range[0])
        control = Controlled(card, card.published, plant.rest(card.name), watched=False)
        held = Stepped(control, settle, 2, step)
        plant.calm({card.name: held}, (settle + n + 2) * card.dt_s)
        pv = np.asarray(held.track.pv[settle + 2 : settle + 2 + n])
        found.append((pv - pv[0]) / step)
    return (found[0] + found[1]) / 2, held.co0, card.dt_s


def truth(plant: Plant, card: Card, test: StepTest) -> Truth:
    """Of one loop, the others under the gains that they are published with."""
    seen, co0, dt_s = answer(plant, card, test)
    thin = max(1, math.ceil(len(seen) / POINTS))
    process, misfit = fitted(seen[::thin], thin * dt_s)
    best = {"simc": perfect(process, dt_s)[0], "published": card.published}.get(test.best)
    return Truth(process, misfit, co0, Answered(seen, dt_s, best))


def fitted(seen: FloatArray, h_s: float) -> tuple[LinearProcess, float]:
    """The simplest of some structures that fits well, or the best of all."""
    best: tuple[LinearProcess, float] | None = None
    for process in _guesses(seen, h_s):
        found, misfit = _fit(process, seen, h_s)
        if best is None or misfit < best[1] / 2:
            best = found, misfit
        if best[1] < GOOD:
            break
    assert best is not None
    return best


def _guesses(seen: FloatArray, h_s: float) -> Iterator[LinearProcess]:
    n, last = len(seen), float(seen[-1])
    slope = float(seen[-1] - seen[-n // 4]) / (n // 4 * h_s)
    rise = float(np.argmax(np.abs(seen) > 0.63 * abs(last))) * h_s + h_s
    quick = rise / 8
    ramp = slope or last / (n * h_s)
    for lags in (1, 2, 3):
        chain = tuple(rise / 4**i for i in range(lags))
        yield LinearProcess(last, chain, (), quick)
        yield LinearProcess(ramp, chain[1:], (), quick, 1)
    for lead in (-quick, 2 * rise, rise / 3):
        yield LinearProcess(last, (rise, rise / 4, rise / 16), (lead,), quick / 4)
        yield LinearProcess(ramp, (rise, rise / 4), (lead,), quick / 4, 1)
        yield LinearProcess(ramp, (rise, rise / 16, rise / 32), (lead,), quick / 4, 1)
    for slow in (2.0, 8.0):  # the other loops of the plant answer as well
        yield LinearProcess(last, (slow * rise, rise, rise / 4), (slow * rise * 0.8, rise / 2), quick)


def _fit(guess: LinearProcess, seen: FloatArray, h_s: float) -> tuple[LinearProcess, float]:
    size, lags = np.abs(seen) + FLOOR * float(np.max(np.abs(seen))), len(guess.lags_s)

    def process(z: FloatArray) -> LinearProcess:
        times = np.exp(np.clip(z[1 : lags + 1], math.log(h_s) - 5, math.log(h_s * len(seen)) + 3))
        leads = tuple(float(x) * h_s for x in z[lags + 2 :])
        theta = float(np.exp(np.clip(z[lags + 1], -12, math.log(len(seen)))) * h_s)
        k = float(z[0]) * guess.k
        return LinearProcess(
            k or guess.k, tuple(sorted(map(float, times), reverse=True)), leads, theta, guess.integrators
        )

    def missing(z: FloatArray) -> FloatArray:
        return np.asarray((step_answer(process(z), h_s, len(seen)) - seen) / size)

    z0 = [1.0, *np.log(guess.lags_s), math.log(max(guess.theta_s / h_s, 0.1)), *(x / h_s for x in guess.leads_s)]
    found = least_squares(missing, np.asarray(z0), x_scale="jac", max_nfev=200)
    return process(found.x), float(np.max(np.abs(found.fun)))


def step_answer(process: LinearProcess, h_s: float, n: int) -> FloatArray:
    """After a unit step of the input at the first sample."""
    co = np.ones(n + 1)
    co[0] = 0.0
    return np.asarray(run_manual(process, h_s, co, Upsets(np.zeros(n + 1))).pv[1:])


def steps(values: list[float]) -> float:
    """Total variation."""
    return sum(abs(b - a) for a, b in pairwise(values))
