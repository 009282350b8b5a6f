"""Ziegler and Nichols' rules from the ultimate gain Ku and period Pu, and the two gentler variants of the PID rule.

    zn-ultimate              P    0.5 Ku
                             PI   0.45 Ku   Ti = Pu/1.2
                             PID  0.6 Ku    Ti = Pu/2     Td = Pu/8      (Ziegler & Nichols 1942)
    zn-some-overshoot        PID  0.33 Ku   Ti = 0.5 Pu   Td = 0.33 Pu
    zn-no-overshoot          PID  0.2 Ku    Ti = 0.5 Pu   Td = 0.33 Pu   (the usual values)
    zn-no-overshoot-printed  PID  0.2 Ku    Ti = 0.3 Pu   Td = 0.5 Pu    (as one set of lecture slides prints it)

Ideal form. Sources differ in the last rule, so each variant has a name of its own. The slides' worked example
(Ku 0.95, Pu 12) agrees with the usual values except for two exchanged numbers. Ti < 4 Td in both gentler rules: they
have no series form.
"""

from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.rule import (
    FIRST_ORDER_OR_INTEGRATING,
    ControllerKind,
    Oscillation,
    Rule,
    Takes,
    Tuning,
    Wishes,
    dead_time,
    tuning,
)

P, PI, PID = ControllerKind.P, ControllerKind.PI, ControllerKind.PID
SLIDES = "Putra, Tuning methods of PID controller (lecture slides)"


def zn_ultimate(swing: Oscillation, kind: ControllerKind = PI) -> Tuning:
    """The original ultimate-gain settings (ideal form); swing holds Ku and Pu."""
    ku, pu = swing.gain, swing.period_s
    if kind == P:
        return tuning("zn-ultimate", "ideal", 0.5 * ku, None, 0.0, None)
    if kind == PI:
        return tuning("zn-ultimate", "ideal", 0.45 * ku, pu / 1.2, 0.0, None)
    return tuning("zn-ultimate", "ideal", 0.6 * ku, pu / 2, pu / 8, None)


def zn_some_overshoot(swing: Oscillation, _kind: ControllerKind = PID) -> Tuning:
    """The variant with some overshoot (ideal form)."""
    return tuning("zn-some-overshoot", "ideal", 0.33 * swing.gain, 0.5 * swing.period_s, 0.33 * swing.period_s, None)


def zn_no_overshoot(swing: Oscillation, _kind: ControllerKind = PID) -> Tuning:
    """The variant without overshoot, usual values (ideal form)."""
    return tuning("zn-no-overshoot", "ideal", 0.2 * swing.gain, 0.5 * swing.period_s, 0.33 * swing.period_s, None)


def zn_no_overshoot_printed(swing: Oscillation, _kind: ControllerKind = PID) -> Tuning:
    """The variant without overshoot as the slides print it (ideal form)."""
    settings = 0.2 * swing.gain, 0.3 * swing.period_s, 0.5 * swing.period_s
    return tuning("zn-no-overshoot-printed", "ideal", *settings, None)


ULTIMATE_RULES = (
    Rule(
        name="zn-ultimate",
        form="ideal",
        formulas={
            P: ("Kc = 0.5 Ku",),
            PI: ("Kc = 0.45 Ku", "Ti = Pu/1.2"),
            PID: ("Kc = 0.6 Ku", "Ti = Pu/2", "Td = Pu/8"),
        },
        source="Ziegler & Nichols 1942, Trans. ASME 64, 759",
        valid="processes with an ultimate gain; quarter decay, so little robust",
        takes=Takes.ULTIMATE,
        from_oscillation=zn_ultimate,
    ),
    Rule(
        name="zn-some-overshoot",
        form="ideal",
        formulas={PID: ("Kc = 0.33 Ku", "Ti = 0.5 Pu", "Td = 0.33 Pu")},
        source=SLIDES,
        valid="processes with an ultimate gain",
        takes=Takes.ULTIMATE,
        from_oscillation=zn_some_overshoot,
    ),
    Rule(
        name="zn-no-overshoot",
        form="ideal",
        formulas={PID: ("Kc = 0.2 Ku", "Ti = 0.5 Pu", "Td = 0.33 Pu")},
        source="the usual values of text books; the slides' example has them with two numbers exchanged",
        valid="processes with an ultimate gain",
        takes=Takes.ULTIMATE,
        from_oscillation=zn_no_overshoot,
    ),
    Rule(
        name="zn-no-overshoot-printed",
        form="ideal",
        formulas={PID: ("Kc = 0.2 Ku", "Ti = 0.3 Pu", "Td = 0.5 Pu")},
        source=f"{SLIDES}, as printed",
        valid="processes with an ultimate gain",
        takes=Takes.ULTIMATE,
        from_oscillation=zn_no_overshoot_printed,
    ),
)


