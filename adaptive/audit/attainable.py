"""What a loop's error would have been with other settings, at the loads that were seen.

The loads need not be known. What another controller does otherwise acts through the process alone, and adds to what was
recorded, however many loads there were:

    y' = y + G (u' - u),    u' = C' (sp - y')

with y, u on record, G the identified process and C' the other controller. With C' the controller in force y' = y. The
process is stepped exactly for inputs that are held between samples, its dead time any real number of intervals.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from retuner.adaptive.fit.dynamics import SamplingInstants
from retuner.adaptive.loop.simulate import HeldInput
from retuner.adaptive.process.model import LinearProcess, ProcessModel
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule import pid
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

PERCENT = (0.0, 100.0)  # range of co, where the record stays in it
FILTERED = 10.0  # the derivative's filter: its time over this
MODELS = 7  # models that are asked at most: the best, and some of the others that the record allows


@dataclass(frozen=True, slots=True)
class Foreseen:
    """Error and work of co as they were, and with other settings.

    error : integral of |sp - pv|, pv units times s. travel : sum of |changes of co|. Each: then, and now on record.
    span_s : time that they are of. saved : share of the error that would go, by the best model; may be negative.
    least, most : the same by the models that the record allows. calmer : share of the travel that would go.
    """

    span_s: float
    error: tuple[float, float]
    travel: tuple[float, float]
    saved: float
    least: float
    most: float
    calmer: float


class _CountedLoops(NamedTuple):
    """Integral of |error| and travel of co."""

    error: float
    travel: float


def foreseen(records: Sequence[Window], models: Sequence[ProcessModel], gains: PidGains) -> Foreseen | None:
    """What the settings would have made of the records.

    records : of one loop in automatic. models : of its process, the best first, and others that the record allows.
    gains : the settings that are asked about.

    None where a record has no error at all, or where the best model is no longer stable under the settings.
    """
    even = [_evenly(record) for record in records]
    was = _summed([_counted(record.sp - record.pv, record.co, dt_s) for record, dt_s in even])
    asked = [models[int(i)] for i in np.unique(np.linspace(0, len(models) - 1, min(MODELS, len(models))))]
    then = [_summed([_with(record, dt_s, model.linear(), gains) for record, dt_s in even]) for model in asked]
    if was.error <= 0 or not math.isfinite(then[0].error + then[0].travel):
        return None
    saved = sorted(1 - one.error / was.error for one in then if math.isfinite(one.error))
    return Foreseen(
        span_s=sum(len(record.t_s) * dt_s for record, dt_s in even),
        error=(then[0].error, was.error),
        travel=(then[0].travel, was.travel),
        saved=1 - then[0].error / was.error,
        least=saved[0] if len(saved) == len(then) else -math.inf,
        most=saved[-1],
        calmer=1 - then[0].travel / was.travel if was.travel > 0 else 0.0,
    )


def _summed(parts: Sequence[_CountedLoops]) -> _CountedLoops:
    return _CountedLoops(sum(part.error for part in parts), sum(part.travel for part in parts))


def _counted(error: FloatArray, co: FloatArray, dt_s: float) -> _CountedLoops:
    return _CountedLoops(float(np.sum(np.abs(error))) * dt_s, float(np.sum(np.abs(np.diff(co)))))


def _evenly(record: Window) -> tuple[Window, float]:
    """A record at even intervals, in s: itself, or read off at the usual one, co as it was held."""
    clock = SamplingInstants.of(record.t_s)
    if clock.dt_s is not None:
        return record, clock.dt_s
    dt_s = record.sample_time_s
    t_s = np.arange(record.t_s[0], record.t_s[-1], dt_s)
    held = np.searchsorted(record.t_s, t_s, side="right") - 1
    return Window(t_s, record.sp[held], np.interp(t_s, record.t_s, record.pv), record.co[held]), dt_s


def _with(record: Window, dt_s: float, process: LinearProcess, gains: PidGains) -> _CountedLoops:
    """Error and travel with other settings; infinite where the loop does not hold."""
    low, high = float(np.min(record.co)), float(np.max(record.co))
    ends = PERCENT if PERCENT[0] <= low <= high <= PERCENT[1] else (2 * low - high - 1, 2 * high - low + 1)
    tau_f_s = abs(gains.kd / gains.kp) / FILTERED if gains.kd and gains.kp else 0.0
    law = pid.law(gains, tau_f_s=tau_f_s, co_min=ends[0], co_max=ends[1])
    moved = HeldInput(process, dt_s)
    sp, pv, co = record.sp.tolist(), record.pv.tolist(), record.co.tolist()
    state: pid.StateTuple = pid.start(law, sp[0], pv[0], co[0])
    errors, outputs = [sp[0] - pv[0]], [co[0]]
    for i in range(1, len(sp)):
        there = pv[i] + moved.step(outputs[-1] - co[i - 1])
        if not abs(there) < math.inf:
            return _CountedLoops(math.inf, math.inf)
        state, out = pid.step(law, state, sp[i], there, dt_s)
        errors.append(sp[i] - there)
        outputs.append(out)
    return _counted(np.array(errors), np.array(outputs), dt_s)
