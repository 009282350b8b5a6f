"""The processes that a record is compared with, on one grid for all records of a loop, and how a controller does there.

    G(s) = K e^(-theta s) / ((tau1 s + 1) (tau2 s + 1)),      K' e^(-theta s) / (s (tau2 s + 1)) where tau1 has no end
    G(s) = K e^(-theta s) / ((tau1 s - 1) (tau2 s + 1))       where it runs away by itself; tau1 is written negative

Lags and dead times are in samples, so the grid is one constant. The gain is a grid too, spaced evenly in its logarithm
and counted in loop gains: kc K = 1 is its middle. A grid and no search: every corner of what the record allows is seen,
likelihoods of several records add up point by point, and nothing can stop in a local optimum.

Half a sampling interval counts as dead time, as a sampled controller sees the process (Franklin et al. 1998).

What the grid lacks is not the same for each hypothesis that is compared on it: where little else is left, a lag of 9.5
samples for one of 10 is e^100, and passes for a valve. `nearest` gives each the process that suits it best, by a search
of patterns (Hooke & Jeeves 1961) from its likeliest points: all have the same freedom, and it has no price.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import numpy.typing as npt

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

BoolArray = npt.NDArray[np.bool_]
ComplexArray = npt.NDArray[np.complex128]

LAGS = (0.5, 1.0, 2.0, 3.0, 4.5, 7.0, 10.0, 15.0, 22.0, 33.0, 50.0, 80.0, 130.0, 250.0, math.inf)
"""First lag in samples; without end the process integrates."""
RUNAWAY_LAGS = (-8.0, -16.0, -33.0, -66.0, -130.0)
"""Lags of processes that run away, each growing by a factor of e in so many samples. The book has them."""
SECOND_SHARES = (0.0, 0.15, 0.4, 0.8)  # second lag as a share of the first
SHORT, LONG, BEHIND_VAST = 2.5, 50.0, (0.0, 2.5, 8.0, 25.0)
"""A short second lag, samples, and the first lag from which it is tried besides: valve, pipe and sensor know nothing of
how large a tank is. And all second lags of a first one over twice as long, or without end.
"""
LEAST_SECOND = 0.6  # A second lag that is shorter (in samples) cannot be seen
DEAD_TIMES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 13.0, 17.0, 25.0, 40.0, 63.0, 100.0, 160.0)
"""Dead times of the grid, in samples. A loop that is sampled finely may have one far longer than its integral time."""
GAINS = np.logspace(-2.5, 2.5, 61)
"""Loop gains kc K of the grid, a fifth apart; of an integrating process kc K' times INTEGRATING samples."""
INTEGRATING = 20.0
FREQUENCIES = np.logspace(math.log10(3e-4), math.log10(math.pi), 90)  # Where margins are computed, rad per sample
HALF_TURN = 1e-9 - math.pi
"""Phase of the stability limit, with the digits that sums of phases lose: a lag that is cancelled ends there."""


@dataclass(frozen=True, slots=True)
class ProcessShape:
    """A process but for its gain and dead time. lag, second : in samples; lag without end where it integrates, negative
    where it runs away.
    """

    lag: float
    second: float

    @property
    def integrates(self) -> bool:
        """Whether it has no steady state."""
        return math.isinf(self.lag)

    @property
    def unit(self) -> float:
        """What a loop gain of one is of this shape's gain: a slope gain is counted per INTEGRATING samples."""
        return 1.0 / INTEGRATING if self.integrates else 1.0


@cache
def second_lags(lag: float) -> tuple[float, ...]:
    """The second lags of a first one, zero first; in samples."""
    if lag > 2.0 * LONG:
        return BEHIND_VAST
    shares, short = SECOND_SHARES if lag > 0 else SECOND_SHARES[:2], (SHORT,) if lag >= LONG else ()
    return (0.0, *short, *(share * abs(lag) for share in shares[1:] if share * abs(lag) >= LEAST_SECOND))


@cache
def shapes(lags: tuple[float, ...] = LAGS) -> tuple[ProcessShape, ...]:
    """All shapes, in the order of every array of the grid. lags : EVERY_LAG adds those that run away, at the end."""
    return tuple(ProcessShape(lag, second) for lag in lags for second in second_lags(lag))


EVERY_LAG = (*LAGS, *RUNAWAY_LAGS)


