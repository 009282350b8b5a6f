"""The whole record of a loop in numbers, cheap enough for every loop of a plant: what is wrong with it is asked later.

    e = sp - pv                         control error
    IAE a day                           integral of |e| over the time that is on record, per 86,400 s of it
    effort a day                        sum of |changes of co|, per day
    Harris index  1 - sigma_mv^2 / var(e)      share of the variance that a better controller could take away

The minimum variance sigma_mv^2 is what cannot be foreseen beyond the dead time b (in samples): with an autoregressive
model e_i = sum a_j e_(i-j) + n_i of the error, sigma_mv^2 = sigma_n^2 sum_(i<b) psi_i^2, psi the response of 1 / A(q)
(Harris 1989; Desborough & Harris 1992). Where the dead time is not known, that of MOST_LIKELY_DELAY samples stands in.
Gaps are no time: an interval counts at most GAP times the usual one. All that is counted sample by sample comes out of
one compiled pass (record_sums.py); noise and grid are told from BLOCKS parts of the record, as they do not change.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from retuner.adaptive.audit.lasting_swing import lasting_swing
from retuner.adaptive.audit.record_sums import LAGS, AtExtreme, Measure, RecordSums, record_sums
from retuner.adaptive.indexes.autocovariance import Regularity
from retuner.adaptive.indexes.condition import (
    AVERAGED,
    DEAD,
    NOISE_RATIO,
    STILL_LENGTH,
    STILL_STRETCH,
    Condition,
    Traits,
    asks,
    condition_of,
    escapes,
    runs_by_itself,
)
from retuner.adaptive.indexes.recording_quality import quantum, runs
from retuner.adaptive.indexes.setpoint_responses import idle_index
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass, replace

DAY_S = 86_400.0
GAP = 5.0  # Intervals longer than so many usual ones are gaps
MOST_LIKELY_DELAY = 3  # dead time in samples where none is known: plants are sampled about so finely
BLOCKS, BLOCK = 8, 1_024  # parts of a long record from which its noise and grid are told, and their samples
NOISE_OF_CO = 3.0  # moves of co within so many standard deviations of its noise are no turns
STILL_MOST = 400  # samples of constant co that are a long stretch in a record of any length

NO_WAVE = Regularity(0.0, 0.0, 0.0, 0.0)
APART = np.abs(np.arange(LAGS)[:, None] - np.arange(LAGS))  # How far apart two lags are, shape (LAGS, LAGS)


@dataclass(frozen=True, slots=True)
class LoopScreen:
    """Numbers of a whole record; shares 0 to 1, times in seconds.

    samples : in the record. span_s : time on record without gaps. gaps : their number. error_std, iae_per_day : of the
    control error, in the unit of pv and that times seconds. effort_per_day : in units of co. reversals_per_day : turns
    of co. in_automatic : share of the record without long stretches of constant co. at_limits : share of co at a limit.
    loss_at_limits : share of the integral of |error| that comes up there. one_sided : how far the error there is all of
    one sign, 0 to 1. harris : see the head of this file. noise_share : of the variance of pv. quantum : of pv's grid, 0
    for none. compression : of pv by its recorder, 1 for none. period_s, regularity, strength : of the strongest lasting
    oscillation, None and 0 where there is none. swinging : share of the stretches looked at in which it lasts.
    condition : of the whole record. setpoint : whether one is on record; without, the mean of pv stands in, and
    OF_THE_ERROR are not known. idle : index of parts with constant setpoint, near 1 where the controller waits for
    the process; None where too little stands out of the noise.
    """

    samples: int
    span_s: float
    gaps: int
    error_std: float
    iae_per_day: float
    effort_per_day: float
    reversals_per_day: float
    in_automatic: float
    at_limits: float
    loss_at_limits: float
    one_sided: float
    harris: float
    noise_share: float
    quantum: float
    compression: float
    period_s: float | None
    regularity: float
    strength: float
    swinging: float
    condition: Condition
    setpoint: bool = True
    idle: float | None = None

    def to_dict(self) -> dict[str, object]:
        """The numbers by name; None for what is not known."""
        told = {name: getattr(self, name) for name in self.__slots__} | {"condition": str(self.condition)}
        return told if self.setpoint else told | dict.fromkeys(OF_THE_ERROR)


def screen_loop(record: Window, delay_s: float | None = None, *, setpoint: bool = True) -> LoopScreen:
    """Screen a whole record.

    record : of any length. delay_s : dead time of the loop where it is known. setpoint : whether its sp is one, and no
    mean of pv that stands in.
    """
    n, parts = len(record.t_s), in_parts(record)
    usual_s, step, noise = parts.sample_time_s, quantum(parts.pv), (noise_sigma(parts.pv), noise_sigma(parts.co))
    by = measure(n, usual_s, noise[1])
    sums = record_sums(record, by)
    limits, days = [side for side in (sums.low, sums.high) if sums.limit(n, side)], sums.held_s / DAY_S
    wave, swinging = lasting_swing(record.sp - record.pv, record.co) or (NO_WAVE, 0.0)
    # what the condition of the whole record is told from
    spread = math.sqrt(sums.error_variance)
    of_noise = NOISE_RATIO / math.sqrt(min(AVERAGED, max(n // 8, 1)))
    traits = Traits(
        dead_pv=sums.pv_high - sums.pv_low <= DEAD * max(abs(sums.pv_low), abs(sums.pv_high)),
        dead_co=sums.co_high - sums.co_low <= DEAD * max(abs(sums.co_low), abs(sums.co_high)),
        still=sums.still / n,
        at_limit=sum(side.samples for side in limits) / n,
        sp_moving=sums.sp_moves / (n - 1),
        offset=abs(sums.error_mean) / spread if spread > 0 else 0.0,
        pv_moves=sums.pv_slow > of_noise * noise[0],
        co_moves=sums.co_slow > of_noise * noise[1],
        asks=lambda: asks(record),
        escapes=lambda: escapes(record),
        runs=lambda: runs_by_itself(record),
    )
    # how far the error at a limit is all of one sign: a limit that binds leaves it on one side
    size = sum(side.size for side in limits)
    return LoopScreen(
        samples=n,
        span_s=sums.held_s,
        gaps=int(sums.gaps),
        error_std=math.sqrt(sums.error_variance),
        iae_per_day=sums.size / days,
        effort_per_day=sums.travel / days,
        reversals_per_day=sums.turns / days,
        in_automatic=in_automatic(record.co, by, sums, limits),
        at_limits=traits.at_limit,
        loss_at_limits=sum(side.size for side in limits) / sums.size if sums.size > 0 else 0.0,
        one_sided=sum(abs(side.error) for side in limits) / size if size > 0 else 0.0,
        harris=harris_index(
            sums.covariance, MOST_LIKELY_DELAY if delay_s is None else max(round(delay_s / usual_s), 1)
        ),
        noise_share=min(noise[0] ** 2 / sums.pv_variance, 1.0) if sums.pv_variance > 0 else 0.0,
        quantum=step,
        compression=1.0 if step or traits.dead_pv else n / (n - min(sums.straight, n - 1)),
        period_s=wave.period * usual_s or None,
        regularity=wave.regularity,
        strength=wave.strength,
        swinging=swinging,
        condition=condition_of(traits, oscillates=swinging > 0).condition,
        setpoint=setpoint,
        idle=_idle(parts),
    )


OF_THE_ERROR = ("error_std", "iae_per_day", "loss_at_limits", "one_sided", "harris", "idle")
OF_TIME = (
    "iae_per_day", "effort_per_day", "reversals_per_day", "in_automatic", "at_limits", "harris", "noise_share",
    "quantum", "compression", "swinging",
)  # fmt: skip
OF_THE_LOSS = ("loss_at_limits", "one_sided")


def joined_screen(screens: Sequence[LoopScreen]) -> LoopScreen:
    """The screen of a loop whose record was screened in pieces: means over their time; the strongest swing of them."""
    if len(screens) == 1:
        return screens[0]
    spans = np.array([screen.span_s for screen in screens])
    losses = np.array([screen.iae_per_day for screen in screens]) * spans

    def mean(name: str, weights: FloatArray) -> float:
        values = np.array([getattr(screen, name) for screen in screens])
        return float(values @ weights / np.sum(weights)) if np.sum(weights) > 0 else 0.0

    longest, strongest = max(screens, key=lambda s: s.span_s), max(screens, key=lambda s: s.strength * s.swinging)
    means: dict[str, Any] = {name: mean(name, spans) for name in OF_TIME} | {
        name: mean(name, losses) for name in OF_THE_LOSS
    }
    return replace(
        longest,
        samples=sum(screen.samples for screen in screens),
        span_s=float(np.sum(spans)),
        gaps=sum(screen.gaps for screen in screens),
        error_std=math.sqrt(float(np.array([s.error_std for s in screens]) ** 2 @ spans / np.sum(spans))),
        period_s=strongest.period_s,
        regularity=strongest.regularity,
        strength=strongest.strength,
        condition=longest.condition,
        **means,
    )


def measure(samples: int, usual_s: float, co_noise: float) -> Measure:
    """What a record of so many samples is counted against."""
    shortest = max(STILL_STRETCH, min(STILL_LENGTH * samples, STILL_MOST))
    return Measure(GAP * usual_s, NOISE_OF_CO * co_noise, float(shortest), min(AVERAGED, max(samples // 8, 1)))


def in_parts(record: Window) -> Window:
    """A record's BLOCKS parts of BLOCK samples spread over it; a short one itself."""
    n = len(record.t_s)
    if n <= BLOCKS * BLOCK:
        return record
    begins = np.linspace(0, n - BLOCK, BLOCKS).astype(int)
    rows = (begins[:, None] + np.arange(BLOCK)).ravel()
    return Window(record.t_s[rows], record.sp[rows], record.pv[rows], record.co[rows])


