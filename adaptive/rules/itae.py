"""Smallest integral of time-weighted absolute error (ITAE) for a first order model with dead time.

    r = theta / tau
    itae-load      P    Kc = (0.490/k) r^-1.084
                   PI   Kc = (0.859/k) r^-0.977    Ti = (tau/0.674) r^0.680
                   PID  Kc = (1.357/k) r^-0.947    Ti = (tau/0.842) r^0.738    Td = 0.381 tau r^0.995
    itae-setpoint  PI   Kc = (0.586/k) r^-0.916    Ti = tau/(1.03 - 0.165 r)
                   PID  Kc = (0.965/k) r^-0.85     Ti = tau/(0.796 - 0.1465 r) Td = 0.308 tau r^0.929

Ideal form. Correlations over 0.1 <= theta/tau <= 1: load changes by Lopez, Miller, Smith & Murrill 1967 (Instrum.
Technol. 14, 57), setpoint changes by Rovira, Murrill & Smith 1969 (Instrum. Control Syst. 42, 67).
"""

from retuner.adaptive.process import ProcessModel
from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.rule import FIRST_ORDER, Rule, Wishes, first_order
from retuner.adaptive.rules.tuning import Tuning, tuning

P, PI, PID = ControllerKind.P, ControllerKind.PI, ControllerKind.PID
RATIO_RANGE = (0.1, 1.0)
"""theta/tau over which the correlations were fitted; beyond it the settings carry a note."""


def itae_load(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """ITAE settings for load changes (ideal form).

    Raises
    ------
    ValueError
        The dead time is 0.
    """
    k, tau, theta = first_order(model)
    r = theta / tau
    if kind == P:
        return _noted(tuning("itae-load", "ideal", 0.490 / k * r**-1.084, None, 0.0, None), r)
    if kind == PI:
        return _noted(tuning("itae-load", "ideal", 0.859 / k * r**-0.977, tau / 0.674 * r**0.680, 0.0, None), r)
    settings = 1.357 / k * r**-0.947, tau / 0.842 * r**0.738, 0.381 * tau * r**0.995
    return _noted(tuning("itae-load", "ideal", *settings, None), r)


def itae_setpoint(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """ITAE settings for setpoint changes (ideal form).

    Raises
    ------
    ValueError
        The dead time is 0, or so long that the correlation has no positive Ti.
    """
    k, tau, theta = first_order(model)
    r = theta / tau
    rate = 1.03 - 0.165 * r if kind == PI else 0.796 - 0.1465 * r
    if rate <= 0:
        raise ValueError(f"theta/tau = {r:.3g}: itae-setpoint was fitted up to 1 and has no answer beyond about 5")
    if kind == PI:
        return _noted(tuning("itae-setpoint", "ideal", 0.586 / k * r**-0.916, tau / rate, 0.0, None), r)
    return _noted(tuning("itae-setpoint", "ideal", 0.965 / k * r**-0.85, tau / rate, 0.308 * tau * r**0.929, None), r)


def _noted(found: Tuning, r: float) -> Tuning:
    """With a note when theta/tau is outside the range of the correlation."""
    low, high = RATIO_RANGE
    if low <= r <= high:
        return found
    note = f"theta/tau = {r:.3g} is outside {low} to {high}, where the correlation was fitted"
    return Tuning(found.rule, found.form, found.gains, found.tau_c_s, (note,))


RULES = (
    Rule(
        name="itae-load",
        form="ideal",
        formulas={
            P: ("Kc = (0.490/k) (theta/tau)^-1.084",),
            PI: ("Kc = (0.859/k) (theta/tau)^-0.977", "Ti = (tau/0.674) (theta/tau)^0.680"),
            PID: (
                "Kc = (1.357/k) (theta/tau)^-0.947",
                "Ti = (tau/0.842) (theta/tau)^0.738",
                "Td = 0.381 tau (theta/tau)^0.995",
            ),
        },
        source="Lopez, Miller, Smith & Murrill 1967, Instrum. Technol. 14, 57",
        valid="0.1 <= theta/tau <= 1",
        types=FIRST_ORDER,
        from_model=itae_load,
    ),
    Rule(
        name="itae-setpoint",
        form="ideal",
        formulas={
            PI: ("Kc = (0.586/k) (theta/tau)^-0.916", "Ti = tau/(1.03 - 0.165 theta/tau)"),
            PID: (
                "Kc = (0.965/k) (theta/tau)^-0.85",
                "Ti = tau/(0.796 - 0.1465 theta/tau)",
                "Td = 0.308 tau (theta/tau)^0.929",
            ),
        },
        source="Rovira, Murrill & Smith 1969, Instrum. Control Syst. 42, 67",
        valid="0.1 <= theta/tau <= 1",
        types=FIRST_ORDER,
        from_model=itae_setpoint,
    ),
)
