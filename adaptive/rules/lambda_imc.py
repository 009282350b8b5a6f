"""Lambda tuning: a first-order closed loop of time constant lambda, popular in pulp and paper.

    self-regulating  PI   Kc = tau / (K (lambda + L))              Ti = tau
                     PID  Kc = (2 tau + L) / (2 K (lambda + L))    Ti = tau + L/2    Td = tau L / (2 tau + L)
    integrating      PI   Kc = (2 lambda + L) / (k' (lambda + L)^2)    Ti = 2 lambda + L

Ideal form. The PID settings are those of the lecture slides (Putra), the PI settings the usual ones. lambda is two to
three times tau in the slides; here 3 tau by default, and three dead times on an integrating process (both ours).
"""

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules import rule as known
from retuner.adaptive.rules.rule import ControllerKind, Rule, Tuning, Wishes, tuning

PI, PID = ControllerKind.PI, ControllerKind.PID
LAMBDA_PER_TAU = 3.0  # Default lambda over tau for a self-regulating process, the calmer end of the slides' 2 to 3
LAMBDA_PER_DEAD_TIME = 3.0  # default lambda over dead time for an integrating process, which has no tau


def lambda_tuning(model: ProcessModel, kind: ControllerKind = PI, wishes: Wishes | None = None) -> Tuning:
    """Lambda settings (ideal form) for a first order or integrating model; tau_c of the wishes is lambda.

    Raises ValueError: an integrating process is asked for PID, or has no dead time and no lambda is given.
    """
    wanted = wishes.tau_c_s if wishes else None
    if model.type == ProcessType.INTEGRATING:
        if kind == PID:
            raise ValueError("rule lambda has no PID settings for an integrating process; give --kind pi")
        lam = wanted if wanted is not None else LAMBDA_PER_DEAD_TIME * known.dead_time(model)
        reset = 2 * _positive(lam) + model.theta_s
        return tuning("lambda", "ideal", reset / (model.k * (lam + model.theta_s) ** 2), reset, 0.0, lam)
    lam = _positive(wanted if wanted is not None else LAMBDA_PER_TAU * model.tau1_s)
    k, tau, dead = model.k, model.tau1_s, model.theta_s
    if kind == PI:
        return tuning("lambda", "ideal", tau / (k * (lam + dead)), tau, 0.0, lam)
    kc = (2 * tau + dead) / (2 * k * (lam + dead))
    return tuning("lambda", "ideal", kc, tau + dead / 2, tau * dead / (2 * tau + dead), lam)


def _positive(lam: float) -> float:
    if not 0 < lam < float("inf"):
        raise ValueError(f"tau_c (lambda) = {lam} s must be positive and finite")
    return lam


LAMBDA = Rule(
    "lambda", "ideal",
    {PI: ("Kc = tau/(K (lambda + L))", "Ti = tau",
          "integrating: Kc = (2 lambda + L)/(k' (lambda + L)^2), Ti = 2 lambda + L"),
     PID: ("Kc = (2 tau + L)/(2 K (lambda + L))", "Ti = tau + L/2", "Td = tau L/(2 tau + L)")},
    "Putra, Tuning methods of PID controller (lecture slides) for PID; the usual PI forms",
    "lambda 2 to 3 tau (default 3 tau); integrating: default 3 L",
    types=known.FIRST_ORDER_OR_INTEGRATING, wishes=("tau_c_s",), from_model=lambda_tuning,
)  # fmt: skip


# Internal model control for a first order model with dead time (Rivera, Morari & Skogestad 1986, table 2).
#
#     imc      PI   Kc = tau / (k lambda)                        Ti = tau             lambda > 1.7 theta
#              PID  Kc = (2 tau + theta) / (k (2 lambda + theta))    Ti = tau + theta/2   Td = tau theta/(2 tau + theta)
#                                                                                     lambda > 0.8 theta
#     imc-pi   PI   Kc = (tau + theta/2) / (k lambda)            Ti = tau + theta/2   lambda > 1.7 theta ("improved PI")
#
# Ideal form; lambda also more than tau/5. imc-pi is the rule that Grimholt & Skogestad (2012, figure 13) compare with:
# on a pure delay Kc = 0.29, Ti = theta/2 at lambda = 1.7 theta. There the dead time is inside lambda: SIMC's tau_c +
# theta.

LAMBDA_PER_THETA = {PI: 1.7, PID: 0.8}  # Smallest lambda over theta that the source recommends; the default
IMC_LAMBDA_PER_TAU = 0.2  # smallest lambda over tau that the source recommends


def _lambda(model: ProcessModel, kind: ControllerKind, wishes: Wishes | None) -> float:
    """The given lambda, else the smallest one recommended."""
    least = max(LAMBDA_PER_THETA[kind] * model.theta_s, IMC_LAMBDA_PER_TAU * model.tau1_s)
    return _positive(least if wishes is None or wishes.tau_c_s is None else wishes.tau_c_s)


def imc(model: ProcessModel, kind: ControllerKind = PI, wishes: Wishes | None = None) -> Tuning:
    """IMC settings (ideal form) for a first order model; tau_c of the wishes is lambda."""
    lam, k, tau, theta = _lambda(model, kind, wishes), model.k, model.tau1_s, model.theta_s
    if kind == PI:
        return tuning("imc", "ideal", tau / (k * lam), tau, 0.0, lam)
    kc = (2 * tau + theta) / (k * (2 * lam + theta))
    return tuning("imc", "ideal", kc, tau + theta / 2, tau * theta / (2 * tau + theta), lam)


def imc_pi(model: ProcessModel, _kind: ControllerKind = PI, wishes: Wishes | None = None) -> Tuning:
    """The improved IMC PI settings (ideal form) for a first order or pure delay model."""
    lam, reset = _lambda(model, PI, wishes), model.tau1_s + model.theta_s / 2
    return tuning("imc-pi", "ideal", reset / (model.k * lam), reset, 0.0, lam)


SOURCE = "Rivera, Morari & Skogestad 1986, Ind. Eng. Chem. Process Des. Dev. 25, 252, table 2"
IMC_RULES = (
    Rule("imc", "ideal",
         {PI: ("Kc = tau/(k lambda)", "Ti = tau"),
          PID: ("Kc = (2 tau + theta)/(k (2 lambda + theta))", "Ti = tau + theta/2", "Td = tau theta/(2 tau + theta)")},
         SOURCE, "lambda > 0.2 tau, and > 1.7 theta (PI) or > 0.8 theta (PID): the defaults",
         types=known.FIRST_ORDER, wishes=("tau_c_s",), from_model=imc),
    Rule("imc-pi", "ideal", {PI: ("Kc = (tau + theta/2)/(k lambda)", "Ti = tau + theta/2")},
         f"{SOURCE} ('improved PI')", "lambda > 0.2 tau and > 1.7 theta: the default",
         types=(ProcessType.FOPDT, ProcessType.DELAY), wishes=("tau_c_s",), from_model=imc_pi),
)  # fmt: skip
RULES = (LAMBDA, *IMC_RULES)
