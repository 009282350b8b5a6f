"""The first records of a region fitted as one: one process, each record with its own rest, loads and gains.

What one record says by itself is a Gaussian round one optimum, and the first records are those of which that is least
true: a load leaves a bent ridge, three peaks do not tell a lag from an integrator, a swing that grows hides the gain at
rest. Taken in one after another they then contradict each other, or agree on a fiction. The samples themselves do not:
a process that explains them all at once is found by a single fit, whatever gains ran.

    pv_i / u_i, co_i / u_i      u_i the noise of record i, or how inexact any model is where that is more

A linear process is the same in any unit, so each record is counted in its own; else one burst of an unstable loop would
outweigh all that was seen at rest. Between two records stands a gap in time, after which the fit has a state and a load
of its own (fit/misfit.py).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.identification.candidate import MODEL_ERROR
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

MOST_RECORDS = 3
"""So many records are fitted as one; what is known goes on from there as a mean that follows the process."""
MOST_SAMPLES = 750
"""A record is kept in no more samples."""
GAP_SAMPLES = 6
"""Between two records stand so many sampling intervals: a gap to the fit."""
END_SAMPLES = 5
"""Where a record ends and the next one begins is the median of so many."""
LEAST_SAMPLES = 30
"""A record of which fewer are left at the interval of the slowest says too little to be fitted with it."""


def kept(window: Window) -> Window:
    """A record as it is kept: every second, fourth ... sample of a long one, so that records still go together."""
    while len(window.t_s) > MOST_SAMPLES:
        window = window.condensed(-(-len(window.t_s) // 2))
    return window


def unit_of(window: Window) -> float:
    """What the residuals of a record are counted in, pv units; 1 where pv never moved."""
    return max(noise_sigma(window.pv), window.noise_std, MODEL_ERROR * float(np.ptp(window.pv))) or 1.0


def may_be_joined(windows: Sequence[Window]) -> bool:
    """Whether enough of every record is left at the sampling interval of the one that was kept at the longest."""
    dt_s = max(window.sample_time_s for window in windows)
    return all(len(window.t_s) >= LEAST_SAMPLES * _every(window, dt_s) for window in windows)


def joined(windows: Sequence[Window]) -> Window:
    """Records as one, the oldest first, each in its own unit and from where the one before ended.

    What a later record repeats of an earlier one's time is left out, unless that would leave nothing of it.
    """
    dt_s = max(window.sample_time_s for window in windows)
    parts: list[Window] = []
    end_s = -np.inf
    for window in windows:
        own = _thinned(window, dt_s)
        later = own.t_s > end_s
        own = own.part(slice(int(np.argmax(later)), None)) if np.sum(later) >= END_SAMPLES else own
        parts.append(_after(parts[-1] if parts else None, own, dt_s))
        end_s = float(window.t_s[-1])
    t_s, sp, pv, co = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_s", "sp", "pv", "co"))
    return Window(t_s, sp, pv, co)


def _thinned(window: Window, dt_s: float) -> Window:
    """A record at about a sampling interval that it was not kept at."""
    return window.condensed(-(-len(window.t_s) // _every(window, dt_s)))


def _every(window: Window, dt_s: float) -> int:
    """Of how many samples one is left at such an interval."""
    return max(round(dt_s / window.sample_time_s), 1)


def _after(before: Window | None, window: Window, dt_s: float) -> Window:
    """A record in its own unit, set after another one."""
    unit = unit_of(window)
    sp, pv, co = window.sp / unit, window.pv / unit, window.co / unit
    t_s = window.t_s - window.t_s[0]
    if before is None:
        return Window(t_s, sp - sp[0], pv - sp[0], co - co[0])
    start_s = float(before.t_s[-1]) + GAP_SAMPLES * dt_s
    return Window(start_s + t_s, sp - sp[0] + before.sp[-1], _going_on(pv, before.pv), _going_on(co, before.co))


def _going_on(values: FloatArray, before: FloatArray) -> FloatArray:
    step = float(np.median(before[-END_SAMPLES:])) - float(np.median(values[:END_SAMPLES]))
    return np.asarray(values + step, dtype=np.float64)


def of_the_last(together: ModelEstimate, whole: Window, last: Window) -> ModelEstimate:
    """An estimate of all records, told of the last one: its unit, its time, and the loads that are in it."""
    unit, began_s = unit_of(last), float(whole.t_s[-1]) - float(last.t_s[-1] - last.t_s[0])
    own = tuple(float(last.t_s[0]) + t - began_s for t in together.load_times_s if t > began_s)
    return replace(
        together,
        load_times_s=own,
        residual_std=together.residual_std * unit,
        noise_std=together.noise_std * unit,
    )
