"""A loop whose setpoint goes to and fro while loads move it: what is kept of it, so that the process can be fitted.

    pv = T(G) sp + v,    v = S(G) d + n        T = G C / (1 + G C), S = 1 / (1 + G C)

What the setpoint did is known, and a load knows nothing of it. How pv moves before the first step is what loads make of
it by themselves: that is kept with it, for it tells how much is to be believed of the rest.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.signals.sample import FloatArray, LoopMode, LoopSample, median
from retuner.adaptive.signals.step_sequence import SetpointMove, StepSequence
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

LEAST_LEAD = 40  # samples before the first step that are needed to know how loads move the loop
SETTLED = 0.5
"""Share of the time since the setpoint moved last, before the first step, in which the loop still answers to that."""
FOLLOWS_THE_LAW = 0.1  # share of co's moves that its law may leave open: rounding, and a sample's jitter


@dataclass(frozen=True, slots=True)
class SetpointSteps:
    """pv of one loop under one set of gains, with what its setpoint did.

    gains : in force all the time. dt_s : sampling interval. steps : where the setpoint stepped, and by how much.
    pv : from the setpoint before the first step, even samples, pv units. t_s : the end.

    Raises ValueError: the series are too short or not finite.
    """

    gains: PidGains
    dt_s: float
    steps: tuple[SetpointMove, ...]
    pv: tuple[float, ...]
    t_s: float

    def __post_init__(self) -> None:
        places = [step.at for step in self.steps]
        if not places or places != sorted(set(places)) or places[0] < LEAST_LEAD or places[-1] >= len(self.pv):
            raise ValueError(f"{len(self.pv)} samples with setpoint steps at {places}: too few before or after them")
        numbers = (self.dt_s, self.t_s, *(step.size for step in self.steps), *self.pv)
        if not all(map(math.isfinite, numbers)) or self.dt_s <= 0:
            raise ValueError("a record of setpoint steps is not finite")

    @property
    def first(self) -> int:
        """Index of the first step: what came before is the loads' alone."""
        return self.steps[0].at

    @property
    def reach(self) -> int:
        """Samples from the first step to the end."""
        return len(self.pv) - self.first

    @property
    def largest(self) -> float:
        """Size of the largest step, pv units."""
        return max(abs(step.size) for step in self.steps)

    @property
    def wander(self) -> float:
        """Root mean square of pv by loads and noise alone, pv units."""
        return float(np.sqrt(np.mean(np.square(self.pv[: self.first]))))

    def said(self, response: FloatArray) -> FloatArray:
        """What the setpoint makes of pv by the response to a unit step, of which `reach` samples are needed."""
        made = np.zeros(len(self.pv))
        for at, size in self.steps:
            made[at:] += size * response[: len(made) - at]
        return made


def setpoint_steps(
    samples: Sequence[LoopSample], found: StepSequence, gains: PidGains, law: tuple[float, float]
) -> SetpointSteps | None:
    """What is kept of steps to and fro; None where co does not follow the law of these gains all the time, or too
    little was seen before.

    law : setpoint weight, and filter time of the derivative in seconds.
    """
    closed = found.closed if found.closed is not None else len(samples)
    # From where the loop moved by its loads alone, at most as long as from the first step on
    revision, base, begin = samples[found.opened].revision, samples[found.opened - 1].sp, found.opened
    while begin > 0 and samples[begin - 1].revision == revision and samples[begin - 1].sp == base:
        begin -= 1
    settled = begin + math.ceil(SETTLED * (found.opened - begin)) if begin > 0 else begin
    begin = max(settled, 2 * found.opened - closed)
    own = samples[begin:]
    if found.opened - begin < LEAST_LEAD or not _follows(own, gains, law):
        return None
    t_s, pv = (np.array([getattr(s, name) for s in own], dtype=np.float64) for name in ("t_s", "pv"))
    dt_s = median(np.diff(t_s))
    even = np.arange(t_s[0], t_s[-1] + dt_s / 2, dt_s)
    places = [found.opened, *found.whole, *([found.closed] if found.closed is not None else [])]
    moves = [(round((samples[at].t_s - t_s[0]) / dt_s), samples[at].sp - samples[at - 1].sp) for at in places]
    steps = tuple(SetpointMove(at, size) for at, size in moves if at < len(even))
    values = np.interp(even, t_s, pv) - found.base
    return SetpointSteps(gains, dt_s, steps, tuple(values.tolist()), float(t_s[-1]))


def _follows(samples: Sequence[LoopSample], gains: PidGains, law: tuple[float, float]) -> bool:
    """Whether co moves from sample to sample as the gains say: by pv of the same sample, or of the one before."""
    if any(sample.limited or sample.mode != LoopMode.AUTO for sample in samples):
        return False
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
