"""Which message first, where a controller takes a gain set in several: every set between must be proved as well.

Between the first message and the last the loop runs on some of the new numbers and some of the old. That is short, but
a loop that is unstable there moves, and nobody watches for it. So each set between must be stable on every model that
the records still allow, and no less robust than the limit or than the worse of the two ends.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.schedule.gains import PidGains
from retuner.schedule.vendor_units import Way


class ChosenWay(NamedTuple):
    """An order of the messages. ms_worst : largest Ms of a set between on any allowed model; NaN without one."""

    messages: tuple[int, ...]
    ms_worst: float


def proved_way(
    ways: Sequence[Way],
    ends: tuple[PidGains, PidGains],
    models: Sequence[Plausible],
    sample_time_s: float,
    limit: float,
    filter_s: float = 0.0,
) -> ChosenWay | None:
    """The order whose sets between are the most robust; None when there is none that is proved.

    ways : the possible ones. ends : the sets before and after. models : that the records allow; without any nothing is
    proved. limit : largest Ms between, unless an end has a larger finite one.
    """
    if not models:
        return None
    processes = [p.model.seen_by_controller(sample_time_s).linear() for p in models]

    def worst(gains: PidGains) -> float:
        return max(sensitivity_peak(process, gains, filter_s) for process in processes)

    at_ends = [ms for ms in map(worst, ends) if math.isfinite(ms)]
    most = max([limit, *at_ends])
    found = [ChosenWay(way.messages, max(map(worst, way.between), default=1.0)) for way in ways]
    best = min(found, key=lambda way: way.ms_worst, default=None)
    return best if best is not None and best.ms_worst <= most else None


def gentlest_way(ways: Sequence[Way]) -> ChosenWay | None:
    """Without a model: the order with the longest integral times between, then the smallest gains.

    No proof of anything, but on most processes the safer one: it is how the way back to a verified set is chosen when
    nothing is known.
    """

    def roughness(way: Way) -> tuple[float, float]:
        rates = [gains.ki / gains.kp if gains.kp else math.inf for gains in way.between]
        return max(rates, default=0.0), max((abs(gains.kp) for gains in way.between), default=0.0)

    best = min(ways, key=roughness, default=None)
    return None if best is None else ChosenWay(best.messages, math.nan)
