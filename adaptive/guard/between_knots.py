"""What runs at the far places of a region, where the process is no longer its own.

Between the knots of an interpolated table that is the mean of two sets, on a process between two. In a table of steps
it is the region's own set up to its border. The records of a region show its middle, so nobody would ask there.

Where the process gain is r times as large at the next knot it is sqrt(r) times as large half way, and the mean of two
gains that suit their knots is (1 + 1/r)/2 of the first. Their product exceeds that at the knots by
(sqrt(r) + 1/sqrt(r))/2: 6 % for r = 2, 25 % for r = 4. So sets that suit both knots may be too much between them, and a
region answers for its own half of every way to a neighbour. Up to a border of a table of steps it is sqrt(r) whole.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from retuner.adaptive.guard.both_sides_of_border import likeliest_between, mixed
from retuner.adaptive.guard.request import NeighbourBorder
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel
from retuner.schedule.gains import PidGains

OWN_HALF = (0.25, 0.5)
"""Weights of the neighbour at the places that a region answers for."""
EASED = (1.0, 0.94, 0.88, 0.82, 0.76, 0.7, 0.65, 0.6, 0.55, 0.5)
"""Shares of the wanted gains that are tried: where less is needed, it is the neighbour's set that is too much."""


class PlaceBetween(NamedTuple):
    """The place of largest Ms on the region's part of the ways to its neighbours. to : name of that neighbour."""

    ms: float
    to: str


def worst_between(
    borders: Sequence[NeighbourBorder],
    own: ProcessModel,
    gains: PidGains,
    sample_time_s: float,
    filter_s: float = 0.0,
) -> PlaceBetween | None:
    """The worst place by the best models; None where nothing is known beyond any border.

    Parameters
    ----------
    borders : of the region. own : its process at its knot. gains : its set. filter_s : filter time of the derivative.
    """
    asked = [
        PlaceBetween(_ms(border, own, gains, share, sample_time_s, filter_s), border.name)
        for border in borders
        if border.interpolated or border.models
        for share in (OWN_HALF if border.interpolated else (border.reach,))
    ]
    return max(asked, default=None)


def _ms(
    border: NeighbourBorder, own: ProcessModel, gains: PidGains, share: float, sample_time_s: float, filter_s: float
) -> float:
    process = likeliest_between(border, own, share).seen_by_controller(sample_time_s).linear()
    return sensitivity_peak(process, mixed(gains, border, share), filter_s)


def eased(
    wanted: PidGains,
    borders: Sequence[NeighbourBorder],
    own: ProcessModel,
    limit: float,
    sample_time_s: float,
    filter_s: float = 0.0,
) -> PidGains:
    """The largest share of the wanted gains that keeps Ms within a limit on the region's part; arguments as above.

    Where no share does, the one of least Ms: of an integrating process, less gain at the same tau_I may be less robust.
    """
    least, easiest = math.inf, wanted
    for share in EASED:
        gains = PidGains(wanted.kp * share, wanted.ki * share, wanted.kd * share)
        found = worst_between(borders, own, gains, sample_time_s, filter_s)
        if found is None or found.ms <= limit:
            return gains
        if found.ms <= least:
            least, easiest = found.ms, gains
    return easiest
