"""First order + dead time from an asymmetric relay: exact, not by the describing function (Wang, Hang & Zou 1997).

About the rest point (the relay's reference, and the co that holds it) with levels u+ > 0 > u-, hysteresis eps and
h = k u+, l = k u-, the limit cycle of k e^(-theta s)/(tau s + 1) has
    largest pv    A+ = h + (eps - h) e^(-theta/tau)            smallest pv   A- = l - (eps + l) e^(-theta/tau)
    upper half    t+ = theta + tau ln((h - A-)/(h - eps))      lower half    t- = theta + tau ln((A+ - l)/(-eps - l))
and its mean gives the gain: k = mean(pv)/mean(co), both over whole waves from the rest point. So
    e^(-theta/tau) = ((h - A+) + (A- - l)) / ((h - eps) + (-eps - l)),  tau = (t+ + t-)/(2 theta/tau + both logarithms)
The mean of co must be off the rest point, hence the asymmetry. theta includes the delay of the switching itself.
"""

import math

from retuner.adaptive.experiments.relay import RelayCycle
from retuner.adaptive.process import ProcessModel, ProcessType

SMALLEST_OFFSET = 0.03
"""The mean of co must be this share of the relay's amplitude away from rest for k to be known."""


def first_order(cycle: RelayCycle, pv_rest: float, co_rest: float) -> ProcessModel:
    """The model behind a biased relay's limit cycle.

    Parameters
    ----------
    cycle : as read off the record. pv_rest : the relay's reference, where pv rested under co_rest.

    Raises
    ------
    ValueError
        The relay is symmetric, or the wave is not one of a first-order process at rest there.
    """
    co, pv = cycle.co_mean - co_rest, cycle.pv_mean - pv_rest
    if abs(co) < SMALLEST_OFFSET * cycle.co_amplitude:
        raise ValueError(f"the mean of co is only {co:.3g} off the rest point (a symmetric relay, or a nearly "
                         "integrating process), so the process gain does not show; use the fit")  # fmt: skip
    k = pv / co
    sign = math.copysign(1.0, k)
    high, low = sorted((sign * (cycle.pv_high - pv_rest), sign * (cycle.pv_low - pv_rest)), reverse=True)
    h, low_end = abs(k) * (cycle.co_high - co_rest), abs(k) * (cycle.co_low - co_rest)
    eps = cycle.hysteresis
    share = ((h - high) + (low - low_end)) / ((h - eps) + (-eps - low_end))
    if not (0 < share < 1 and h > max(high, eps) and low_end < min(low, -eps)):
        raise ValueError("this limit cycle is not that of a first-order process with dead time (an integrating or a "
                         "strongly lagging one); use the fit")  # fmt: skip
    theta_ratio = -math.log(share)
    rise, fall = math.log((h - low) / (h - eps)), math.log((high - low_end) / (-eps - low_end))
    tau = (cycle.high_s + cycle.low_s) / (2 * theta_ratio + rise + fall)
    return ProcessModel(ProcessType.FOPDT, k, tau, 0.0, theta_ratio * tau)
