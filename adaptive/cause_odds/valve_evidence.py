"""What shapes and plateaus say for a valve that sticks or has play, beside the valves of the grid (valve_odds.py)."""

import math

from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.tuning_verdict import RecordVerdict


def shapes_of(found: RecordVerdict, settings: OddsSettings) -> float:
    """What shapes and plateaus say for a valve, as a logarithm of how many times likelier it makes the record."""
    told = found.diagnosis
    times = settings.shapes_say if told.cause == Cause.STICTION else 1.0
    degree = told.evidence.get("stand_degree", 0.0)
    # by the square: of twelve good loops whose pv stood under a real load eight did so in part
    slips = settings.stands_slips / settings.stands
    stands = settings.stands ** min(degree, 1.0) ** 2 * slips ** max(degree - 1.0, 0.0)
    return math.log(max(times, stands, settings.valve_fits if _fits(found) else 1.0))


def _fits(found: RecordVerdict) -> bool:
    """Whether a fitted valve explains a record where loop and tone with their loads leave far more."""
    told = found.diagnosis
    if told.cause != Cause.STICTION or "stuck_left" not in told.evidence:
        return False
    left = min(told.evidence["stuck_left"], told.evidence.get("slips_left", math.inf))
    return min(told.evidence["linear_left"], told.evidence["external_left"]) >= FITS_BETTER * left


FITS_BETTER = 1.3  # times as much as it leaves: of 21 such records 20 were of valves, none of 33 other loops
