"""The whole record of a loop in numbers, cheap enough for every loop of a plant: what is wrong with it is asked later.

    e = sp - pv                         control error
    IAE a day                           integral of |e| over the time that is on record, per 86,400 s of it
    effort a day                        sum of |changes of co|, per day
    Harris index  1 - sigma_mv^2 / var(e)      share of the variance that a better controller could take away

The minimum variance sigma_mv^2 is what cannot be foreseen beyond the dead time b (in samples): with an autoregressive
model e_i = sum a_j e_(i-j) + n_i of the error, sigma_mv^2 = sigma_n^2 sum_(i<b) psi_i^2, psi the response of 1 / A(q)
(Harris 1989; Desborough & Harris 1992). Where the dead time is not known, that of MOST_LIKELY_DELAY samples stands in.
Gaps are no time: an interval counts at most GAP times the usual one.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz

from retuner.adaptive.indexes.autocovariance import Regularity, autocovariance, regularity
from retuner.adaptive.indexes.condition import Condition, record_condition
from retuner.adaptive.indexes.limits import at_limits
from retuner.adaptive.indexes.recording_quality import RecordingQuality, recording_quality
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

DAY_S = 86_400.0
GAP = 5.0
"""Intervals longer than so many usual ones are gaps."""
LAGS = 20
"""Order of the autoregressive model (Desborough & Harris 1992 use 5 to 20)."""
MOST_LIKELY_DELAY = 3
"""Dead time in samples where none is known: plants are sampled about so finely."""
LOOKED_AT = 20_000
"""Samples of the stretch in which an oscillation is looked for: two days at ten seconds."""
PARTS = 8
"""Stretches of that length, spread over the record."""


@dataclass(frozen=True, slots=True)
class LoopScreen:
    """Numbers of a whole record; shares 0 to 1, times in seconds.

    samples : in the record. span_s : time on record without gaps. gaps : their number. error_std, iae_per_day : of the
    control error, in the unit of pv and that times seconds. effort_per_day : in units of co. reversals_per_day : turns
    of co. at_limits : share of co at a limit. harris : see the head of this file. noise_share : of the variance of pv.
    compression : of pv by its recorder, 1 for none. period_s, regularity, strength : of the strongest lasting
    oscillation, None and 0 where there is none. swinging : share of the stretches looked at in which it lasts.
    condition : of the whole record.
    """

    samples: int
    span_s: float
    gaps: int
    error_std: float
    iae_per_day: float
    effort_per_day: float
    reversals_per_day: float
    at_limits: float
    harris: float
    noise_share: float
    compression: float
    period_s: float | None
    regularity: float
    strength: float
    swinging: float
    condition: Condition

    def to_dict(self) -> dict[str, object]:
        """The numbers by name."""
        return {name: getattr(self, name) for name in self.__slots__} | {"condition": str(self.condition)}


def screen_loop(record: Window, delay_s: float | None = None) -> LoopScreen:
    """Screen a whole record.

    Parameters
    ----------
    record : of any length. delay_s : dead time of the loop where it is known.
    """
    steps_s = np.diff(record.t_s)
    usual_s = record.sample_time_s
    held_s = np.minimum(steps_s, GAP * usual_s)
    error = record.sp - record.pv
    span_s = float(np.sum(held_s))
    days = span_s / DAY_S
    limits = at_limits(record.co)
    quality = recording_quality(record.pv) or RecordingQuality(0.0, 0.0, 1.0, 1.0)
    wave, swinging = _oscillation(record)
    delay = MOST_LIKELY_DELAY if delay_s is None else max(round(delay_s / usual_s), 1)
    lasting = wave is not None
    return LoopScreen(
        samples=len(record.t_s),
        span_s=span_s,
        gaps=int(np.sum(steps_s > GAP * usual_s)),
        error_std=float(np.std(error)),
        iae_per_day=float(np.sum(np.abs(error[:-1]) * held_s)) / days,
        effort_per_day=float(np.sum(np.abs(np.diff(record.co)))) / days,
        reversals_per_day=_turns(record.co) / days,
        at_limits=limits.low + limits.high,
        harris=harris_index(error, delay),
        noise_share=quality.noise_share,
        compression=quality.compression,
        period_s=wave.period * usual_s if wave is not None else None,
        regularity=wave.regularity if wave is not None else 0.0,
        strength=wave.strength if wave is not None else 0.0,
        swinging=swinging,
        condition=record_condition(record, limits.low + limits.high, oscillates=lasting).condition,
    )


def _turns(x: FloatArray) -> int:
    """Reversals of a signal, its own noise not counted."""
    band = 3 * noise_sigma(x)
    moves = np.diff(np.round((x - x[0]) / band) if band > 0 else x)
    signs = np.sign(moves[moves != 0])
    return int(np.sum(signs[1:] != signs[:-1]))


def _oscillation(record: Window) -> tuple[Regularity | None, float]:
    """The strongest lasting oscillation of the stretches looked at, and the share of them in which one lasts."""
    n = len(record.t_s)
    length = min(n, LOOKED_AT)
    parts = min(PARTS, max(n // length, 1))
    begins = np.linspace(0, n - length, parts).astype(int)
    found = [_wave(record, int(begin), int(begin) + length) for begin in begins]
    waves = [wave for wave in found if wave is not None]
    return max(waves, key=lambda w: w.strength, default=None), len(waves) / len(found)


def _wave(record: Window, begin: int, end: int) -> Regularity | None:
    """A lasting oscillation of the error, else of co."""
    for signal in (record.sp[begin:end] - record.pv[begin:end], record.co[begin:end]):
        if float(np.ptp(signal)) > 0:
            wave = regularity(signal)
            if wave is not None and wave.lasting:
                return wave
    return None


def harris_index(error: FloatArray, delay: int) -> float:
    """Share of the error's variance that minimum-variance control would take away, 0 to 1.

    Parameters
    ----------
    error : shape (n,). delay : dead time in samples, one for the hold included, at least 1.

    Source: Harris (1989), Canadian Journal of Chemical Engineering 67, 856-861; Desborough & Harris (1992).
    """
    r = autocovariance(error)[: LAGS + 1]
    if len(r) < LAGS + 1 or r[0] <= 0:
        return 0.0
    r = np.concatenate([[r[0] * (1 + 1e-9)], r[1:]])
    ar = solve_toeplitz(r[:-1], r[1:])
    innovation = float(r[0] - ar @ r[1:])
    psi = np.zeros(delay)
    psi[0] = 1.0
    for i in range(1, delay):
        psi[i] = sum(ar[j] * psi[i - 1 - j] for j in range(min(i, LAGS)))
    least = innovation * float(psi @ psi) / float(r[0])
    return float(min(max(1.0 - least, 0.0), 1.0)) if math.isfinite(least) else 0.0
