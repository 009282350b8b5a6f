"""What is known before any record: a dead time is seldom a small share of the second lag, an inverse response seldom
many times as long as it.

    one standard deviation for every e-fold and a bit that theta lies below a share of c2, or b above some times c2

A record of loads hardly shows a dead time: the unknown time of the load takes it up, and the likelihood is level from
theta = 0 to the truth. The best fit then ends at no dead time at all, and settings for that are too strong. But what is
fitted with two lags has more of them in truth, a valve and a sensor, and those are its dead time. Where a record does
show that there is none (a setpoint step, manual), this much is soon outvoted.
"""

import math

import numpy as np

from retuner.adaptive.fit.refine import Prior
from retuner.adaptive.fit.structure import INVERSE, SECOND, SIZE, THETA, THIRD
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray

LEAST_SHARE = 0.5  # share of c2 from which a dead time is nothing unusual (lags in series, fitted by two: 0.4 to 2)
MOST_TIMES = 2.0  # times c2 up to which an inverse response is nothing unusual
RARE = {ProcessType.SOPDT_LEAD: 2 * math.log(20)}  # -2 ln of how often a structure comes: one process in twenty leads
SPREAD = 1.2  # standard deviation of ln theta below it


def unusual(type_: ProcessType, x: FloatArray) -> float:
    """How many standard deviations something is unusual; 0 without a second lag.

    A dead time too short beside the second lag, or an inverse response too long.
    """
    if type_ not in SECOND:
        return 0.0
    if type_ == ProcessType.SOPDT_INVERSE:  # which is as good as a dead time
        return max(float(x[INVERSE[type_]] - x[SECOND[type_]]) - math.log(MOST_TIMES), 0.0) / SPREAD
    return max(math.log(LEAST_SHARE) + float(x[SECOND[type_]] - x[_dead(type_, x)]), 0.0) / SPREAD


def _dead(type_: ProcessType, x: FloatArray) -> int:
    """Place of what delays most: the dead time, or a third lag that is as good as one."""
    return THIRD[type_] if type_ in THIRD and x[THIRD[type_]] > x[THETA] else THETA


def usual(type_: ProcessType, x: FloatArray) -> Prior | None:
    """The prior that holds at the parameters x; None where all is usual, or the structure has one lag."""
    if unusual(type_, x) <= 0:
        return None
    row = np.zeros((1, SIZE[type_]))
    place, ratio = (
        (INVERSE[type_], MOST_TIMES) if type_ == ProcessType.SOPDT_INVERSE else (_dead(type_, x), LEAST_SHARE)
    )
    row[0, place], row[0, SECOND[type_]] = 1 / SPREAD, -1 / SPREAD
    return Prior(row, np.array([math.log(ratio) / SPREAD]))
