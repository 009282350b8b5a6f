"""A swing that the output's limits hold up: an unstable loop in a limit cycle, not a disturbance from outside.

A linear loop that is unstable swings ever wider until the output reaches a limit. The limit is a gain that falls with
the amplitude and turns no phase, so the cycle settles where the phase of L is -180 degrees (describing function of a
saturation, Gelb & Vander Velde 1968, section 2.3):

    co touches a limit in every cycle,   gain margin < 1,   period = 2 pi / w180

A tone from outside has no reason to lie at w180. To the fits the two look alike: both are regular.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.oscillation_online import SwingSettings
from retuner.adaptive.loop.margins import margins
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.trial.batch_responses import ClosedLoop, Trace, Upset, traces
from retuner.adaptive.trial.response_numbers import peaks_of
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

MOST_HALVINGS = 8  # halvings of the gain that are tried for a stable loop
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


# Does a response show the swing that a model says the loop has?
#
#     e1, e2, e3    peaks of the model's response under the gains in force, in units of the first
#     refuted       the error came to rest, and no third peak was seen that should have stood out of the noise by then
#                   three peaks were seen, and the last is far smaller than the model's
#
# An upset of unknown shape on top of a step is fitted best by a process that all but swings: with two loads beside it,
# such a process explains any response to the noise. What it says of the loop itself can be looked at.


THIRD = 3  # peaks that tell a swing


def not_seen(response: Response, foretold: Trace, settings: SwingSettings) -> str:
    """Why a response refutes a model that says the loop swings, empty when it does not.

    foretold : the error after an upset like this one, by the model (see `foretold`).
    """
    seen = [abs(peak.e) for peak in response.peaks]
    if not seen:
        return ""
    least = settings.unseen_bands * response.band
    said = [abs(e) for e in peaks_of(foretold.e, THIRD + 1)]
    # the model's first peak may be none that a response shows: pv goes the wrong way at first, by hardly anything
    unnoticed = int(len(said) > 1 and said[0] < said[1] and said[0] / said[1] * seen[0] < least)
    said = said[unnoticed:]
    if len(said) < THIRD or not said[0]:
        return ""
    second, third = (said[i] / said[0] * seen[0] for i in (1, 2))
    told = (
        f"the loop refutes the model that fits: by it the third peak of the error would be {third:.3g} in units of pv"
    )
    if len(seen) < THIRD:  # a swing that rides on a slow return does not cross over, and shows no peaks
        due = _due(response, foretold, said, unnoticed, settings) * seen[0] / said[0]
        missing = response.ending == Ending.QUIET and settings.shown * min(second, due) > least
        return f"{told}, but the error came to rest after {len(seen)}" if missing else ""
    if seen[2] + least > settings.shown * third:
        return ""
    return f"{told}, and was {seen[2]:.3g}"


def _due(response: Response, trace: Trace, said: list[float], unnoticed: int, settings: SwingSettings) -> float:
    """How high the third peak would have been by the end of the response, by the model.

    A slow swing may pass its band for longer than rest takes. After a setpoint step that can be told; when a load began
    cannot, and a swing that lasts has no rest: there the whole peak is due.
    """
    if not response.sp_changed or said[2] > settings.shown * said[0]:
        return said[2]
    looked = trace.e[: int((response.t_end_s - response.t_start_s) / trace.step_s) + 1]
    by_then = peaks_of(looked, THIRD + unnoticed)[THIRD + unnoticed - 1 :]
    return abs(by_then[0]) if by_then else 0.0


def foretold(response: Response, loop: ClosedLoop, ramp_s: float = 0.0) -> Trace:
    """The error after an upset like this one, by a model.

    loop : the model, with the dead time of sampling, under the gains of the response. ramp_s : for how long the load
    moved; a ramp is answered by the mean of the answers to the steps that it is made of.
    """
    upset = Upset(setpoint=1.0) if response.sp_changed else Upset(load_step=1.0)
    trace = traces([loop], [upset])[0][0]
    steps = min(round(ramp_s / trace.step_s), len(trace.e))
    if response.sp_changed or steps < 1:
        return trace
    summed = np.concatenate([np.zeros(steps), np.cumsum(trace.e)])
    return replace(trace, e=(summed[steps:] - summed[:-steps]) / steps)
