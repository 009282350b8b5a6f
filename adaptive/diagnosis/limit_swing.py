"""A swing that the output's limits hold up: an unstable loop in a limit cycle, not a disturbance from outside.

A linear loop that is unstable swings ever wider until the output reaches a limit. The limit is a gain that falls with
the amplitude and turns no phase, so the cycle settles where the phase of L is -180 degrees (describing function of a
saturation, Gelb & Vander Velde 1968, section 2.3):

    co touches a limit in every cycle,   gain margin < 1,   period = 2 pi / w180

A tone from outside has no reason to lie at w180. To the fits the two look alike: both are regular.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.margins import margins
from retuner.adaptive.process import ProcessModel
from retuner.adaptive.response import Response
from retuner.adaptive.sample import LoopSample
from retuner.schedule.gains import PidGains

MOST_HALVINGS = 8
"""Halvings of the gain that are tried for a stable loop."""
FOREIGN_SWINGS = frozenset({Cause.EXTERNAL, Cause.SATURATION, Cause.UNKNOWN})
"""Verdicts on a swing that do not count when it is held up by the output's limits; a stuck valve does."""


@dataclass(frozen=True, slots=True)
class LimitSwingSettings:
    """Settings.

    cycles : cycles of the swing that are looked at; 1 to 5, default 2.
    touched : share of them in which co stood at a limit; 0.5 to 1, default 1.
    gm_most : gain margin up to which the loop may be the cause; 0.8 to 1.5, default 1.2 (the model is not exact).
    off_crossover : |ln| of the period over 2 pi / w180 up to which the two agree; 0.05 to 0.5, default 0.25.
    """

    cycles: int = 2
    touched: float = 1.0
    gm_most: float = 1.2
    off_crossover: float = 0.25


def touches_limits(samples: Sequence[LoopSample], response: Response, settings: LimitSwingSettings) -> bool:
    """Whether the output reached a limit in every cycle of a swing. samples : kept, the newest last."""
    period_s = response.period_s
    if period_s is None:
        return False
    end_s = samples[-1].t_s
    touched = [False] * settings.cycles
    for sample in reversed(samples):
        cycle = int((end_s - sample.t_s) / period_s)
        if cycle >= settings.cycles:
            break
        touched[cycle] = touched[cycle] or bool(sample.limited)
    return sum(touched) >= settings.touched * settings.cycles


def at_own_crossover(response: Response, model: ProcessModel, gains: PidGains, settings: LimitSwingSettings) -> bool:
    """Whether a swing is the one that the loop would make by itself: no gain margin, and the period of w180.

    model : the process, sampling included. gains : in force.
    """
    gm, w180 = _crossover(model, gains)
    if response.period_s is None or not gm <= settings.gm_most or not math.isfinite(w180):
        return False
    return abs(math.log(response.period_s * w180 / (2 * math.pi))) <= settings.off_crossover


def _crossover(model: ProcessModel, gains: PidGains) -> tuple[float, float]:
    """Gain margin (below 1 for an unstable loop) and w180, read where less gain makes the loop stable."""
    for halvings in range(MOST_HALVINGS):
        share = 0.5**halvings
        found = margins(model.linear(), PidGains(gains.kp * share, gains.ki * share, gains.kd * share))
        if found.stable:
            return found.gm * share, found.w180
    return 0.0, math.inf
