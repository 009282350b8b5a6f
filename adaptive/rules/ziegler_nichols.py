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
from retuner.adaptive.rules import rule as known
from retuner.adaptive.rules.rule import ControllerKind, Oscillation, Rule, Takes, Tuning, Wishes, tuning

P, PI, PID = ControllerKind.P, ControllerKind.PI, ControllerKind.PID
SLIDES = "Putra, Tuning methods of PID controller (lecture slides)"
ZN = "Ziegler & Nichols 1942, Trans. ASME 64, 759"


def zn_ultimate(swing: Oscillation, kind: ControllerKind = PI) -> Tuning:
    """The original ultimate-gain settings (ideal form); swing holds Ku and Pu."""
    ku, pu = swing.gain, swing.period_s
    if kind == P:
        return tuning("zn-ultimate", "ideal", 0.5 * ku, None, 0.0, None)
    if kind == PI:
        return tuning("zn-ultimate", "ideal", 0.45 * ku, pu / 1.2, 0.0, None)
    return tuning("zn-ultimate", "ideal", 0.6 * ku, pu / 2, pu / 8, None)


def _gentler(name: str, gain: float, integral: float, derivative: float, source: str) -> Rule:
    """A variant of the PID rule: Kc as a share of Ku, Ti and Td of Pu."""

    def settings(swing: Oscillation, _kind: ControllerKind) -> Tuning:
        return tuning(name, "ideal", gain * swing.gain, integral * swing.period_s, derivative * swing.period_s, None)

    formula = (f"Kc = {gain:g} Ku", f"Ti = {integral:g} Pu", f"Td = {derivative:g} Pu")
    return Rule(name, "ideal", {PID: formula}, source, "processes with an ultimate gain",
                Takes.ULTIMATE, from_oscillation=settings)  # fmt: skip


USUAL = "the usual values of text books; the slides' example has them with two numbers exchanged"
ULTIMATE_RULES = (
    Rule("zn-ultimate", "ideal",
         {P: ("Kc = 0.5 Ku",), PI: ("Kc = 0.45 Ku", "Ti = Pu/1.2"), PID: ("Kc = 0.6 Ku", "Ti = Pu/2", "Td = Pu/8")},
         ZN, "processes with an ultimate gain; quarter decay, so little robust",
         Takes.ULTIMATE, from_oscillation=zn_ultimate),
    _gentler("zn-some-overshoot", 0.33, 0.5, 0.33, SLIDES),
    _gentler("zn-no-overshoot", 0.2, 0.5, 0.33, USUAL),
    _gentler("zn-no-overshoot-printed", 0.2, 0.3, 0.5, f"{SLIDES}, as printed"),
)  # fmt: skip


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
    dead = known.dead_time(model)
    unit = 1 / (model.slope * dead)
    if kind == P:
        return tuning("zn-reaction", "ideal", unit, None, 0.0, None)
    if kind == PI:
        return tuning("zn-reaction", "ideal", 0.9 * unit, dead / 0.3, 0.0, None)
    return tuning("zn-reaction", "ideal", 1.2 * unit, 2 * dead, 0.5 * dead, None)


REACTION = Rule(
    "zn-reaction", "ideal",
    {P: ("Kc = tau/(K L) = 1/(M L)", "integrating: Kc = 1/(k' L)"),
     PI: ("Kc = 0.9 tau/(K L)", "Ti = L/0.3", "integrating: Kc = 0.9/(k' L), Ti = L/0.3"),
     PID: ("Kc = 1.2 tau/(K L)", "Ti = 2 L", "Td = 0.5 L", "integrating: Kc = 1.2/(k' L), Ti = 2 L, Td = 0.5 L")},
    ZN, "0.1 < L/tau < 1 or so; quarter decay, so little robust",
    types=known.FIRST_ORDER_OR_INTEGRATING, from_model=zn_reaction,
)  # fmt: skip


# Quarter decay: Ziegler and Nichols' modified method, for loops that must not be brought to the limit of stability.
#
#     Kq, Pq: gain and period at which each swing is a quarter of the one before, under proportional control
#     PID  Kc = Kq    Ti = Pq/1.5    Td = Pq/6
#
# Ideal form (PID appendix "PID controller, its tuning and design", table 1, modified method).


def quarter_decay(swing: Oscillation, _kind: ControllerKind = PID) -> Tuning:
    """Quarter-decay settings (ideal form); swing holds Kq and Pq."""
    return tuning("quarter-decay", "ideal", swing.gain, swing.period_s / 1.5, swing.period_s / 6, None)


QUARTER_DECAY = Rule(
    "quarter-decay", "ideal", {PID: ("Kc = Kq", "Ti = Pq/1.5", "Td = Pq/6")},
    "Ziegler & Nichols' modified method, as table 1 of the appendix 'PID controller, its tuning and design'",
    "loops that can be made to swing with quarter decay", Takes.QUARTER_DECAY, from_oscillation=quarter_decay,
)  # fmt: skip
RULES = (REACTION, *ULTIMATE_RULES, QUARTER_DECAY)
