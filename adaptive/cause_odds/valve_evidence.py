"""What a record says for a valve that sticks or has play: its shapes and plateaus, beside the valves of the grid.

    ln factor = s + d max(v, min(v + free, 0)) + (1 - d) v        s: shapes, v: grid's valves

Plateaus and fits see valves that are unlike all of the grid's: where they name one (d = 1) the grid's say less against
it. In between is in between: with all or nothing nine tenths of a record turned 2 % into 33 %.
"""

import math

from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.tuning_verdict import RecordVerdict


def said_for_valve(valve: float, shapes: float, free: float, settings: OddsSettings) -> float:
    """Logarithm of how many times likelier all records are by a valve; see the head.

    valve : ln Bayes factor of the grid's, tempered. shapes : shapes_of, summed. free : `unlike`.
    """
    known, named = min(valve, 500.0), min(shapes / math.log(settings.stands), 1.0)
    return shapes + named * max(known, min(valve + free, 0.0)) + (1.0 - named) * known


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


def unlike(found: RecordVerdict) -> float:
    """Logarithm of a factor against the valves of the grid up to which it says nothing: valves slip irregularly."""
    if _fits(found):
        return math.inf
    return UNLIKE if found.diagnosis.cause == Cause.STICTION else UNLIKE_STANDING


UNLIKE, UNLIKE_STANDING = 3.0, 1.5
"""That where a fit or a shape names the valve, and where pv stands alone. Of 27 real valves whose pv stands 26 are
within -1.4; of twelve good loops whose pv stands under a real load eight are beyond -2.5."""