# Ziegler and Nichols' rule for the process reaction curve (Ziegler & Nichols 1942, Trans. ASME 64, 759).
#
#     M = slope of the reaction curve per unit of co = K / tau (k' of an integrating process), L = its dead time
#     P    Kc = 1 / (M L)
#     PI   Kc = 0.9 / (M L)    Ti = L / 0.3
#     PID  Kc = 1.2 / (M L)    Ti = 2 L    Td = 0.5 L
#
# Ideal form. Sources differ in Ti of the PI controller: L/0.3 here as in the original and most text books (3.33 L is
# the same rounded); a set of lecture slides prints 0.33 L, which is a slip and would be unstable.


def zn_reaction(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """Reaction-curve settings (ideal form) for a first order or integrating model with dead time.

    Raises ValueError: the dead time is 0.
    """
    dead = dead_time(model)
    unit = 1 / (model.slope * dead)
    if kind == P:
        return tuning("zn-reaction", "ideal", unit, None, 0.0, None)
    if kind == PI:
        return tuning("zn-reaction", "ideal", 0.9 * unit, dead / 0.3, 0.0, None)
    return tuning("zn-reaction", "ideal", 1.2 * unit, 2 * dead, 0.5 * dead, None)


REACTION = Rule(
    name="zn-reaction",
    form="ideal",
    formulas={
        P: ("Kc = tau/(K L) = 1/(M L)", "integrating: Kc = 1/(k' L)"),
        PI: ("Kc = 0.9 tau/(K L)", "Ti = L/0.3", "integrating: Kc = 0.9/(k' L), Ti = L/0.3"),
        PID: ("Kc = 1.2 tau/(K L)", "Ti = 2 L", "Td = 0.5 L", "integrating: Kc = 1.2/(k' L), Ti = 2 L, Td = 0.5 L"),
    },
    source="Ziegler & Nichols 1942, Trans. ASME 64, 759",
    valid="0.1 < L/tau < 1 or so; quarter decay, so little robust",
    types=FIRST_ORDER_OR_INTEGRATING,
    from_model=zn_reaction,
)


# Quarter decay: Ziegler and Nichols' modified method, for loops that must not be brought to the limit of stability.
#
#     Kq, Pq: gain and period at which each swing is a quarter of the one before, under proportional control
#     PID  Kc = Kq    Ti = Pq/1.5    Td = Pq/6
#
# Ideal form (PID appendix "PID controller, its tuning and design", table 1, modified method).


PID = ControllerKind.PID


def quarter_decay(swing: Oscillation, _kind: ControllerKind = PID) -> Tuning:
    """Quarter-decay settings (ideal form); swing holds Kq and Pq."""
    return tuning("quarter-decay", "ideal", swing.gain, swing.period_s / 1.5, swing.period_s / 6, None)


QUARTER_DECAY = Rule(
    name="quarter-decay",
    form="ideal",
    formulas={PID: ("Kc = Kq", "Ti = Pq/1.5", "Td = Pq/6")},
    source="Ziegler & Nichols' modified method, as table 1 of the appendix 'PID controller, its tuning and design'",
    valid="loops that can be made to swing with quarter decay",
    takes=Takes.QUARTER_DECAY,
    from_oscillation=quarter_decay,
)


RULES = (REACTION, *ULTIMATE_RULES, QUARTER_DECAY)
