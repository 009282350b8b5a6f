"""The process behind setpoint steps under loads of any kind: only what the setpoint makes of pv is fitted.

    pv = T(G) sp + v,    T = G C / (1 + G C)

The setpoint and the control law C are known, and the setpoint knows nothing of the load: so the loop's own response to
it is fitted (indirect identification, Van den Hof & Schrama 1993), never pv against co, which the load moves both.
Then no model of the load can make the estimate wrong, it only weighs the samples. How pv moved before the first step
tells these weights, and then all that the best model leaves: v is autoregressive, by least squares, and whitened before
the fit (generalised least squares). That holds for random loads, and a ramp or a sinusoid is foretold by it as well.

Loads tell of the process as well, where they come through it by a lag or as a walk (by_likelihood.py): of a loop with
a small gain they tell more. That likelihood is asked beside this fit, and the criterion of Schwarz (1978) decides which
noise is the loop's: a sinusoid's, or a load's of any kind beside the process, is this one's.

No structure of two lags is the process. What it leaves open counts as white noise, a share of the step: with the exact
noise alone the fit would believe its finest features most, which are those that it cannot have (stochastic embedding,
Goodwin, Gevers & Ninness 1992). Records of many sequences are fitted as one, those under other gains too.
"""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from retuner.adaptive.fit.levenberg_marquardt import Limits, descended
from retuner.adaptive.fit.structure import INVERSE, LAG, SECOND, SIZE, SLOPE, THETA, dynamics_at, model_at
from retuner.adaptive.identification.by_likelihood import TYPE, Likelihood, middle, runs_away
from retuner.adaptive.identification.estimate import (
    Alternative,
    LogModel,
    ModelEstimate,
    factors_text,
    proper_covariance,
)
from retuner.adaptive.identification.identify import NAMES, FitSettings, broad, left_open
from retuner.adaptive.identification.plausible import MOST_EXCESS, OUT, Plausible
from retuner.adaptive.identification.usual_dead_time import unusual, usual
from retuner.adaptive.loop.sampled import SampledLaw, setpoint_response
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.signals.setpoint_steps import SetpointSteps
from retuner.schedule.late_dataclass import dataclass, replace

TYPES = (ProcessType.FOPDT, ProcessType.SOPDT, ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG)
STRENGTHS = (0.05, 0.15, 0.4, 1.0)
"""First guesses of kp k' t, with t the half time of the response: how strongly the loop is fed back."""
DEAD = (0.3, 0.8)  # first guesses of the dead time over that half time
LAGS = (0.3, 1.0, 3.0, 10.0)  # first guesses of the lag over the integral time
STARTS = 3  # first guesses that are refined
LIMITS = Limits(15, 6, 1e-3)  # limits of a refinement
SLOPE_STEP = 1e-3  # step of a logarithm, for derivatives
PRICE = 2.0
"""Price of a parameter, in deviance (Akaike 1974): a lag that is left out because it hardly shows would pass for known,
and the integral time with it."""
BELIEVED = 4.0  # excess up to which a model counts for the integral action: two standard deviations
UNSETTLED = 0.7
"""Standard deviation of ln |C|, and of the integral gain, up to which settings may follow: a factor of two. Whoever
changes gains asks all models that are left, so what is not known makes the change smaller; and the bumps go on."""
LARGEST_LN_PARAMETER = 40.0  # largest logarithm of a parameter
HALF_TIMES = 5.0
"""The first setpoint of steps to and fro is held for so many half times (setpoint_bumps): where the guesses begin."""
ORDERS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24)
"""Orders of the noise's filter; the information criterion of Schwarz (1978) chooses."""
SAMPLES_A_TERM = 10  # samples of loads alone for each term of that filter, at least
MISFIT = 0.1
"""What a structure of two lags leaves of a response, share of the largest step: of 0.03, 0.1 and 0.2 the one with
which most settings came out in spec, on 12 loops under walks and coloured loads (seed 310)."""


class NoiseFilter(NamedTuple):
    """ar : what whitens, after the leading 1. std : of what is left, pv units."""

    ar: FloatArray
    std: float


