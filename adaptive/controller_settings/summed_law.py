"""The law of a controller over a whole record, where its single movements are lost.

    co = kp (sp - pv) + ki integral of (sp - pv) + a constant

A recorder that holds co, or draws lines through it, takes away the movements from which read_off.py tells settings.
The way that co goes in the long run stays: it shows the direction, and roughly how fast the integral acts. That is
enough to say that pv stands while co travels, and not enough for settings.
"""

import numpy as np

from retuner.adaptive.controller_settings.read_off import LawSettings, settings_in_force
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains

EXPLAINED = 0.98  # share of co's variance that the law must explain
DISAGREEMENT = 1.5  # largest ratio of ki in the two halves of the record


def summed_law(window: Window) -> PidGains | None:
    """Direction and rough gains, in parallel form and the record's units; None where the law does not hold.

    window : closed-loop record. The gain kp is left out where it comes out against the integral's direction: then the
    record shows the integral alone.
    """
    error = window.sp - window.pv
    steps = (error[1:] + error[:-1]) / 2 * np.diff(window.t_s)
    summed = np.concatenate([[0.0], np.cumsum(steps)])
    if not np.ptp(window.co) or not np.ptp(summed):
        return None
    both = _fitted(window.co, np.stack([summed, error], axis=1))
    found = both if both[0] * both[1] > 0 else _fitted(window.co, summed[:, None])
    columns = np.stack([summed, error], axis=1)[:, : len(found)]
    left = window.co - columns @ found
    if float(np.var(left)) > (1 - EXPLAINED) * float(np.var(window.co)):
        return None
    half = len(error) // 2
    first, second = (float(_fitted(window.co[p], columns[p])[0]) for p in (slice(half), slice(half, None)))
    if first * second <= 0 or max(first / second, second / first) > DISAGREEMENT:
        return None
    return PidGains(kp=float(found[1]) if len(found) > 1 else 0.0, ki=float(found[0]), kd=0.0)


def _fitted(co: FloatArray, columns: FloatArray) -> FloatArray:
    centred = columns - columns.mean(axis=0)
    scale = np.linalg.norm(centred, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray(np.linalg.lstsq(centred / scale, co - co.mean(), rcond=None)[0] / scale)


ROUGHLY = LawSettings(explained_limit=0.5, std_limit=0.5, disagreement=2.0, slow_disagreement=2.0)
"""A direction and a rough integral time are enough: a stuck valve hides the settings themselves."""


def rough_law(window: Window) -> PidGains | None:
    """Settings read off a record as well as it shows them: enough where a direction and an integral time are."""
    return settings_in_force(window, settings=ROUGHLY).gains or summed_law(window)
