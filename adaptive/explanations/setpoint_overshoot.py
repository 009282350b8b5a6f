"""What the overshoot of setpoint responses says of the processes that a record allows.

    ln L = -1/2 (max(o - o_i, 0) / s)^2,      s^2 = READING^2 + (LOADS sigma / step)^2

o is the overshoot that was read, o_i the one that process i has with the gains in force, sigma the usual error of the
record. A loop that overshoots less than it should says nothing: its setpoint may be weighted or filtered. One that
overshoots more does not have that process. The likelihood of co and pv (wandering_load.py) knows no setpoint, so a load
that came with the step could explain any response; but loads do not wait for setpoint steps.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from retuner.adaptive.explanations.process_grid import DEAD_TIMES, GAINS, gain_unit, shapes
from retuner.adaptive.explanations.tuning_odds import CLASSES, TuningLimits, TuningOdds, class_of, shares_of
from retuner.adaptive.signals.sample import FloatArray, median
from retuner.schedule.late_dataclass import dataclass, replace

READING = 0.1  # standard deviation of an overshoot as it is read where nothing disturbs it
LOADS = 2.0  # A load moves the peak and the step before it: usual errors by which both together are off
LIKELIEST = 60
"""Processes of each class whose overshoot is worked out; the others of the class count as these do together."""
LONGEST = 400  # samples of a step response that are looked at


@dataclass(frozen=True, slots=True)
class RecordOvershoot:
    """overshoot : of the setpoint responses of a record, a share of the step. std : of that."""

    overshoot: float
    std: float

    @classmethod
    def of(cls, error: FloatArray, overshoot: float, step: float) -> "RecordOvershoot":
        """error : sp - pv of the record, shape (n,). step : size of its setpoint steps, pv units."""
        usual = 1.4826 * median(np.abs(error - median(error)))
        return cls(overshoot, math.hypot(READING, LOADS * usual / step))


def with_overshoot(odds: TuningOdds, seen: Sequence[RecordOvershoot], limits: TuningLimits) -> TuningOdds:
    """The odds once the setpoint responses of these records were looked at as well."""
    if not seen or not (odds.gains.kp or odds.gains.ki):
        return odds
    classes = class_of(odds.robustness, odds.gains, odds.sample_time_s, limits)
    weights = odds.weights.copy()
    of_kind = [np.flatnonzero((classes == kind).ravel() & (weights.ravel() > 0.0)) for kind in range(len(CLASSES))]
    chosen = [inside[np.argsort(-weights.ravel()[inside], kind="stable")[:LIKELIEST]] for inside in of_kind]
    ends = np.cumsum([len(likeliest) for likeliest in chosen])
    every = np.split(_overshoots(odds, np.concatenate(chosen)), ends[:-1])  # all at once: a loop over samples
    for inside, likeliest, own in zip(of_kind, chosen, every, strict=True):
        if not len(inside):
            continue
        likelihood = np.exp(-0.5 * sum(np.maximum((one.overshoot - own) / one.std, 0.0) ** 2 for one in seen))
        known = weights.ravel()[likeliest]
        weights.ravel()[inside] *= float(known @ likelihood / known.sum())
        weights.ravel()[likeliest] = known * likelihood
    total = float(weights.sum())
    if not total > 0.0:
        return odds
    weights /= total
    found = replace(odds, weights=weights)
    return replace(found, classes=shares_of(found, classes, limits))


def _overshoots(odds: TuningOdds, chosen: npt.NDArray[np.intp]) -> FloatArray:
    """Overshoot of each of these processes of the grid (flat indexes) after a setpoint step, with P and I in force."""
    rows, dead, gain = np.unravel_index(chosen, odds.weights.shape)
    every = shapes()
    lags, seconds = (np.array([getattr(every[i], name) for i in rows]) for name in ("lag", "second"))
    pole = np.exp(-1.0 / lags)
    other = np.where(seconds > 0.0, np.exp(-1.0 / np.maximum(seconds, 1e-9)), 0.0)
    unit = gain_unit(odds.gains, odds.sample_time_s) / odds.robustness.scale
    size = GAINS[gain] * np.array([every[i].unit for i in rows]) / unit
    rate = size * np.where(np.isinf(lags), 1.0, 1.0 - pole)
    whole = np.array(DEAD_TIMES)[dead].round().astype(int)
    kp, ki = abs(odds.gains.kp), abs(odds.gains.ki) * odds.sample_time_s
    each = np.arange(len(chosen))
    co = np.zeros((LONGEST, len(chosen)))
    first, pv, total, highest = (np.zeros(len(chosen)) for _ in range(4))
    for i in range(LONGEST):
        error = 1.0 - pv
        total = total + ki * error
        co[i] = kp * error + total
        moved = np.where(i >= whole, co[np.maximum(i - whole, 0), each], 0.0)
        first = pole * first + rate * moved
        pv = np.clip(other * pv + (1.0 - other) * first, -10.0, 10.0)
        highest = np.maximum(highest, pv)
    return np.asarray(highest - 1.0, dtype=np.float64).clip(0.0)
