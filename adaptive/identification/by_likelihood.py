"""The process behind setpoint steps and the loads beside them, in one likelihood: both tell of it.

    pv = T(G) sp + S(G) (G d + n),    d = load through a lag, or a walk, at the process' input, n white

What the setpoint makes of pv tells the process whatever the load (by_setpoint.py), but of a loop with a small gain it
tells little: the controller hardly moves co. How loads move pv tells the rest there, for they come through the same
process: the spectrum of v = S (G d + n) has G in it. That is the direct prediction-error method with a noise model
(Ljung 1999; Forssell & Ljung 1999), here in the closed loop, where v is stationary. Strength and lag of the load and
the noise are fitted along, and the covariance has them in it. v is whitened by the filter that its spectrum asks for
(Levinson 1947); samples weigh as (Whittle 1953)

    deviance = sum (e^2 + what misfit would leave) / s^2 + n ln s^2

No structure of two lags is the process: as in by_setpoint.py what it leaves open counts as white noise, a share of the
step, in the spectrum and in the remainder alike. Fewer lags and an integrator are ends of this one structure. Where a
record does not tell how far out an end is, what is usual tells it (PRIORS), and the covariance reaches there.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from retuner.adaptive.fit.levenberg_marquardt import Limits, descended
from retuner.adaptive.fit.structure import LAG, LEAST_ZETA, SECOND, SIZE, SLOPE, THETA, dynamics_at, model_at
from retuner.adaptive.identification.plausible import MOST_EXCESS
from retuner.adaptive.loop.sampled import SampledLaw, setpoint_response
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.signals.setpoint_steps import SetpointSteps
from retuner.schedule.late_dataclass import dataclass

Spectrum = npt.NDArray[np.complex128]
TYPE = ProcessType.SOPDT
N = SIZE[TYPE]
LOAD, NOISE, CORNER = N, N + 1, N + 2
"""Places of the logarithms of the load's strength (co units a root of a second), the noise (pv units) and the load's
lag (seconds), after the process' own."""
POINTS = 2048  # Frequencies, from 0 to half the sampling frequency
MOST_ORDER, SHARE = 48, 3  # terms of the filter at the most, and the share of the shortest record, one part of so many
MISFIT = 0.05
"""What the structure leaves of a response, share of the largest step: under a walk and under coloured loads the loads'
spectrum tells too little with 0.1, and more than it can with none (seed 45, 16 loops)."""
USUAL_LAG, USUAL_SECOND, USUAL_CORNER = 6.0, 0.5, 60.0
"""Sum of the lags and second lag over the dead time, and the lag of a load over the sampling interval."""
SPREADS = {LAG[TYPE]: 1.5, SECOND[TYPE]: 1.2, CORNER: 2.0}
"""Standard deviations of their logarithms: lags in series, as in usual_dead_time.py, and next to nothing of loads."""
PRICE = 2.0  # price of a parameter of the process, in deviance (Akaike 1974), as in by_setpoint.py
BENT = 0.1  # standard deviation with which more is unusual than the least damping that is fitted
STEP = 1e-3  # step of a logarithm, for derivatives
LIMITS = Limits(14, 5, 1e-2)  # limits of a refinement
WIDEST = 3.0  # standard deviation of a logarithm that is known of any process
STRENGTHS = (0.01, 0.1, 1.0)
"""First guesses of the load: what it moves pv by in a second over what is seen of pv, by the process' slope gain."""
STARTS = 3  # first guesses that are refined
LARGEST_LN_PARAMETER = 40.0  # largest logarithm of a parameter
AXES = (1.0, 2.0)  # standard deviations out along the axes of the covariance where models are asked


class _Known(NamedTuple):
    """What a parameter vector says under one set of gains.

    response : to a unit step. ar : the filter. ln_variance : of what it leaves. misfit : that adds so much a sample.
    spectrum : its logarithm.
    """

    response: FloatArray
    ar: FloatArray
    ln_variance: float
    misfit: float
    spectrum: FloatArray


class RecordsAtParameters(NamedTuple):
    """What the records say at a parameter vector. deviance : with what is unusual. left : whitened, all records.
    spectra : ln of them, one a set of gains.
    """

    deviance: float
    left: FloatArray
    spectra: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True)
