"""Does a response show the swing that a model says the loop has, and none that it does not have?

A loop that came to rest is not unstable, and one that swings is not sluggish.

    e1, e2, e3    peaks of the model's response under the gains in force, in units of the first
    refuted       the error came to rest, and no third peak was seen that should have stood out of the noise
                  three peaks were seen, and the last is far smaller than the model's
    not sluggish  successive peaks in a ratio of more than `sluggish_decay` (trial/shape.py)

An upset of unknown shape on top of a step is fitted best by a process that all but swings: with two loads beside it,
such a process explains any response to the noise. What it says of the loop itself can be looked at.
"""

from retuner.adaptive.diagnosis.online import SwingSettings
from retuner.adaptive.process import ProcessModel
from retuner.adaptive.response import Ending, Response
from retuner.adaptive.trial.closed_responses import Loop, Upset, traces
from retuner.adaptive.trial.shape import peaks_of, swing
from retuner.schedule.gains import PidGains

THIRD = 3
"""Peaks that tell a swing."""


def not_seen(
    response: Response, model: ProcessModel, in_force: PidGains, b: float, tau_f_s: float, settings: SwingSettings
) -> str:
    """Why a response refutes a model that says the loop swings, empty when it does not.

    Parameters
    ----------
    model : of the process, with the dead time of sampling. in_force : gains of the response. b, tau_f_s : weight of the
        setpoint and filter of the derivative, s.
    """
    seen = [abs(peak.e) for peak in response.peaks]
    upset = Upset(setpoint=1.0) if response.sp_changed else Upset(load_step=1.0)
    said = [abs(e) for e in peaks_of(traces([Loop(model.linear(), in_force, b, tau_f_s)], [upset])[0][0].e)]
    if not seen or len(said) < THIRD or not said[0]:
        return ""
    third = said[2] / said[0] * seen[0]
    least = settings.unseen_bands * response.band
    if len(seen) < THIRD:
        missing = response.ending == Ending.QUIET and third > least
        return f"{_says(third)}, and the error came to rest after {len(seen)}" if missing else ""
    if seen[2] + least > settings.shown * third:
        return ""
    return f"{_says(third)}, and it was {seen[2]:.3g}"


def swings_anyway(response: Response, settings: SwingSettings) -> str:
    """Why a response is not that of a sluggish loop, empty when it may be."""
    decay = swing([peak.e for peak in response.peaks], response.band)[2]
    if decay <= settings.sluggish_decay:
        return ""
    return f"by the model that fits, the loop is sluggish, and its successive peaks are in the ratio {decay:.2f}"


def _says(third: float) -> str:
    return f"by the model that fits, the loop swings: the third peak would be {third:.3g}"
