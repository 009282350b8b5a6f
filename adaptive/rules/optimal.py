"""Optimal PI and PID settings for a demanded Ms (Grimholt & Skogestad 2012, section 3), found by search.

    minimise J = 0.5 (IAE_ys/IAE_ys* + IAE_d/IAE_d*)   subject to Ms = m, default 1.59

Ideal form; see optimum.py. The PID controller's derivative has no filter and acts on the error: what is best on paper,
and a bound for what a real one can do.
"""

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import ControllerKind, Rule, Tuning, Wishes

PI, PID = ControllerKind.PI, ControllerKind.PID
MS_DEFAULT = 1.59  # Demanded Ms unless another is given: that of SIMC with tau_c = theta on a first order process


def optimal(model: ProcessModel, kind: ControllerKind = PI, wishes: Wishes | None = None) -> Tuning:
    """Best settings at the demanded Ms (default 1.59).

    Raises ValueError: no controller of this kind has that Ms on this process.
    """
    from retuner.adaptive.loop.optimum import optimal_pi, optimal_pid

    ms = MS_DEFAULT if wishes is None or wishes.ms is None else wishes.ms
    found = (optimal_pi if kind == PI else optimal_pid)(model.linear(), ms)
    form = "ideal" if found.gains.kp else "parallel"
    return Tuning("optimal", form, found.gains, None, (f"J = {found.cost:.4g} at Ms = {ms:g}",))


TEXT = ("minimise J = 0.5 (IAE_ys/IAE_ys* + IAE_d/IAE_d*) subject to Ms = m (default 1.59)",)
RULES = (
    Rule("optimal", "ideal", {PI: TEXT, PID: TEXT},
         "Grimholt & Skogestad 2012, IFAC PID'12, section 3",
         "any process with a limit of stability; PI not for two integrators",
         types=tuple(ProcessType), wishes=("ms",), from_model=optimal),
)  # fmt: skip
