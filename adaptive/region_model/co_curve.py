"""How strongly a percent of co acts over co, as several records show it: the slope of the installed characteristic.

    s = d ln phi'(u) / du      s = 0 with probability 1/2 before any record, else N(0, w^2), w = 2 x 0.7 / travel of co

One record hardly tells a valve's curve from a process that changes along pv; all of them together do, because the valve
is the same in every region. So each record says by itself what s is, with its variance, and the next one begins with
what the others said: the mean of both hypotheses by their probability (a Bayes factor; Kass & Raftery 1995), and the
variance of both. Where no curve is to be seen, s goes to zero and costs nothing.
"""

import math
from collections.abc import Iterable

from retuner.adaptive.schedule_design.record_stretches import SLOPE_STD
from retuner.schedule.late_dataclass import dataclass

TOO_SURE = 2.0
"""What a record says of s is off by so many times what it claims: the curves over pv have few bends. Looked at while
this was built: 65 records of tours of a tank and a drive (seeds 77, 79); the worst was off by 2.9 times its claim."""
MOST_LOG = 500.0  # logarithm of a Bayes factor beyond which it is certainty


@dataclass(frozen=True, slots=True)
class CoCurve:
    """What is known of s. slope : in 1/(unit of co). std : its standard deviation.

    Raises ValueError: slope is not finite, or std not finite and above 0.
    """

    slope: float
    std: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.slope) and 0 < self.std < math.inf):
            raise ValueError(f"slope {self.slope} of co's curve, std {self.std}: finite, std above 0")


def before(records: Iterable[CoCurve], travel: float) -> CoCurve:
    """What the records so far say of s, for a record in which co goes over `travel`, above 0."""
    widest = 2 * SLOPE_STD / travel
    weights = [(one, 1 / (TOO_SURE * one.std) ** 2) for one in records]
    precision = 1 / widest**2 + sum(weight for _, weight in weights)
    mean, variance = sum(one.slope * weight for one, weight in weights) / precision, 1 / precision
    factor = 0.5 * (math.log(variance / widest**2) + mean**2 / variance)
    curved = 1 / (1 + math.exp(-min(max(factor, -MOST_LOG), MOST_LOG)))
    spread = curved * variance + curved * (1 - curved) * mean**2
    return CoCurve(curved * mean, max(math.sqrt(spread), widest * math.exp(-MOST_LOG)))


def added(known: CoCurve, now: CoCurve) -> CoCurve | None:
    """What one record adds to what was known; None where that is nothing. now : what is known with it."""
    more = 1 / now.std**2 - 1 / known.std**2
    if not more > 1e-6 / known.std**2:
        return None
    return CoCurve((now.slope / now.std**2 - known.slope / known.std**2) / more, 1 / math.sqrt(more))