@cache
def units(lags: tuple[float, ...] = LAGS) -> FloatArray:
    """The unit of each shape's gain, shape (shapes, 1, 1)."""
    return np.array([shape.unit for shape in shapes(lags)])[:, None, None]


@cache
def _responses() -> ComplexArray:
    """Frequency responses at gain one, complex, shape (shapes of every lag, dead times, frequencies)."""
    s = 1j * FREQUENCIES
    delays = np.exp(-s * (np.array(DEAD_TIMES)[:, None] + 0.5))
    rows = []
    for shape in shapes(EVERY_LAG):
        first = 1.0 / s if shape.integrates else 1.0 / (abs(shape.lag) * s + math.copysign(1.0, shape.lag))
        rows.append(shape.unit * first / (shape.second * s + 1.0) * delays)
    return np.array(rows)


@cache
def _phases() -> FloatArray:
    """Phases of these responses, falling from that at rest: 0, -90 degrees (integrating), -180 (runs away)."""
    phase = np.unwrap(np.angle(_responses()), axis=2)
    return np.asarray(phase - np.where(phase[:, :, :1] > 0.5 * math.pi, 2.0 * math.pi, 0.0))


def loop_phases(rows: npt.NDArray[np.intp], dead: npt.NDArray[np.intp], law: ComplexArray) -> FloatArray:
    """Phases of loops, shape (n, frequencies); they may begin below -180 degrees, where no gain is stable."""
    return np.asarray(_phases()[rows, dead] + np.angle(law))


def responses_of(rows: npt.NDArray[np.intp], dead: npt.NDArray[np.intp]) -> ComplexArray:
    """Frequency responses of some shapes and dead times at loop gain one, shape (n, frequencies)."""
    return _responses()[rows, dead]


def control_law(gains: PidGains, sample_time_s: float) -> ComplexArray:
    """C(jw) of a controller whose gain is positive, shape (frequencies,); within 90 degrees."""
    s, dt = 1j * FREQUENCIES, sample_time_s
    return np.asarray(abs(gains.kp) + abs(gains.ki) * dt / s + abs(gains.kd) / dt * s, dtype=np.complex128)


def iae_over_ie(responses: ComplexArray, law: ComplexArray) -> FloatArray:
    """IAE over the integral of the error after a load step, ln, at least 0; shape (n,). A loop that swings, or has too
    much integral action for its gain, passes the setpoint on its way back.

    responses, law : of stable loops, shape (n, frequencies), (frequencies,). The integral of the error is 1/ki,
    whatever the process (Astrom & Hagglund 2006, section 4.3).
    """
    to_times, weights = _inverse()
    error = responses / (1j * FREQUENCIES * (1.0 + responses * law))  # after a unit step in the load
    integral = 1.0 / (1j * FREQUENCIES[0] * law[0]).real
    return np.asarray(np.maximum(np.log(np.abs(error.real @ to_times) @ weights / integral), 0.0))


def apart(log: LogModel, temper: float, gain_unit: float, sample_time_s: float) -> FloatArray:
    """d^2 of every process of the grid from a fitted one, of the nearest 0; shape (shapes, dead times, gains).

    d are the differences of ln |G(jw)| and arg G(jw) at SEEN_AT, over how well the record tells them: -d^2/2 is the
    likelihood of the fit around its optimum (Laplace), in what a loop sees of a process. A fit lies between the points
    of the grid, and the nearest one stands for it; one outside the grid has none.

    log : the fitted process, with the covariance of its record. temper : by which that grows. gain_unit,
    sample_time_s : in which loop gains and times of the grid are counted.
    """

    def seen(model: ProcessModel, at: FloatArray = FREQUENCIES) -> FloatArray:
        response = log.sign * model.seen_by_controller(sample_time_s).linear().response(at / sample_time_s)
        return np.array([np.log(np.abs(response)), np.unwrap(np.angle(response))])

    turned = seen(log.model())[1]
    crossover = FREQUENCIES[min(int(np.sum(turned > -math.pi)), len(FREQUENCIES) - 1)]
    index = np.unique(np.clip(np.searchsorted(FREQUENCIES, np.array(SEEN_AT) * crossover), 0, len(FREQUENCIES) - 1))
    at = FREQUENCIES[index]
    fitted = seen(log.model(), at)
    spread = temper * log.covariance_of(lambda model: seen(model, at).ravel()) + COARSE**2 * np.eye(fitted.size)
    grid = responses_of(*np.indices((len(shapes(EVERY_LAG)), len(DEAD_TIMES))))[..., index]
    angle = (np.angle(grid) - fitted[1] + math.pi) % (2.0 * math.pi) - math.pi
    off = np.concatenate([np.log(np.abs(grid)) - fitted[0], angle], axis=-1)
    inverse, gain = np.linalg.inv(spread), np.log(GAINS / gain_unit)
    size = inverse[: len(at)].sum(axis=0)  # a gain adds the same to each ln |G|
    more = 2.0 * (off @ size)[..., None] + gain * float(size[: len(at)].sum())
    found = np.sum(off @ inverse * off, axis=-1)[..., None] + gain * more
    return np.asarray(found - min(float(np.min(found)), BETWEEN))


