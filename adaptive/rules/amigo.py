"""AMIGO: approximate M-constrained integral gain optimisation (Astrom & Hagglund 2004, J. Process Control 14, 635).

    PI   K = 0.15/k + (0.35 - L T/(L + T)^2) T/(k L)    Ti = 0.35 L + 13 L T^2/(T^2 + 12 L T + 7 L^2)
    PID  K = (0.2 + 0.45 T/L)/k    Ti = L (0.4 L + 0.8 T)/(L + 0.1 T)    Td = 0.5 L T/(0.3 L + T)
    integrating  PI  K = 0.35/(k' L)  Ti = 13.4 L      PID  K = 0.45/(k' L)  Ti = 8 L  Td = 0.5 L

Ideal form. Fitted over a test batch of about 130 processes to Ms = Mt = 1.4.
"""

from retuner.adaptive.process import ProcessModel, ProcessType
from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.rule import Rule, Wishes, dead_time
from retuner.adaptive.rules.tuning import Tuning, tuning

PI, PID = ControllerKind.PI, ControllerKind.PID


def amigo(model: ProcessModel, kind: ControllerKind = PI, _wishes: Wishes | None = None) -> Tuning:
    """AMIGO settings (ideal form) for a first order, integrating or pure delay model.

    Raises
    ------
    ValueError
        The dead time is 0.
    """
    k, lag, dead = model.k, model.tau1_s, dead_time(model)
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


RULES = (
    Rule(
        name="amigo",
        form="ideal",
        formulas={
            PI: (
                "K = 0.15/k + (0.35 - L T/(L + T)^2) T/(k L)",
                "Ti = 0.35 L + 13 L T^2/(T^2 + 12 L T + 7 L^2)",
                "integrating: K = 0.35/(k' L), Ti = 13.4 L",
            ),
            PID: (
                "K = (0.2 + 0.45 T/L)/k",
                "Ti = L (0.4 L + 0.8 T)/(L + 0.1 T)",
                "Td = 0.5 L T/(0.3 L + T)",
                "integrating: K = 0.45/(k' L), Ti = 8 L, Td = 0.5 L",
            ),
        },
        source="Astrom & Hagglund 2004, J. Process Control 14, 635",
        valid="any L/T > 0; conservative PID for L/T < 1",
        types=(ProcessType.FOPDT, ProcessType.INTEGRATING, ProcessType.DELAY),
        from_model=amigo,
    ),
)
