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

from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.rule import Oscillation, Rule, Takes
from retuner.adaptive.rules.tuning import Tuning, tuning

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


RULES = (
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