SEEN_AT = (0.33, 0.67, 1.0)  # frequencies at which processes are compared, as shares of the phase crossover
COARSE = 0.1  # standard deviation of ln |G| and arg G by which a process of the grid stands for those around it
BETWEEN = 9.0  # d^2 of the nearest up to which a fit lies between the points: of 280 drawn on the grid, 8 at the most


TIMES = np.geomspace(0.5, 8000.0, 64)  # samples after a step, for its integral


@cache
def _inverse() -> tuple[FloatArray, FloatArray]:
    """What takes the real part of a response at FREQUENCIES to TIMES, 2/pi integral Re E cos(wt) dw with E linear from
    one frequency to the next (Filon 1928), and the weights of TIMES in an integral over them.
    """
    cosines, steps = np.cos(np.outer(FREQUENCIES, TIMES)), np.diff(TIMES)
    slopes = np.diff(cosines, axis=0) / np.diff(FREQUENCIES)[:, None] / TIMES**2
    parts = np.zeros_like(cosines)
    parts[1:] += slopes
    parts[:-1] -= slopes
    parts[-1] += np.sin(FREQUENCIES[-1] * TIMES) / TIMES
    weights = (np.append(steps, 0.0) + np.append(TIMES[0], steps)) / 2.0
    return 2.0 / math.pi * parts, weights


def gain_unit(gains: PidGains, sample_time_s: float) -> float:
    """What loop gains are counted by: kp; of a controller without one, what its other actions do in ten samples."""
    kp, ki, kd = abs(gains.kp), abs(gains.ki) * 10 * sample_time_s, abs(gains.kd) / (10 * sample_time_s)
    return kp or max(ki, kd)


@dataclass(frozen=True, slots=True)
class LoopRobustness:
    """How robust a controller is on every process of the grid; arrays of shape (shapes, dead times, gains).

    ms : largest sensitivity, infinite where the loop is unstable. swing : frequency at which the loop comes nearest to
        -1, rad per sample; of an unstable one that of the largest gain that is stable. ultimate : the loop gain at
        which it becomes unstable, shape (shapes, dead times, 1); zero where no gain is stable. scale : loop gains are
        counted in it.
    """

    ms: FloatArray
    swing: FloatArray
    ultimate: FloatArray
    scale: float

    @property
    def gain_margin(self) -> FloatArray:
        """How many times as much gain makes the loop unstable."""
        return np.asarray(self.ultimate / (GAINS * self.scale), dtype=np.float64)

    def room(self, limit: float) -> FloatArray:
        """How many times as much gain keeps Ms under a limit, at most; under one where it is over it already."""
        good = self.ms < limit
        last = len(GAINS) - 1 - np.argmax(good[:, :, ::-1], axis=2)
        most = np.where(good.any(axis=2), GAINS[last], GAINS[0] / 10)
        return np.asarray(most[:, :, None] / GAINS, dtype=np.float64)


