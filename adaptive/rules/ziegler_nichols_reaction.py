"""Ziegler and Nichols' rule for the process reaction curve (Ziegler & Nichols 1942, Trans. ASME 64, 759).

    M = slope of the reaction curve per unit of co = K / tau (k' of an integrating process), L = its dead time
    P    Kc = 1 / (M L)
    PI   Kc = 0.9 / (M L)    Ti = L / 0.3
    PID  Kc = 1.2 / (M L)    Ti = 2 L    Td = 0.5 L

Ideal form. Sources differ in Ti of the PI controller: L/0.3 here as in the original and most text books (3.33 L is
the same rounded); a set of lecture slides prints 0.33 L, which is a slip and would be unstable.
"""

from retuner.adaptive.process import ProcessModel
from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.rule import FIRST_ORDER_OR_INTEGRATING, Rule, Wishes, dead_time
from retuner.adaptive.rules.tuning import Tuning, tuning

P, PI, PID = ControllerKind.P, ControllerKind.PI, ControllerKind.PID


def zn_reaction(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """Reaction-curve settings (ideal form) for a first order or integrating model with dead time.

    Raises
    ------
    ValueError
        The dead time is 0.
    """
    dead = dead_time(model)
    unit = 1 / (model.slope * dead)
    if kind == P:
        return tuning("zn-reaction", "ideal", unit, None, 0.0, None)
    if kind == PI:
        return tuning("zn-reaction", "ideal", 0.9 * unit, dead / 0.3, 0.0, None)
    return tuning("zn-reaction", "ideal", 1.2 * unit, 2 * dead, 0.5 * dead, None)


RULES = (
    Rule(
        name="zn-reaction",
        form="ideal",
        formulas={
            P: ("Kc = tau/(K L) = 1/(M L)", "integrating: Kc = 1/(k' L)"),
            PI: ("Kc = 0.9 tau/(K L)", "Ti = L/0.3", "integrating: Kc = 0.9/(k' L), Ti = L/0.3"),
            PID: (
                "Kc = 1.2 tau/(K L)",
                "Ti = 2 L",
                "Td = 0.5 L",
                "integrating: Kc = 1.2/(k' L), Ti = 2 L, Td = 0.5 L",
            ),
        },
        source="Ziegler & Nichols 1942, Trans. ASME 64, 759",
        valid="0.1 < L/tau < 1 or so; quarter decay, so little robust",
        types=FIRST_ORDER_OR_INTEGRATING,
        from_model=zn_reaction,
    ),
)
