"""Lambda tuning: a first-order closed loop of time constant lambda, popular in pulp and paper.

    self-regulating  PI   Kc = tau / (K (lambda + L))              Ti = tau
                     PID  Kc = (2 tau + L) / (2 K (lambda + L))    Ti = tau + L/2    Td = tau L / (2 tau + L)
    integrating      PI   Kc = (2 lambda + L) / (k' (lambda + L)^2)    Ti = 2 lambda + L

Ideal form. The PID settings are those of the lecture slides (Putra), the PI settings the usual ones. lambda is two to
three times tau in the slides; here 3 tau by default, and three dead times on an integrating process (both ours).
"""

from retuner.adaptive.process import ProcessModel, ProcessType
from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.rule import FIRST_ORDER_OR_INTEGRATING, Rule, Wishes, dead_time
from retuner.adaptive.rules.tuning import Tuning, tuning

PI, PID = ControllerKind.PI, ControllerKind.PID
LAMBDA_PER_TAU = 3.0
"""Default lambda over tau for a self-regulating process, the calmer end of the slides' 2 to 3."""
LAMBDA_PER_DEAD_TIME = 3.0
"""Default lambda over dead time for an integrating process, which has no tau."""


def lambda_tuning(model: ProcessModel, kind: ControllerKind = PI, wishes: Wishes | None = None) -> Tuning:
    """Lambda settings (ideal form) for a first order or integrating model; tau_c of the wishes is lambda.

    Raises
    ------
    ValueError
        An integrating process is asked for PID, or has no dead time and no lambda is given.
    """
    wanted = wishes.tau_c_s if wishes else None
    if model.type == ProcessType.INTEGRATING:
        if kind == PID:
            raise ValueError("rule lambda has no PID settings for an integrating process; give --kind pi")
        return _integrating(model, wanted if wanted is not None else LAMBDA_PER_DEAD_TIME * dead_time(model))
    lam = _positive(wanted if wanted is not None else LAMBDA_PER_TAU * model.tau1_s)
    k, tau, dead = model.k, model.tau1_s, model.theta_s
    if kind == PI:
        return tuning("lambda", "ideal", tau / (k * (lam + dead)), tau, 0.0, lam)
    kc = (2 * tau + dead) / (2 * k * (lam + dead))
    return tuning("lambda", "ideal", kc, tau + dead / 2, tau * dead / (2 * tau + dead), lam)


def _integrating(model: ProcessModel, lam: float) -> Tuning:
    """PI for an integrating process."""
    reset = 2 * _positive(lam) + model.theta_s
    return tuning("lambda", "ideal", reset / (model.k * (lam + model.theta_s) ** 2), reset, 0.0, lam)


def _positive(lam: float) -> float:
    """The given lambda, refused unless it is a positive finite time."""
    if not 0 < lam < float("inf"):
        raise ValueError(f"tau_c (lambda) = {lam} s must be positive and finite")
    return lam


RULES = (
    Rule(
        name="lambda",
        form="ideal",
        formulas={
            PI: (
                "Kc = tau/(K (lambda + L))",
                "Ti = tau",
                "integrating: Kc = (2 lambda + L)/(k' (lambda + L)^2), Ti = 2 lambda + L",
            ),
            PID: ("Kc = (2 tau + L)/(2 K (lambda + L))", "Ti = tau + L/2", "Td = tau L/(2 tau + L)"),
        },
        source="Putra, Tuning methods of PID controller (lecture slides) for PID; the usual PI forms",
        valid="lambda 2 to 3 tau (default 3 tau); integrating: default 3 L",
        types=FIRST_ORDER_OR_INTEGRATING,
        wishes=("tau_c_s",),
        from_model=lambda_tuning,
    ),
)