def robustness(gains: PidGains, sample_time_s: float, unit: float | None = None) -> LoopRobustness:
    """What gains do on every process of the grid.

    unit : what loop gains are counted by (gain_unit of the gains with which the record was compared); None: their own.
    """
    own = gain_unit(gains, sample_time_s)
    law = control_law(gains, sample_time_s) / own
    loop = _responses()[: len(shapes())] * law
    size, phase = np.abs(loop), _phases()[: len(shapes())] + np.angle(law)
    ultimate = _ultimate(size, phase)[:, :, None]
    scale = own / (own if unit is None else unit)
    longest = np.argsort(-ultimate, axis=None)  # those that stay stable longest come first: the others need no margin
    loop, limits = loop.reshape(-1, len(FREQUENCIES))[longest], ultimate.ravel()[longest]
    ms, swing = np.full((len(loop), len(GAINS)), np.inf), np.zeros((len(loop), len(GAINS)))
    for i, gain in enumerate(GAINS * scale):
        stable, rows = int(np.sum(limits > gain)), np.arange(len(loop))
        away = np.abs(1.0 + gain * loop[:stable])
        at = np.argmin(away, axis=1)
        swing[:, i] = swing[:, i - 1] if i else 0.0
        ms[longest[:stable], i], swing[longest[:stable], i] = 1.0 / away[rows[:stable], at], FREQUENCIES[at]
    form = (*size.shape[:2], len(GAINS))
    return LoopRobustness(ms.reshape(form), swing.reshape(form), ultimate, scale)


def _ultimate(size: FloatArray, phase: FloatArray) -> FloatArray:
    """The loop gain at the stability limit, where the phase first passes -180 degrees.

    Shape of the arguments without the last axis.
    """
    falls = (phase[..., :-1] > HALF_TURN) & (phase[..., 1:] <= HALF_TURN)
    first = np.argmax(falls, axis=-1)[..., None]
    before, after = (np.take_along_axis(phase, first + i, -1) for i in (0, 1))
    share = np.clip((before - HALF_TURN) / np.where(before == after, 1.0, before - after), 0.0, 1.0)
    below, above = (np.log(np.take_along_axis(size, first + i, -1)) for i in (0, 1))
    at_limit = np.exp(-(below * (1 - share) + above * share))[..., 0]
    found = np.where(falls.any(axis=-1), at_limit, np.inf)
    return np.asarray(np.where(phase[..., 0] <= HALF_TURN, 0.0, found), dtype=np.float64)


LATER = np.arange(-4.0, 5.0) / 2.0  # dead times that are tried at once, samples
STEP, SECOND_STEP = 0.25, 0.4  # steps of the logarithms of lags
LEAST_TRIED, ENDLESS = 0.1, 300.0  # a shorter second lag is none; a first one that is tried beside one without end
FINER, FINEST, ENOUGH, ROUNDS = 0.4, 0.02, 0.1, 24
"""Steps become so much finer where none gains ENOUGH, down to FINEST; rounds at the most."""

Told = Callable[[float, tuple[float, ...], Sequence[float]], FloatArray]
"""What a first lag says with each second lag and dead time, shape (second lags, dead times)."""


@dataclass(frozen=True, slots=True)
class Nearest:
    """A process but for its gain: lags and dead time in samples, a second lag of 0 is none. told : what it says."""

    told: float
    lag: float
    second: float
    dead: float


def likeliest(told: FloatArray, lag: float, seconds: Sequence[float], dead: Sequence[float]) -> Nearest:
    """The one of which the most is told. told : shape (second lags, dead times)."""
    i, j = divmod(int(np.argmax(told)), len(dead))
    return Nearest(float(told.max()), lag, seconds[i], dead[j])


def nearest(told: Told, start: Nearest, enough: float, latest: float) -> Nearest:
    """The process near a start of which the most is told. enough : what a step has to gain. latest : dead time."""
    best, step = replace(start, told=-math.inf), 1.0
    for _ in range(ROUNDS):
        before = best.told
        dead = tuple(one for one in (best.dead + step * LATER).tolist() if 0.0 <= one <= latest)
        lags = [best.lag * math.exp(step * STEP * way) for way in (-1.0, 0.0, 1.0)]
        if math.isinf(best.lag):
            lags = [best.lag, ENDLESS] if step == 1.0 else [best.lag]
        times, middle = math.exp(step * SECOND_STEP), max(best.second, LEAST_TRIED)
        seconds = tuple(dict.fromkeys((0.0, middle / times, middle, middle * times)))
        for lag in lags:
            best = max(best, likeliest(told(lag, seconds, dead), lag, seconds, dead), key=lambda one: one.told)
        step *= FINER if best.told - before < enough else 1.0
        if step < FINEST:
            break
    return best
