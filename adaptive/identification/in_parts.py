"""A record that says too little as a whole, part by part: one process, loads of their own in every part.

A long record is condensed for one fit until its dead time is shorter than a row, and has more loads than one search
finds; a part of it has few, at full resolution. Parts end where the setpoint moves. Each is fitted by itself; then all
are joined as the stretches of a region are (by_region.py). The joint estimate stands only if every part that is
identifiable by itself agrees with it.
"""

import math
from itertools import pairwise

import numpy as np

from retuner.adaptive.fit.record import apart, setpoint_changes
from retuner.adaptive.identification.by_region import RegionRecord, identify_region
from retuner.adaptive.identification.dead_time_bound import bounded
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.identification.identify import FitSettings, identify_window
from retuner.adaptive.signals.sample import Window

SHORTEST = 150  # samples of a part
MOST_PARTS = 8
MOST_FITTED = 24  # parts that are fitted: of a longer record those in which pv moves most
LEAD = 10  # Samples of a part before the setpoint moves in it, which show where the loop stood
FEWEST_PARTS = 2
MOST_APART = 1.0
"""Distance (coincident_loads.apart) between the joint estimate and that of a part by itself; the gain of each may be
uncertain by a factor of 1.28."""


def identify_parts(window: Window, sign: int | None) -> ModelEstimate | None:
    """The process behind a record by its parts; None where these do not know it together either.

    sign : of the process gain, where it is known.
    """
    settings = FitSettings()
    parts = moved_most(parts_of(window, settings.most_samples))
    if len(parts) < FEWEST_PARTS:
        return None
    alone = [(part, identify_window(part, sign, settings=settings)) for part in parts]
    if any(found.is_contested(settings.apart_limit) for _, found in alone):
        return None  # loads at setpoint changes, or none: a prior from elsewhere does not say which
    signs = {found.log.sign for _, found in alone if found.identifiable}
    joint = identify_region(RegionRecord(-math.inf, math.inf, tuple(parts)), sign or min(signs, default=None), settings)
    if joint is None or len(signs) > 1:
        return None
    joint = bounded(window, joint, settings)
    model, dt = joint.log.model(), window.sample_time_s
    known = [found for part, one in alone if (found := bounded(part, one, settings)).identifiable]
    if any(apart(model, one.log.model(), dt) > MOST_APART for one in known):
        return None
    return joint if joint.identifiable else None


def moved_most(parts: list[Window]) -> list[Window]:
    """Those parts, MOST_FITTED at the most, in which pv moves most and co does as well, in their order."""
    moving = [i for i, part in enumerate(parts) if np.ptp(part.pv) > 0 and np.ptp(part.co) > 0]
    return [parts[i] for i in sorted(sorted(moving, key=lambda i: -float(np.ptp(parts[i].pv)))[:MOST_FITTED])]


def parts_of(window: Window, most_samples: int) -> list[Window]:
    """A record in parts that begin just before its setpoint moves, neither too short nor too long nor too many."""
    n = len(window.t_s)
    shortest = max(SHORTEST, -(-n // MOST_PARTS))
    boundaries = [0]
    for change_s in setpoint_changes(window):
        at = int(np.searchsorted(window.t_s - window.t_s[0], change_s)) - LEAD
        if at - boundaries[-1] >= shortest and n - at >= shortest:
            boundaries.append(at)
    boundaries.append(n)
    found = []
    for first, end in pairwise(boundaries):
        count = -(-(end - first) // most_samples)
        edges = np.linspace(first, end, count + 1).round().astype(int).tolist()
        found += [window.part(slice(a, b)) for a, b in pairwise(edges)]
    return found