class Likely:
    """The optimum. p : process, load, noise. covariance : of p. deviance : there. samples : that told it."""

    p: FloatArray
    covariance: FloatArray
    deviance: float
    samples: int

    @property
    def own(self) -> FloatArray:
        """Covariance of the process' parameters, whatever load and noise are."""
        return self.covariance[:N, :N]

    @property
    def noise(self) -> float:
        """Standard deviation, pv units."""
        return math.exp(self.p[NOISE])

    @property
    def criterion(self) -> float:
        """The deviance with the price of what tells load and noise (Schwarz 1978)."""
        return self.deviance + PRICE * N + (len(self.p) - N) * math.log(self.samples)


NOWHERE = RecordsAtParameters(math.inf, np.zeros(0), ())


class Likelihood:
    """Records of one process, and what its models say of them. sign : of the process gain."""

    type = TYPE

    def __init__(self, records: Sequence[SetpointSteps], sign: int, b: float, filter_s: float) -> None:
        self.records, self.sign = records, sign
        self._laws = [SampledLaw(one.gains, one.dt_s, b, filter_s) for one in records]
        self.order = max(min(MOST_ORDER, min(len(one.pv) for one in records) // SHARE), 1)
        self._groups = {
            law: [one for one, own in zip(records, self._laws, strict=True) if own == law] for law in self._laws
        }
        self._left = [np.array(one.pv) for one in records]
        self._samples = [sum(len(one.pv) - self.order for one in of) for of in self._groups.values()]

    @property
    def samples(self) -> int:
        """Samples that are weighed."""
        return sum(self._samples)

    def floor(self, law: SampledLaw) -> float:
        """Variance of what no structure explains of the records under these gains, pv units squared."""
        return (MISFIT * max(one.largest for one in self._groups[law])) ** 2

    def told(self, p: FloatArray) -> RecordsAtParameters:
        """What the records say at a parameter vector; its deviance is infinite where the loop would run away."""
        dt_s = self.records[-1].dt_s
        if not np.all(np.abs(p) < LARGEST_LN_PARAMETER) or math.exp(p[THETA]) > len(self.records[-1].pv) * dt_s:
            return NOWHERE
        with np.errstate(all="ignore"):
            known = {law: self._known(p, law, of) for law, of in self._groups.items()}
            if any(one is None for one in known.values()):
                return NOWHERE
            deviance, left = float(np.sum(self._unusual(p) ** 2)), []
            for one, law, pv in zip(self.records, self._laws, self._left, strict=True):
                here = known[law]
                assert here is not None
                e = np.convolve(pv - one.said(here.response), here.ar, "valid") / math.exp(here.ln_variance / 2)
                left.append(e)
                deviance += float(e @ e) + len(e) * (here.misfit + here.ln_variance)
        spectra = tuple(one.spectrum for one in known.values() if one is not None)
        return RecordsAtParameters(deviance, np.concatenate(left), spectra) if math.isfinite(deviance) else NOWHERE

    def _known(self, p: FloatArray, law: SampledLaw, of: Sequence[SetpointSteps]) -> _Known | None:
        """What is the same for all records under one set of gains; None where the loop would run away."""
        n, floor = max(one.reach for one in of), self.floor(law)
        since = np.arange(n, dtype=np.float64) * law.dt_s - math.exp(p[THETA])
        held = self.sign * math.exp(p[SLOPE]) * dynamics_at(TYPE, p).step(since)
        response = setpoint_response(np.asarray(held, dtype=np.float64), law)
        process = self.sign * _process(p, law.dt_s)
        back = 1 - math.exp(-law.dt_s / math.exp(p[CORNER])) * _z1()
        load = math.exp(2 * p[LOAD]) * law.dt_s / np.abs(back) ** 2
        loop = np.abs(1 + process * _controller(law)) ** 2
        spectrum = (np.abs(process) ** 2 * load + math.exp(2 * p[NOISE])) / loop + floor
        if not (np.all(np.isfinite(response)) and np.all(np.isfinite(spectrum))) or runs_away(response):
            return None
        ar, variance = whitening(spectrum @ _cosines(self.order) / POINTS, self.order)
        if not variance > 0:
            return None
        misfit = floor * float(ar @ ar) / variance
        return _Known(response, ar, math.log(variance), misfit, np.log(spectrum))

    def _unusual(self, p: FloatArray) -> FloatArray:
        """Standard deviations by which lags, load and damping are unusual."""
        lag, second = LAG[TYPE], SECOND[TYPE]
        rings = (p[second] - p[lag] - math.log(1 / (4 * LEAST_ZETA**2))) / BENT
        dt_s = self.records[-1].dt_s
        return np.array([
            (p[lag] - p[THETA] - math.log(USUAL_LAG)) / SPREADS[lag],
            (p[second] - p[THETA] - math.log(USUAL_SECOND)) / SPREADS[second],
            (p[CORNER] - math.log(USUAL_CORNER * dt_s)) / SPREADS[CORNER],
            max(rings, 0.0),
        ])  # fmt: skip

    def curvature(self, p: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Half the deviance's slope, and the information (Whittle 1953); None at the edge of what is stable."""
        here = self.told(p)
        if not math.isfinite(here.deviance):
            return None
        ahead = [self.told(p + e) for e in STEP * np.eye(len(p))]
        if not all(math.isfinite(one.deviance) for one in ahead):
            return None
        half = np.array([(one.deviance - here.deviance) / (2 * STEP) for one in ahead])
        by_step = np.stack([(one.left - here.left) / STEP for one in ahead])
        information = by_step @ by_step.T
        for i, n in enumerate(self._samples):
            slopes = np.stack([(one.spectra[i] - here.spectra[i]) / STEP for one in ahead])
            information += n / (2 * POINTS) * (slopes @ slopes.T)
        at = self._unusual(p)
        usual = np.stack([(self._unusual(p + e) - at) / STEP for e in STEP * np.eye(len(p))])
        information[:N, :N] += np.eye(N) / WIDEST**2  # what a record does not tell at all stays finite
        return half, information + usual @ usual.T

    def refined(self, p: FloatArray) -> Likely | None:
        """Down from a start by scoring (Fisher), damped."""
        found = descended((p, self.told(p).deviance), self.curvature, _ahead, lambda x: self.told(x).deviance, LIMITS)
        if found is None:
            return None
        p, deviance, (_, information) = found
        if not np.linalg.eigvalsh(information)[0] > 0:
            return None
        return Likely(p, np.asarray(np.linalg.inv(information), dtype=np.float64), deviance, self.samples)

    def best(self, starts: Sequence[FloatArray]) -> Likely | None:
        """The best of the refined starts, each with several strengths of the load. starts : of the process alone."""
        bends = np.concatenate([np.diff(v, 2) for v in self._left])  # which a slow motion hardly has
        noise = math.log(max(math.sqrt(float(np.mean(bends**2)) / 6), 1e-9))
        corner = math.log(USUAL_CORNER * self.records[-1].dt_s)
        seen = max(float(np.std(np.concatenate(self._left))), 1e-9)
        tried = []
        for x, strength in product(starts, STRENGTHS):
            p = np.array([*x, math.log(strength * seen) - x[SLOPE], noise, corner])
            deviance = self.told(p).deviance
            tried += [(deviance, tuple(p))] if math.isfinite(deviance) else []
        refined = [self.refined(np.array(p)) for _, p in sorted(tried)[:STARTS]]
        return min((one for one in refined if one is not None), key=lambda one: one.deviance, default=None)

    def around(self, best: Likely) -> list[tuple[FloatArray, float]]:
        """Processes along the axes of the covariance, loads and noise as they then come out, and their excess."""
        own = best.own
        along = best.covariance[:, :N] @ np.linalg.inv(own)
        values, vectors = np.linalg.eigh(own)
        found = [(best.p[:N], 0.0)]
        for (value, axis), out in product(zip(values, vectors.T, strict=True), (*AXES, *(-x for x in AXES))):
            p = best.p + along @ (out * math.sqrt(max(float(value), 0.0)) * axis)
            excess = self.told(p).deviance - best.deviance
            if excess <= MOST_EXCESS:
                found.append((p[:N], max(excess, 0.0)))
        return found


def _ahead(p: FloatArray, curved: tuple[FloatArray, FloatArray], damping: float) -> FloatArray:
    """A damped step from p. curved : half the deviance's slope and the information there."""
    half, information = curved
    step = np.linalg.solve(information + damping * np.diag(np.diag(information)), -half)
    return np.asarray(p + step / max(float(np.max(np.abs(step))), 1.0), dtype=np.float64)


def middle(found: Sequence[tuple[FloatArray, float]], sign: int, dt_s: float) -> int:
    """Which of the processes asks for settings in the middle of what all ask for, weights exp(-excess / 2).

    The most likely one may be far out, at an end of the structure that the records hardly tell from another.
    """
    sets = [simc(model_at(TYPE, x, sign).seen_by_controller(dt_s)).gains for x, _ in found]
    logs = np.array([[math.log(abs(one.kp)), math.log(abs(one.ki))] for one in sets])
    weights = np.exp(-np.array([excess for _, excess in found]) / 2)
    mean = weights @ logs / np.sum(weights)
    return int(np.argmin(np.sum((logs - mean) ** 2, axis=1)))


AT_MOST = 1.5  # share of a setpoint step that pv of a stable loop comes to late, where it has not been farther before


def runs_away(response: FloatArray) -> bool:
    """Whether a loop with this response to a setpoint step is unstable: no loop that still runs is."""
    late = 3 * len(response) // 4
    begun, end = (float(np.max(np.abs(part), initial=0.0)) for part in (response[:late], response[late:]))
    return not end <= max(begun, AT_MOST)


def whitening(covariances: FloatArray, order: int) -> tuple[FloatArray, float]:
    """Filter that whitens what has these autocovariances, and the variance that it leaves (Levinson 1947)."""
    a, variance = np.zeros(order + 1), float(covariances[0])
    a[0] = 1.0
    for k in range(1, order + 1):
        turned = -float(covariances[k] + a[1:k] @ covariances[k - 1 : 0 : -1]) / variance
        a[1 : k + 1] += turned * a[k - 1 :: -1][:k] if k > 1 else turned
        variance *= 1 - turned * turned
    return a, variance


@lru_cache(maxsize=1)
def _z1() -> Spectrum:
    return np.asarray(np.exp(-1j * np.pi * (np.arange(POINTS) + 0.5) / POINTS), dtype=np.complex128)


@lru_cache(maxsize=4)
def _cosines(order: int) -> FloatArray:
    """The cosines that make autocovariances of a spectrum, shape (points, order + 1)."""
    w = np.pi * (np.arange(POINTS) + 0.5) / POINTS
    return np.asarray(np.cos(w[:, None] * np.arange(order + 1)), dtype=np.float64)


def _process(p: FloatArray, dt_s: float) -> Spectrum:
    """G with its input held from sample to sample, exactly (dynamics.py), without its sign."""
    z1, theta_s = _z1(), math.exp(p[THETA])
    whole = math.floor(theta_s / dt_s)
    part = theta_s - whole * dt_s
    found = np.zeros(POINTS, dtype=np.complex128)
    for rate, weight in dynamics_at(TYPE, p).modes():
        first = -np.expm1(-rate * (dt_s - part)) / rate
        second = np.exp(-rate * (dt_s - part)) * -np.expm1(-rate * part) / rate
        found += weight * (first + second * z1) / (1 - np.exp(-rate * dt_s) * z1)
    return np.asarray(math.exp(p[SLOPE]) * z1 ** (whole + 1) * found, dtype=np.complex128)


@lru_cache(maxsize=64)
def _controller(law: SampledLaw) -> Spectrum:
    """C of the sampled law, from the error's way through pv."""
    z1, gains = _z1(), law.gains
    found = gains.kp + gains.ki * law.dt_s * z1 / (1 - z1)
    if gains.kd:
        found = found + gains.kd * (1 - z1) / (law.filter_s + law.dt_s - law.filter_s * z1)
    return np.asarray(found, dtype=np.complex128)
