"""Cohen and Coon's rule for the process reaction curve (Cohen & Coon 1953, Trans. ASME 75, 827).

    r = L / tau
    P    Kc = (tau / (K L)) (1 + r/3)
    PI   Kc = (tau / (K L)) (0.9 + r/12)    Ti = L (30 + 3 r) / (9 + 20 r)
    PID  Kc = (tau / (K L)) (4/3 + r/4)     Ti = L (32 + 6 r) / (13 + 8 r)    Td = 4 L / (11 + 2 r)

Ideal form. Made for a quarter decay after a load step, so its loops swing: Ms is seldom below 2.
"""

from retuner.adaptive.process import ProcessModel
from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.rule import FIRST_ORDER, Rule, Wishes, first_order
from retuner.adaptive.rules.tuning import Tuning, tuning

P, PI, PID = ControllerKind.P, ControllerKind.PI, ControllerKind.PID


def cohen_coon(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """Cohen-Coon settings (ideal form) for a first order model with dead time.

    Raises
    ------
    ValueError
        The dead time is 0.
    """
    k, tau, dead = first_order(model)
    r, unit = dead / tau, tau / (k * dead)
    if kind == P:
        return tuning("cohen-coon", "ideal", unit * (1 + r / 3), None, 0.0, None)
    if kind == PI:
        return tuning("cohen-coon", "ideal", unit * (0.9 + r / 12), dead * (30 + 3 * r) / (9 + 20 * r), 0.0, None)
    tau_i, tau_d = dead * (32 + 6 * r) / (13 + 8 * r), 4 * dead / (11 + 2 * r)
    return tuning("cohen-coon", "ideal", unit * (4 / 3 + r / 4), tau_i, tau_d, None)


RULES = (
    Rule(
        name="cohen-coon",
        form="ideal",
        formulas={
            P: ("Kc = (tau/(K L)) (1 + L/(3 tau))",),
            PI: ("Kc = (tau/(K L)) (0.9 + L/(12 tau))", "Ti = L (30 + 3 L/tau)/(9 + 20 L/tau)"),
            PID: (
                "Kc = (tau/(K L)) (4/3 + L/(4 tau))",
                "Ti = L (32 + 6 L/tau)/(13 + 8 L/tau)",
                "Td = 4 L/(11 + 2 L/tau)",
            ),
        },
        source="Cohen & Coon 1953, Trans. ASME 75, 827",
        valid="0.1 < L/tau < 1 or so; quarter decay, so little robust",
        types=FIRST_ORDER,
        from_model=cohen_coon,
    ),
)
