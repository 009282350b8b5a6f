"""Internal model control for a first order model with dead time (Rivera, Morari & Skogestad 1986, table 2).

    imc      PI   Kc = tau / (k lambda)                        Ti = tau             lambda > 1.7 theta
             PID  Kc = (2 tau + theta) / (k (2 lambda + theta))    Ti = tau + theta/2   Td = tau theta/(2 tau + theta)
                                                                                    lambda > 0.8 theta
    imc-pi   PI   Kc = (tau + theta/2) / (k lambda)            Ti = tau + theta/2   lambda > 1.7 theta ("improved PI")

Ideal form; lambda also more than tau/5. imc-pi is the rule that Grimholt & Skogestad (2012, figure 13) compare with: on
a pure delay Kc = 0.29, Ti = theta/2 at lambda = 1.7 theta. There the dead time is inside lambda: SIMC's tau_c + theta.
"""

from retuner.adaptive.process import ProcessModel, ProcessType
from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.rule import FIRST_ORDER, Rule, Wishes
from retuner.adaptive.rules.tuning import Tuning, tuning

PI, PID = ControllerKind.PI, ControllerKind.PID
LAMBDA_PER_THETA = {PI: 1.7, PID: 0.8}
"""Smallest lambda over theta that the source recommends; the default."""
LAMBDA_PER_TAU = 0.2
"""Smallest lambda over tau that the source recommends."""


def _lambda(model: ProcessModel, kind: ControllerKind, wishes: Wishes | None) -> float:
    """The given lambda, else the smallest one recommended."""
    least = max(LAMBDA_PER_THETA[kind] * model.theta_s, LAMBDA_PER_TAU * model.tau1_s)
    lam = least if wishes is None or wishes.tau_c_s is None else wishes.tau_c_s
    if not 0 < lam < float("inf"):
        raise ValueError(f"tau_c (lambda) = {lam} s must be positive and finite")
    return lam


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
RULES = (
    Rule(
        name="imc",
        form="ideal",
        formulas={
            PI: ("Kc = tau/(k lambda)", "Ti = tau"),
            PID: (
                "Kc = (2 tau + theta)/(k (2 lambda + theta))",
                "Ti = tau + theta/2",
                "Td = tau theta/(2 tau + theta)",
            ),
        },
        source=SOURCE,
        valid="lambda > 0.2 tau, and > 1.7 theta (PI) or > 0.8 theta (PID): the defaults",
        types=FIRST_ORDER,
        wishes=("tau_c_s",),
        from_model=imc,
    ),
    Rule(
        name="imc-pi",
        form="ideal",
        formulas={PI: ("Kc = (tau + theta/2)/(k lambda)", "Ti = tau + theta/2")},
        source=f"{SOURCE} ('improved PI')",
        valid="lambda > 0.2 tau and > 1.7 theta: the default",
        types=(ProcessType.FOPDT, ProcessType.DELAY),
        wishes=("tau_c_s",),
        from_model=imc_pi,
    ),
)
