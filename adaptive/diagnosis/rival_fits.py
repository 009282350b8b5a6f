"""Three explanations of one record, fitted with the same engine and compared by the same criterion.

    linear     pv = G co + load steps + random walk                          the loop's own doing, and ordinary upsets
    external   the same + a sinusoid with harmonics at a free frequency      an oscillation from outside
    stuck      the same with co replaced by the output of a stuck valve      see valve/valve_fit.py

Harmonics belong to the second, because what comes from outside is often another loop's limit cycle, a triangle or a
saw, which one sinusoid leaves to the valve. What is left counts as it is, not whitened: even one real pole takes an
oscillation that is slow against the sampling for noise.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.refine import refine
from retuner.adaptive.fit.structure import SLOPE
from retuner.adaptive.identification.candidate import Candidate, CandidateList, judged
from retuner.adaptive.identification.loads import improved
from retuner.adaptive.identification.structure_choice import StructureSettings, candidates
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray, Window

HARMONICS = 5  # harmonics of an outside oscillation: five tell a triangle or a saw to two percent
SINUSOID = 1  # harmonics of a plain sinusoid: eight numbers fewer to pay for, which a short record may be too short for
MORE_HARMONICS = 11  # harmonics where a loop shows the oscillation's slope instead, as squares with sharp corners
SHARP = 4  # samples in the shortest wave of those, at least
PADDED = 4  # zero padding of the spectrum: peaks to a quarter of a line
FEWEST_CYCLES = 2  # cycles in the record of a tone that is looked for
WEAKENED = 3.0
"""The process is also tried with a gain e^-3 of the linear one: next to a tone it may have no part at all."""


def linear(window: Window, signs: tuple[int, ...], settings: StructureSettings, most_samples: int) -> list[Candidate]:
    """The linear explanation in every structure, best first."""
    return candidates(window, signs, settings, most_samples)


def external(fit: Candidate, frequencies: list[float], most_loads: int) -> Candidate:
    """The best explanation with a tone from outside, of as many harmonics and loads as a short record has samples for.

    fit : the linear one, with room for a tone beside it. frequencies : where to look, rad/s.
    """
    found = []
    plain = _with_tone(fit, HARMONICS)
    plain = plain if plain.has_room else _with_tone(fit, SINUSOID)
    base = replace(fit.fit.misfit, harmonics=plain.harmonics, ar=(), sigma=plain.sigma)
    base = base if base.has_room else plain
    x = fit.fit.x
    weak = x.copy()
    weak[SLOPE] -= WEAKENED
    for w in frequencies:
        found.append(judged(refine(base, np.append(fit.fit.p if base.loads else x, np.log(w)))))
        starts = (x, weak) if base.loads else (weak,)  # without loads the first is the one above
        found += [judged(refine(plain, np.append(start, np.log(w)))) for start in starts]
        # and afresh, from a grid of first-order processes: load steps bought instead of the tone lead one astray
        record, misfit = plain.record, replace(plain, type=ProcessType.FOPDT)
        dt, usual = record.sample_time_s, record.pv_range / (record.co_range or 1.0)
        points = [
            np.array([np.log(gain * usual / (lag * dt)), np.log(theta * dt), np.log(lag * dt), np.log(w)])
            for lag, theta, gain in product(FRESH_LAGS, FRESH_THETAS, FRESH_GAINS)
        ]
        found.append(judged(refine(misfit, points[int(np.argmin(misfit.costs(points)))])))
    best = improved(min(found, key=lambda c: c.criterion), most_loads, CandidateList(found))
    plainer = judged(refine(replace(best.fit.misfit, harmonics=SINUSOID), best.fit.p))
    return min(best, plainer, key=lambda c: c.criterion)


def room_for_a_tone(fit: Candidate) -> bool:
    """Whether the record has more samples than a process beside a sinusoid has unknowns."""
    return _with_tone(fit, SINUSOID).has_room


def _with_tone(fit: Candidate, harmonics: int) -> Misfit:
    """The process of the linear explanation beside a tone, without its loads."""
    sigma = fit.fit.misfit.record.noise_std
    return replace(fit.fit.misfit, harmonics=harmonics, ar=(), sigma=sigma, loads=0, corners=0, rounded=False)


def sharper(tone: Candidate) -> Candidate:
    """The tone with as many harmonics as sharp corners need, where the record shows them and they pay."""
    record = tone.fit.misfit.record
    period_s = 2 * math.pi / math.exp(float(tone.fit.p[-1]))
    more = replace(tone.fit.misfit, harmonics=MORE_HARMONICS)
    if period_s < SHARP * MORE_HARMONICS * record.sample_time_s or not more.has_room:
        return tone
    finer = judged(refine(more, tone.fit.p))
    return min(tone, finer, key=lambda c: c.criterion)


FRESH_LAGS = (2.0, 8.0, 30.0, 120.0)
FRESH_THETAS = (1.0, 4.0, 16.0)  # Samples in the lag and dead time that a process beside a tone is looked for with
FRESH_GAINS = (0.1, 0.3, 1.0, 3.0)  # gains tried for a process beside a tone, in ranges of pv over ranges of co


def moves_pv(tone: Candidate | None, evidence: Mapping[str, float], settings: DiagnosisSettings) -> bool:
    """Whether a tone is what moves pv, and setpoint responses overshoot no further than it lifts them."""
    if tone is None:
        return False
    record, size = tone.fit.misfit.record, amplitude(tone)
    step = evidence.get("setpoint_size", 0.0)
    lifted = settings.most_overshoot + (size / step if step else math.inf)
    return size >= settings.tone_size * float(np.std(record.pv)) and evidence.get("overshoot", 0.0) <= lifted


def amplitude(tone: Candidate) -> float:
    """Amplitude of a tone's first harmonic in pv, pv units."""
    return float(np.hypot(*tone.fit.at.c[tone.fit.at.priors + tone.fit.misfit.loads :][:2]))


def tone_period_s(tone: Candidate) -> float:
    """Period of a tone from outside, s."""
    return 2 * math.pi / math.exp(float(tone.fit.p[-1]))


def residual(candidate: Candidate) -> float:
    """What a fit leaves, in standard deviations of the noise."""
    return candidate.colour.std / candidate.fit.misfit.record.noise_std


def peak_frequency(x: FloatArray, sample_time_s: float) -> float:
    """Frequency at which a signal moves most, rad/s, of those with two cycles in the record."""
    power = np.abs(np.fft.rfft((x - np.mean(x)) * np.hanning(len(x)), PADDED * len(x))) ** 2
    first = FEWEST_CYCLES * PADDED
    return 2 * math.pi * (first + int(np.argmax(power[first:]))) / (PADDED * len(x) * sample_time_s)