@dataclass(frozen=True, slots=True)
class SetpointFit:
    """One structure fitted. slopes : derivatives of the whitened residuals by x. deviance : their squares, and what is
    unusual of x.
    """

    type: ProcessType
    x: FloatArray
    residuals: FloatArray
    slopes: FloatArray
    deviance: float

    @property
    def is_finite(self) -> bool:
        """Whether it can be told how surely it is known."""
        return bool(np.all(np.isfinite(self.slopes)) and np.all(np.isfinite(self.residuals)))


class Fitting:
    """Records with the filters of their noise, and what models say of them. sign : of the process gain."""

    def __init__(self, records: Sequence[SetpointSteps], sign: int, b: float, filter_s: float) -> None:
        self.records, self.sign = records, sign
        self._laws = [SampledLaw(one.gains, one.dt_s, b, filter_s) for one in records]
        self._reach = {law: max(one.reach for one, own in zip(records, self._laws, strict=True) if own == law)
                       for law in self._laws}  # fmt: skip
        self.filters = self._filters([np.array(one.pv[: one.first]) for one in records])

    def _filters(self, left: Sequence[FloatArray]) -> list[NoiseFilter]:
        """Filters of each record's noise, by what was left of all under the same gains."""
        found = {}
        for gains in {one.gains for one in self.records}:
            same = [(one.largest, v) for one, v in zip(self.records, left, strict=True) if one.gains == gains]
            found[gains] = noise_filter([v for _, v in same], MISFIT * max(size for size, _ in same))
        return [found[one.gains] for one in self.records]

    def residuals(self, type_: ProcessType, x: FloatArray) -> FloatArray:
        """Whitened, in standard deviations of the noise; not finite where the loop would run away."""
        with np.errstate(all="ignore"):
            return np.concatenate([
                _whitened(left[one.first - len(noise.ar) :], noise.ar) / noise.std
                for one, left, noise in zip(self.records, self._left(type_, x), self.filters, strict=True)
            ])  # fmt: skip

    def _left(self, type_: ProcessType, x: FloatArray) -> list[FloatArray]:
        """pv of each record less what the setpoint makes of it."""
        known: dict[SampledLaw, FloatArray] = {}
        left = []
        for one, law in zip(self.records, self._laws, strict=True):
            if law not in known:
                n = self._reach[law]
                # The loop's response to a unit step of the setpoint
                since = np.arange(n, dtype=np.float64) * law.dt_s - math.exp(x[THETA])
                held = self.sign * math.exp(x[SLOPE]) * dynamics_at(type_, x).step(since)
                found = setpoint_response(np.asarray(held, dtype=np.float64), law)
                known[law] = found if not runs_away(found) else np.full(n, np.nan)
            left.append(np.array(one.pv) - one.said(known[law]))
        return left

    def deviance(self, type_: ProcessType, x: FloatArray) -> float:
        """Sum of squares with what is unusual of x; infinite where the loop would run away."""
        cost = float(np.sum(self.residuals(type_, x) ** 2)) + unusual(type_, x) ** 2
        return cost if math.isfinite(cost) else math.inf

    def starts(self, type_: ProcessType) -> Iterator[FloatArray]:
        """First guesses, by the newest record."""
        one = self.records[-1]
        held = one.steps[1].at - one.first if len(one.steps) > 1 else one.reach
        half_s = one.dt_s * max(held / HALF_TIMES, 2.0)
        tau_i = abs(one.gains.kp / one.gains.ki) if one.gains.ki else half_s
        for dead, strength, lag in product(DEAD, STRENGTHS, LAGS if type_ in LAG else LAGS[:1]):
            x = [math.log(strength / (abs(one.gains.kp) * half_s)), math.log(max(dead * half_s, one.dt_s / 2))]
            if type_ in LAG:
                x.append(math.log(lag * tau_i))
            if type_ in SECOND:
                x.append(x[THETA] + math.log(DEAD[0]))
            yield np.array(x)

    def found_twice(self) -> list[SetpointFit]:
        """All structures, under weights by the loads before the steps, and then by all that the best one leaves."""
        found = self.found()
        if found:
            # Weighed by what is left of all samples, not only of those before the steps
            best = min(found, key=lambda one: one.deviance + PRICE * len(one.x))
            self.filters = self._filters(self._left(best.type, best.x))
        return [one for one in map(self.again, found) if one.is_finite]

    def criterion(self, best: SetpointFit, likelihood: Likelihood) -> float:
        """Criterion of a structure with its noise (Schwarz 1978), comparable with that of a likelihood."""
        left, total = self._left(best.type, best.x), PRICE * len(best.x)
        for law in set(self._laws):
            own = [v for v, other in zip(left, self._laws, strict=True) if other == law]
            floor = likelihood.floor(law)
            noise = noise_filter(own, math.sqrt(floor))
            e = [_whitened(v[likelihood.order - len(noise.ar) :], noise.ar) for v in own]
            squares, n = float(sum(x @ x for x in e)), sum(map(len, e))
            misfit = floor * (1 + float(noise.ar @ noise.ar)) * n
            total += (squares + misfit) / noise.std**2 + 2 * n * math.log(noise.std) + len(noise.ar) * math.log(n)
        return total

    def again(self, one: SetpointFit) -> SetpointFit:
        """A structure refined under the weights of now."""
        return self._refined(one.type, one.x, self.deviance(one.type, one.x))

    def found(self) -> list[SetpointFit]:
        """All structures fitted; an inverse response begins as one half of what two lags take for dead time."""
        fitted = {type_: self.best(type_) for type_ in TYPES}
        plain, inverse = fitted[ProcessType.SOPDT], ProcessType.SOPDT_INVERSE
        if plain is not None:
            x = np.append(plain.x, np.zeros(SIZE[inverse] - len(plain.x)))
            x[THETA] = x[INVERSE[inverse]] = plain.x[THETA] - math.log(2.0)
            cost = self.deviance(inverse, x)
            fitted[inverse] = self._refined(inverse, x, cost) if math.isfinite(cost) else None
        return [one for one in fitted.values() if one is not None and one.is_finite]

    def best(self, type_: ProcessType) -> SetpointFit | None:
        """The best of the refined guesses; None where no loop with this structure is stable."""
        costs = [(self.deviance(type_, x), tuple(x)) for x in self.starts(type_)]
        near = sorted(cost for cost in costs if math.isfinite(cost[0]))[:STARTS]
        refined = [self._refined(type_, np.array(x), cost) for cost, x in near]
        return min(refined, key=lambda found: found.deviance, default=None)

    def _refined(self, type_: ProcessType, x: FloatArray, cost: float) -> SetpointFit:
        found = descended(
            (x, cost), partial(self._slopes, type_), partial(_stepped, type_), partial(self.deviance, type_), LIMITS
        )
        assert found is not None  # residuals have slopes everywhere
        x, cost, (here, slopes) = found
        return SetpointFit(type_, x, here, slopes, cost)

    def _slopes(self, type_: ProcessType, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The residuals at x, shape (n,), and their slopes, shape (n, d)."""
        here, steps = self.residuals(type_, x), SLOPE_STEP * np.eye(len(x))
        return here, np.stack([(self.residuals(type_, x + e) - here) / SLOPE_STEP for e in steps], 1)


def _stepped(type_: ProcessType, x: FloatArray, seen: tuple[FloatArray, FloatArray], damping: float) -> FloatArray:
    """A damped step from x. seen : residuals and slopes there."""
    here, slopes = seen
    normal, gradient = slopes.T @ slopes, slopes.T @ here
    known = usual(type_, x)
    if known is not None:
        normal, gradient = normal + known.root.T @ known.root, gradient + known.root.T @ known.residuals(x)
    diagonal = np.diag(normal) + 1e-12 * max(float(np.max(np.diag(normal))), 1e-300)
    step = np.linalg.solve(normal + damping * np.diag(diagonal), -gradient)
    step /= max(float(np.max(np.abs(step))), 1.0)
    return np.asarray(np.clip(x + step, -LARGEST_LN_PARAMETER, LARGEST_LN_PARAMETER), dtype=np.float64)


def process_behind(
    records: Sequence[SetpointSteps], sign: int, settings: FitSettings, b: float = 1.0, filter_s: float = 0.0
) -> ModelEstimate | None:
    """What all records say together; None where no loop explains them.

    records : one at least, the newest last. sign : of the process gain. b, filter_s : setpoint weight, and filter time
    of the derivative.
    """
    fitting = Fitting(records, sign, b, filter_s)
    found = fitting.found_twice()
    if not found:
        return None
    likelihood = Likelihood(records, sign, b, filter_s)
    likely = likelihood.best(list(_ends(found)))
    by_steps = min(found, key=lambda one: one.deviance + PRICE * len(one.x))
    if likely is not None and likely.criterion < fitting.criterion(by_steps, likelihood):
        # The estimate by all that the records show
        newest, sign = likelihood.records[-1], likelihood.sign
        points = likelihood.around(likely)
        leading = middle(points, sign, newest.dt_s)
        order = [leading, *(i for i in range(len(points)) if i != leading)]
        around = tuple(
            Plausible(model_at(TYPE, points[i][0], sign), points[i][1] if i != leading else 0.0) for i in order
        )
        log = LogModel(points[leading][0], proper_covariance(likely.own), sign, likelihood.type)
        information = np.linalg.cholesky(np.linalg.inv(log.p)).T
        alternative = Alternative(log, likely.deviance, information, information @ log.x, likelihood.samples)
        return _told(likelihood.records, (alternative,), around, (likely.noise, likely.noise), settings)
    n = sum(one.reach for one in records)
    inflation = max(min(one.deviance / max(n - len(one.x), 1) for one in found), 1.0)
    ranked = sorted(found, key=lambda one: one.deviance / inflation + PRICE * len(one.x))
    alternatives = tuple(_alternative(one, sign, inflation, n) for one in ranked)
    around = tuple(_plausible(fitting, ranked, alternatives[0].log, inflation))
    noise = fitting.filters[-1].std
    return _told(records, alternatives, around, (noise * math.sqrt(inflation), noise), settings)


def _told(
    records: Sequence[SetpointSteps],
    alternatives: tuple[Alternative, ...],
    around: tuple[Plausible, ...],
    left: tuple[float, float],
    settings: FitSettings,
) -> ModelEstimate:
    """The estimate, and whether settings may follow. left : what is left, and the noise, pv units."""
    log, newest, noise = alternatives[0].log, records[-1], left[1]
    wide = replace(settings, gain_std_limit=UNSETTLED, lag_std_limit=math.inf)
    open_ = left_open(log, around, newest.dt_s, newest.reach * newest.dt_s, wide)
    spread = 0.0 if open_ else integral_spread(around, newest.dt_s)
    if not spread <= wide.gain_std_limit:  # the models ask for integral actions too far from each other
        known, needed = factors_text(spread, wide.gain_std_limit)
        open_ = f"the integral action is uncertain by a factor of {known} (limit {needed})"
    steps = sum(len(one.steps) for one in records)
    reason = f"{steps} setpoint steps to and fro: {open_ or NAMES[log.type]}"
    moved = float(np.var(newest.pv[newest.first :]))
    explained = 1.0 - min(noise**2 / max(moved, noise**2), 1.0)
    return ModelEstimate(not open_, reason, (), *left, alternatives, 0, around, explained)


def _ends(found: Sequence[SetpointFit]) -> Iterator[FloatArray]:
    """What each structure found, as a point of the likelihood's one structure, in which all others are ends."""
    for one in found:
        if one.type in INVERSE:
            continue
        lag = float(one.x[LAG[one.type]]) if one.type in LAG else math.inf
        second = float(one.x[SECOND[one.type]]) if one.type in SECOND else -math.inf
        theta = float(one.x[THETA])
        lag = min(lag, max(theta, second) + FARTHEST)
        yield np.array([one.x[SLOPE], theta, lag, min(max(second, theta - NEAREST), lag)])


FARTHEST, NEAREST = 2.5, 1.5
"""e-folds by which an end of the structure is near enough: a lag beyond the dead time, a second lag below it."""


def of_the_newest(records: Sequence[SetpointSteps], estimate: ModelEstimate, b: float, filter_s: float) -> float:
    """What the best model of an estimate leaves of the newest record, as a sum of squares in standard deviations."""
    log = estimate.log
    return Fitting(records[-1:], log.sign, b, filter_s).deviance(log.type, log.x)


def _plausible(fitting: Fitting, ranked: Sequence[SetpointFit], log: LogModel, inflation: float) -> Iterator[Plausible]:
    """The best, models along the axes of its covariance, and the other structures that come close."""
    best = ranked[0]
    yield Plausible(log.model(), 0.0)
    values, vectors = np.linalg.eigh(log.p)
    for (value, axis), side in product(zip(values, vectors.T, strict=True), (1.0, -1.0)):
        x = best.x + side * OUT * math.sqrt(max(float(value), 0.0)) * axis
        for _ in range(LIMITS.tries):
            excess = (fitting.deviance(best.type, x) - best.deviance) / inflation
            if excess <= MOST_EXCESS:
                yield Plausible(model_at(best.type, x, fitting.sign), max(excess, 0.0))
                break
            x = (x + best.x) / 2
    for one in ranked[1:]:
        fewer = max(len(best.x) - len(one.x), 0)
        excess = max((one.deviance - best.deviance) / inflation - PRICE * fewer, 0.0)
        if excess < MOST_EXCESS:
            yield Plausible(model_at(one.type, one.x, fitting.sign), excess)


def integral_spread(around: Sequence[Plausible], dt_s: float) -> float:
    """Standard deviation of ln ki over the models still allowed, as they ask for it.

    A record without its slow end leaves a lag open of which the gain knows nothing.
    """
    logs = [math.log(abs(simc(p.model.seen_by_controller(dt_s)).gains.ki)) for p in around if p.excess <= BELIEVED]
    return (max(logs) - min(logs)) / (2 * OUT)


def _alternative(one: SetpointFit, sign: int, inflation: float, n: int) -> Alternative:
    """Covariance, and compression for the Kalman filter."""
    q, information = np.linalg.qr(one.slopes / math.sqrt(inflation))
    score = information @ one.x - q.T @ (one.residuals / math.sqrt(inflation))
    known = usual(one.type, one.x)
    precision = information.T @ information + broad(len(one.x))
    precision = precision if known is None else precision + known.root.T @ known.root
    covariance = proper_covariance(np.asarray(np.linalg.inv(precision), dtype=np.float64))
    return Alternative(LogModel(one.x, covariance, sign, one.type), one.deviance / inflation, information, score, n)


def noise_filter(left: Sequence[FloatArray], misfit: float) -> NoiseFilter:
    """What whitens pv as loads and noise alone move it, of some stretches under the same gains.

    misfit : standard deviation of what no structure explains, pv units.
    """
    most = max(order for order in ORDERS if order * SAMPLES_A_TERM <= min(map(len, left)))
    lags = range(1, most + 1)  # the samples before each one, the latest first
    rows = [np.stack([v[most - k : len(v) - k] for k in lags], 1) if most else np.zeros((len(v), 0)) for v in left]
    past = np.concatenate(rows)
    now = np.concatenate([v[most:] for v in left])
    n, floor = len(now), misfit**2
    normal, against = past.T @ past + n * floor * np.eye(most), past.T @ now
    power, best = float(now @ now) + n * floor, (math.inf, NoiseFilter(np.zeros(0), 1.0))
    for order in (order for order in ORDERS if order <= most):
        a = np.linalg.solve(normal[:order, :order], against[:order])
        variance = max(power - float(a @ against[:order]), 1e-12 * power) / n
        criterion = n * math.log(variance) + order * math.log(n)
        if criterion < best[0]:
            best = (criterion, NoiseFilter(-a, math.sqrt(variance)))
    return best[1]


def _whitened(values: FloatArray, ar: FloatArray) -> FloatArray:
    """Through the filter; the first values are its past."""
    order = len(ar)
    found = values[order:].copy()
    for lag, a in enumerate(ar, 1):
        found += a * values[order - lag : len(values) - lag]
    return found
