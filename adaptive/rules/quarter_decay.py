"""Quarter decay: Ziegler and Nichols' modified method, for loops that must not be brought to the limit of stability.

    Kq, Pq: gain and period at which each swing is a quarter of the one before, under proportional control
    PID  Kc = Kq    Ti = Pq/1.5    Td = Pq/6

Ideal form (PID appendix "PID controller, its tuning and design", table 1, modified method).
"""

from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.rule import Oscillation, Rule, Takes
from retuner.adaptive.rules.tuning import Tuning, tuning

PID = ControllerKind.PID


def quarter_decay(swing: Oscillation, _kind: ControllerKind = PID) -> Tuning:
    """Quarter-decay settings (ideal form); swing holds Kq and Pq."""
    return tuning("quarter-decay", "ideal", swing.gain, swing.period_s / 1.5, swing.period_s / 6, None)


RULES = (
    Rule(
        name="quarter-decay",
        form="ideal",
        formulas={PID: ("Kc = Kq", "Ti = Pq/1.5", "Td = Pq/6")},
        source="Ziegler & Nichols' modified method, as table 1 of the appendix 'PID controller, its tuning and design'",
        valid="loops that can be made to swing with quarter decay",
        takes=Takes.QUARTER_DECAY,
        from_oscillation=quarter_decay,
    ),
)
