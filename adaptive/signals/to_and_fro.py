"""Setpoint steps to and fro, joined into one response: loads of any kind average out, the setpoint's share stays.

    base -> base + a -> base - a -> base + a -> ... -> base        a half step, whole steps, a half step, at even times

The loop is linear and its gains are the same all the time. So stretches from step to step, each turned to the sign of
the last one, have a mean that obeys the loop's own equations:

    mean(s pv) = G mean(s co) + G mean(s d) + mean(s n),    s = 1, -1, 1, -1, ...

A load d knows nothing of s: where as many steps go up as down, what is constant or drifts is gone, and the rest shrinks
with the root of their number. How much of it is left is not assumed: the scatter of the stretches about their mean
tells it (averaging over the periods of an excitation, Pintelon & Schoukens 2012, section 2.4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from retuner.adaptive.signals.recogniser import (
    RecogniserLaw,
    RecogniserPhase,
    begin,
    response_of,
    so_far,
    step,
)
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import FloatArray, LoopSample, Window
from retuner.schedule.gains import PidGains

WHOLE_STEPS = 4
"""Whole steps that are joined: as many up as down."""
SAME = 0.02
"""Share of a step by which another may differ from it: what a controller rounds."""
EVEN = 0.1
"""Share of the time between two steps by which another may differ from it."""
SAMPLES_OFF = 2
"""Samples by which two times may differ however short they are."""
OVERDUE = 1.5
"""Times from one step to the next after which the next will not come."""
STANDS = 5
"""Samples for which a setpoint stands at least between steps: one that moves faster is noise, or led."""
LED_MOVES = 2
LED_REACH = 2.5
"""So many moves within so many times the time between two steps, before the first: the setpoint is led, and does not
step."""
QUIET_SHARE = 0.2
"""Share of the time between two steps for which the joined loop must keep to its band to be at rest."""


class SetpointMove(NamedTuple):
    """A move of the setpoint: the first sample at the new one, and by how much it moved, pv units."""

    at: int
    size: float


class ToAndFro(NamedTuple):
    """Where the steps are in a list of samples.

    base : setpoint before and after, pv units. opened : index of the half step. whole : of the whole steps, in order.
    closed : index of the half step back, None as long as it has not come.
    """

    base: float
    opened: int
    whole: tuple[int, ...]
    closed: int | None

    @property
    def apart(self) -> int:
        """Samples from one whole step to the next."""
        return int(np.median(np.diff(self.whole)))


class Joined(NamedTuple):
    """The one response that the steps make, and its samples, whose times are those of the last stretch.

    noise_std : of the joined pv, by the scatter of the stretches about their mean, pv units.
    """

    samples: list[LoopSample]
    window: Window
    response: Response
    noise_std: float


def to_and_fro(samples: Sequence[LoopSample]) -> ToAndFro | None:
    """The steps to and fro with which the newest samples of one set of gains end, None where there are none."""
    moves = _moves(samples)
    for i in range(len(moves) - 1):
        found = _taken_for(moves[i:], samples)
        if found is not None:
            return None if _led_before(moves[: i + 1], found) else found
    return None


def _led_before(moves: Sequence[SetpointMove], found: ToAndFro) -> bool:
    """Whether the setpoint moved on and on before the first of the steps, which is the last of these moves."""
    if len(moves) <= LED_MOVES:
        return False
    return found.opened - moves[-1 - LED_MOVES].at <= LED_REACH * (found.whole[0] - found.opened)


def _moves(samples: Sequence[LoopSample]) -> list[SetpointMove]:
    """Moves of the setpoint since the gains last changed, in order."""
    revision, found = samples[-1].revision, []
    for i in range(len(samples) - 1, 0, -1):
        if samples[i - 1].revision != revision:
            break
        if samples[i].sp != samples[i - 1].sp:
            found.append(SetpointMove(i, samples[i].sp - samples[i - 1].sp))
    return found[::-1]


def _taken_for(moves: Sequence[SetpointMove], samples: Sequence[LoopSample]) -> ToAndFro | None:
    """All of these moves as steps to and fro, if they are that."""
    half, whole, closed = moves[0].size, list[int](), None
    wanted = -2 * half
    for move in moves[1:]:
        if closed is not None:
            return None
        if _is_like(move.size, wanted, half):
            whole.append(move.at)
            wanted = -wanted
        elif whole and _is_like(move.size, wanted / 2, half):
            closed = move.at
        else:
            return None
    apart = [b - a for a, b in pairwise([move.at for move in moves])]
    if not whole or min(apart) < STANDS or max(apart) - min(apart) > max(EVEN * min(apart), SAMPLES_OFF):
        return None
    overdue = len(samples) - moves[-1].at > OVERDUE * max(apart)
    if overdue and closed is None and len(whole) < WHOLE_STEPS:
        return None
    return ToAndFro(samples[moves[0].at - 1].sp, moves[0].at, tuple(whole), closed)


def _is_like(size: float, wanted: float, half: float) -> bool:
    """Whether a move has the wanted size."""
    return abs(size - wanted) <= SAME * abs(half)


def joined(samples: Sequence[LoopSample], found: ToAndFro, band_sigmas: float) -> Joined | None:
    """The last whole steps as one, None where fewer than two stretches are there, or the output stood at a limit.

    band_sigmas : noise standard deviations in a noise band.
    """
    whole = found.whole[-WHOLE_STEPS:]
    if len(whole) < WHOLE_STEPS:
        return None
    last = whole[-1]
    end = min(found.closed or len(samples), last + found.apart)
    lead = min(found.apart, whole[0] - found.opened) // 2
    own = list(samples[last - lead : end])
    if any(sample.limited for sample in samples[whole[0] - lead : end]):
        return None
    middle = float(np.mean([sample.co for sample in samples[whole[0] : end]]))
    t_s, pv, co = (np.array([getattr(s, name) for s in samples], dtype=np.float64) for name in ("t_s", "pv", "co"))
    since_s = t_s[last - lead : end] - t_s[last]
    signs = [(-1.0) ** (len(whole) - 1 - i) for i in range(len(whole))]
    rows = np.array(
        [s * (np.interp(t_s[k] + since_s, t_s, pv) - found.base) for s, k in zip(signs, whole, strict=True)]
    )
    held = [np.searchsorted(t_s, t_s[k] + since_s + SLIGHTLY * (t_s[1] - t_s[0]), side="right") - 1 for k in whole]
    outputs = np.mean([s * (co[at] - middle) for s, at in zip(signs, held, strict=True)], axis=0)
    return _as_one(own, found.base + rows.mean(axis=0), middle + outputs, _scatter(rows), band_sigmas)


SLIGHTLY = 1e-6
"""Share of a sample time by which a held value is asked for later, so that rounding does not give the one before."""


def _scatter(rows: FloatArray) -> float:
    """Standard deviation of the mean of some stretches, by how they differ; shape (stretches, n)."""
    n = len(rows)
    return math.sqrt(float(np.sum((rows - rows.mean(axis=0)) ** 2)) / (n * (n - 1) * rows.shape[1]))


HIDDEN = 0.25
"""Noise band over a step from which peaks of the joined response may be those of the load: then it is told without."""


def _as_one(
    own: Sequence[LoopSample], pv: FloatArray, co: FloatArray, noise_std: float, band_sigmas: float
) -> Joined | None:
    """Samples with these values, and the response in them."""
    pairs = zip(own, pv.tolist(), co.tolist(), strict=True)
    samples = [sample._replace(pv=y, co=u) for sample, y, u in pairs]
    moved = abs(samples[-1].sp - samples[0].sp)
    response = _response(samples, min(band_sigmas * noise_std, HIDDEN * moved))
    if response is None:
        return None
    if band_sigmas * noise_std > HIDDEN * moved:
        response = replace(response, peaks=())
    return Joined(samples, replace(Window.of(samples), noise_std=noise_std), response, noise_std)


def _response(samples: Sequence[LoopSample], band: float) -> Response | None:
    """What the recogniser sees in samples of which one is a setpoint step; None where that does not stand out."""
    span_s, dt_s = samples[-1].t_s - samples[0].t_s, samples[1].t_s - samples[0].t_s
    law = RecogniserLaw(span_s, max(QUIET_SHARE * span_s, SAMPLES_OFF * dt_s))
    sp = samples[0].sp
    first = next((i for i, sample in enumerate(samples) if sample.sp != sp), len(samples))
    if first == len(samples):
        return None
    state = begin(samples[first].t_s, sp)
    for sample in samples[first:]:
        state = step(law, state, sample.t_s, sample.sp, sample.sp - sample.pv, band)
        if state.phase == RecogniserPhase.ADAPT:
            return response_of(state, band)
    return so_far(state, samples[-1].t_s, band)


# Loads of full size hide what one sequence shows. So what is left of each is kept, to be fitted together.


MOST_LAGS = 8
"""Highest lag of the autocovariance that is kept: the order of a noise filter."""
FOLLOWS_THE_LAW = 0.1
"""Share of co's moves that its law may leave open: rounding, and a sample's jitter."""


@dataclass(frozen=True, slots=True)
class Averaged:
    """The mean of the stretches of one sequence, and how they scatter.

    gains : in force all the time. dt_s : sampling interval. apart : samples from step to step.
    steps : sizes of the setpoint steps in order, the half step first, pv units. pv : mean from the setpoint before it
    all, turned to the sign of the last step, from that step on, shape (n,) with n <= apart.
    scatter : autocovariance of single stretches about their mean at lags 0, 1, ..., pv units squared. t_s : the end.

    Raises
    ------
    ValueError
        The series are too short or not finite, or nothing scatters.
    """

    gains: PidGains
    dt_s: float
    apart: int
    steps: tuple[float, ...]
    pv: tuple[float, ...]
    scatter: tuple[float, ...]
    t_s: float

    def __post_init__(self) -> None:
        if not MOST_LAGS < len(self.pv) <= self.apart or len(self.steps) <= WHOLE_STEPS:
            raise ValueError(f"{len(self.pv)} values of {self.apart} after {len(self.steps)} steps: none to average")
        numbers = (self.dt_s, self.t_s, *self.steps, *self.pv, *self.scatter)
        if not all(map(math.isfinite, numbers)) or self.dt_s <= 0:
            raise ValueError("an averaged response is not finite")
        if len(self.scatter) != MOST_LAGS + 1 or self.scatter[0] <= 0:
            raise ValueError("an averaged response needs the scatter of its stretches")

    @property
    def signs(self) -> tuple[float, ...]:
        """By which the stretches after the whole steps were turned."""
        return tuple(math.copysign(1.0, step * self.steps[-1]) for step in self.steps[1:])

    def said(self, response: FloatArray) -> FloatArray:
        """What the mean would be by the response to a unit step, of which `reach` samples are needed; shape (n,)."""
        mean = np.zeros(len(self.pv))
        for i, sign in enumerate(self.signs, 1):
            for j in range(i + 1):
                at = (i - j) * self.apart
                mean += sign * self.steps[j] * response[at : at + len(mean)]
        return mean / len(self.signs)

    @property
    def wander(self) -> float:
        """Standard deviation of pv by loads and noise alone, pv units."""
        return math.sqrt(self.scatter[0])

    @property
    def reach(self) -> int:
        """Samples from the first step to the end."""
        return len(self.signs) * self.apart + len(self.pv)


def averaged(
    samples: Sequence[LoopSample], found: ToAndFro, gains: PidGains, law: tuple[float, float]
) -> Averaged | None:
    """The last whole steps as a mean that a loop under these gains explains; None where co does not follow their law.

    law : setpoint weight, and filter time of the derivative in seconds.
    """
    whole, hold = found.whole[-WHOLE_STEPS:], found.apart
    end = min(found.closed or len(samples), whole[-1] + hold)
    n = end - whole[-1]
    own = samples[found.opened - 1 : end]
    if len(found.whole) != WHOLE_STEPS or n <= MOST_LAGS or any(sample.limited for sample in own):
        return None
    if not _follows(own, gains, law):
        return None
    t_s, pv = (np.array([getattr(s, name) for s in samples], dtype=np.float64) for name in ("t_s", "pv"))
    dt_s = float(np.median(np.diff(t_s[found.opened - 1 : end])))
    steps = [samples[at].sp - samples[at - 1].sp for at in (found.opened, *whole)]
    since_s = dt_s * np.arange(n)
    signs = [math.copysign(1.0, step * steps[-1]) for step in steps[1:]]
    rows = np.array(
        [s * (np.interp(t_s[k] + since_s, t_s, pv) - found.base) for s, k in zip(signs, whole, strict=True)]
    )
    left = (rows - rows.mean(axis=0)) * math.sqrt(len(rows) / (len(rows) - 1))
    scatter = [float(np.mean(np.sum(left[:, : n - k] * left[:, k:], axis=1)) / n) for k in range(MOST_LAGS + 1)]
    if not scatter[0] > 0:
        return None
    mean = tuple(rows.mean(axis=0).tolist())
    return Averaged(gains, dt_s, hold, tuple(steps), mean, tuple(scatter), float(t_s[end - 1]))


def _follows(samples: Sequence[LoopSample], gains: PidGains, law: tuple[float, float]) -> bool:
    """Whether co moves from sample to sample as the gains say: by pv of the same sample, or of the one before."""
    t_s, sp, pv, co = (np.array([getattr(s, name) for s in samples]) for name in ("t_s", "sp", "pv", "co"))
    b, filter_s = law
    dt_s, moved = np.diff(t_s), np.diff(co)
    slope, slopes = 0.0, [0.0]
    for rise, dt in zip(np.diff(pv).tolist(), dt_s.tolist(), strict=True):
        slope = (filter_s * slope + rise) / (filter_s + dt)
        slopes.append(slope)
    wanted = gains.kp * np.diff(b * sp - pv) + gains.ki * (sp - pv)[:-1] * dt_s - gains.kd * np.diff(slopes)
    left = min(float(np.std(moved - wanted)), float(np.std(moved[1:] - wanted[:-1])))
    return left <= FOLLOWS_THE_LAW * float(np.std(moved))
