"""AMIGO: approximate M-constrained integral gain optimisation (Astrom & Hagglund 2004, J. Process Control 14, 635).

    PI   K = 0.15/k + (0.35 - L T/(L + T)^2) T/(k L)    Ti = 0.35 L + 13 L T^2/(T^2 + 12 L T + 7 L^2)
    PID  K = (0.2 + 0.45 T/L)/k    Ti = L (0.4 L + 0.8 T)/(L + 0.1 T)    Td = 0.5 L T/(0.3 L + T)
    integrating  PI  K = 0.35/(k' L)  Ti = 13.4 L      PID  K = 0.45/(k' L)  Ti = 8 L  Td = 0.5 L

Ideal form. Fitted over a test batch of about 130 processes to Ms = Mt = 1.4.
"""

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules import rule as known
from retuner.adaptive.rules.rule import FIRST_ORDER, ControllerKind, Rule, Tuning, Wishes, first_order, tuning

P, PI, PID = ControllerKind.P, ControllerKind.PI, ControllerKind.PID


def amigo(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """AMIGO settings (ideal form) for a first order, integrating or pure delay model.

    Raises ValueError: the dead time is 0.
    """
    k, lag, dead = model.k, model.tau1_s, known.dead_time(model)
    if model.type == ProcessType.INTEGRATING:
        if kind == PI:
            return tuning("amigo", "ideal", 0.35 / (k * dead), 13.4 * dead, 0.0, None)
        return tuning("amigo", "ideal", 0.45 / (k * dead), 8 * dead, 0.5 * dead, None)
    if kind == PI:
        gain = 0.15 / k + (0.35 - dead * lag / (dead + lag) ** 2) * lag / (k * dead)
        reset = 0.35 * dead + 13 * dead * lag**2 / (lag**2 + 12 * dead * lag + 7 * dead**2)
        return tuning("amigo", "ideal", gain, reset, 0.0, None)
    reset = dead * (0.4 * dead + 0.8 * lag) / (dead + 0.1 * lag)
    return tuning("amigo", "ideal", (0.2 + 0.45 * lag / dead) / k, reset, 0.5 * dead * lag / (0.3 * dead + lag), None)


AMIGO = Rule(
    "amigo", "ideal",
    {PI: ("K = 0.15/k + (0.35 - L T/(L + T)^2) T/(k L)", "Ti = 0.35 L + 13 L T^2/(T^2 + 12 L T + 7 L^2)",
          "integrating: K = 0.35/(k' L), Ti = 13.4 L"),
     PID: ("K = (0.2 + 0.45 T/L)/k", "Ti = L (0.4 L + 0.8 T)/(L + 0.1 T)", "Td = 0.5 L T/(0.3 L + T)",
           "integrating: K = 0.45/(k' L), Ti = 8 L, Td = 0.5 L")},
    "Astrom & Hagglund 2004, J. Process Control 14, 635", "any L/T > 0; conservative PID for L/T < 1",
    types=(ProcessType.FOPDT, ProcessType.INTEGRATING, ProcessType.DELAY), from_model=amigo,
)  # fmt: skip


# Cohen and Coon's rule for the process reaction curve (Cohen & Coon 1953, Trans. ASME 75, 827).
#
#     with r = L / tau
#     P    Kc = (tau / (K L)) (1 + r/3)
#     PI   Kc = (tau / (K L)) (0.9 + r/12)    Ti = L (30 + 3 r) / (9 + 20 r)
#     PID  Kc = (tau / (K L)) (4/3 + r/4)     Ti = L (32 + 6 r) / (13 + 8 r)    Td = 4 L / (11 + 2 r)
#
# Ideal form. Made for a quarter decay after a load step, so its loops swing: Ms is seldom below 2.


def cohen_coon(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """Cohen-Coon settings (ideal form) for a first order model with dead time.

    Raises ValueError: the dead time is 0.
    """
    k, tau, dead = first_order(model)
    r, unit = dead / tau, tau / (k * dead)
    if kind == P:
        return tuning("cohen-coon", "ideal", unit * (1 + r / 3), None, 0.0, None)
    if kind == PI:
        return tuning("cohen-coon", "ideal", unit * (0.9 + r / 12), dead * (30 + 3 * r) / (9 + 20 * r), 0.0, None)
    tau_i, tau_d = dead * (32 + 6 * r) / (13 + 8 * r), 4 * dead / (11 + 2 * r)
    return tuning("cohen-coon", "ideal", unit * (4 / 3 + r / 4), tau_i, tau_d, None)


COHEN_COON = Rule(
    "cohen-coon", "ideal",
    {P: ("Kc = (tau/(K L)) (1 + L/(3 tau))",),
     PI: ("Kc = (tau/(K L)) (0.9 + L/(12 tau))", "Ti = L (30 + 3 L/tau)/(9 + 20 L/tau)"),
     PID: ("Kc = (tau/(K L)) (4/3 + L/(4 tau))", "Ti = L (32 + 6 L/tau)/(13 + 8 L/tau)", "Td = 4 L/(11 + 2 L/tau)")},
    "Cohen & Coon 1953, Trans. ASME 75, 827", "0.1 < L/tau < 1 or so; quarter decay, so little robust",
    types=FIRST_ORDER, from_model=cohen_coon,
)  # fmt: skip


# Smallest integral of time-weighted absolute error (ITAE) for a first order model with dead time.
#
#     with r = theta / tau
#     itae-load      P    Kc = (0.490/k) r^-1.084
#                    PI   Kc = (0.859/k) r^-0.977    Ti = (tau/0.674) r^0.680
#                    PID  Kc = (1.357/k) r^-0.947    Ti = (tau/0.842) r^0.738    Td = 0.381 tau r^0.995
#     itae-setpoint  PI   Kc = (0.586/k) r^-0.916    Ti = tau/(1.03 - 0.165 r)
#                    PID  Kc = (0.965/k) r^-0.85     Ti = tau/(0.796 - 0.1465 r) Td = 0.308 tau r^0.929
#
# Ideal form. Correlations over 0.1 <= theta/tau <= 1: load changes by Lopez, Miller, Smith & Murrill 1967 (Instrum.
# Technol. 14, 57), setpoint changes by Rovira, Murrill & Smith 1969 (Instrum. Control Syst. 42, 67).

RATIO_RANGE = (0.1, 1.0)  # theta/tau over which the correlations were fitted; beyond it the settings carry a note


def itae_load(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """ITAE settings for load changes (ideal form). Raises ValueError: the dead time is 0."""
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

    Raises ValueError: the dead time is 0, or so long that the correlation has no positive Ti.
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
    """The tuning with a note when theta/tau is outside the range of the correlation."""
    low, high = RATIO_RANGE
    if low <= r <= high:
        return found
    note = f"theta/tau = {r:.3g} is outside {low} to {high}, where the correlation was fitted"
    return Tuning(found.rule, found.form, found.gains, found.tau_c_s, (note,))


ITAE_RULES = (
    Rule("itae-load", "ideal",
         {P: ("Kc = (0.490/k) (theta/tau)^-1.084",),
          PI: ("Kc = (0.859/k) (theta/tau)^-0.977", "Ti = (tau/0.674) (theta/tau)^0.680"),
          PID: ("Kc = (1.357/k) (theta/tau)^-0.947", "Ti = (tau/0.842) (theta/tau)^0.738",
                "Td = 0.381 tau (theta/tau)^0.995")},
         "Lopez, Miller, Smith & Murrill 1967, Instrum. Technol. 14, 57", "0.1 <= theta/tau <= 1",
         types=FIRST_ORDER, from_model=itae_load),
    Rule("itae-setpoint", "ideal",
         {PI: ("Kc = (0.586/k) (theta/tau)^-0.916", "Ti = tau/(1.03 - 0.165 theta/tau)"),
          PID: ("Kc = (0.965/k) (theta/tau)^-0.85", "Ti = tau/(0.796 - 0.1465 theta/tau)",
                "Td = 0.308 tau (theta/tau)^0.929")},
         "Rovira, Murrill & Smith 1969, Instrum. Control Syst. 42, 67", "0.1 <= theta/tau <= 1",
         types=FIRST_ORDER, from_model=itae_setpoint),
)  # fmt: skip
RULES = (AMIGO, COHEN_COON, *ITAE_RULES)