def _idle(parts: Window) -> float | None:
    """Idle index of the parts in which the setpoint stands, one after the other.

    The process acts as its controller assumes: from sample to sample co moves with the error, as noise and loads do.
    """
    direction = int(np.sign(np.diff(parts.co) @ np.diff(parts.sp - parts.pv)))
    begins = range(0, len(parts.t_s), BLOCK)
    still = [slice(i, i + BLOCK) for i in begins if np.ptp(parts.sp[i : i + BLOCK]) == 0]
    if not still or not direction:
        return None
    pv, co = (np.concatenate([signal[rows] for rows in still]) for signal in (parts.pv, parts.co))
    return idle_index(pv, co, direction, AVERAGED) if len(pv) > 2 * AVERAGED else None


def in_automatic(co: FloatArray, by: Measure, sums: RecordSums, limits: Sequence[AtExtreme]) -> float:
    """Share of the record without long stretches of constant co, those at a limit not counted."""
    still = sums.still
    for side in limits if still else ():
        value = sums.co_low if side is sums.low else sums.co_high
        there = runs((np.diff(co) == 0) & (co[1:] == value))
        still -= sum(end - first for first, end in there if end - first >= by.shortest)
    return 1 - max(still, 0.0) / len(co)


def harris_index(r: FloatArray, delay: int) -> float:
    """Share of the error's variance that minimum-variance control would take away, 0 to 1.

    r : covariances of the error at lags 0 to LAGS. delay : dead time in samples, one for the hold included, at least 1.

    Source: Harris (1989), Canadian Journal of Chemical Engineering 67, 856-861; Desborough & Harris (1992).
    """
    if r[0] <= 0:
        return 0.0
    r = np.concatenate([[1 + 1e-9], r[1:] / r[0]])
    ar = np.linalg.solve(r[APART], r[1:])
    innovation = float(r[0] - ar @ r[1:])
    psi = np.zeros(delay)
    psi[0] = 1.0
    for i in range(1, delay):
        psi[i] = sum(ar[j] * psi[i - 1 - j] for j in range(min(i, LAGS)))
    least = innovation * float(psi @ psi)
    return float(min(max(1.0 - least, 0.0), 1.0)) if math.isfinite(least) else 0.0
