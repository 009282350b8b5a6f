"""NAME, by AUTHOR (YEAR): what it aims at, in one sentence.

    self-regulating  PI   Kc = tau / (2 K (tau + L))    Ti = tau

Say here in which form the source gives its settings, which equation this is, and why this variant. This template is the
setting of a loop that is half as fast as lambda tuning with lambda = tau; its numbers are not from a publication.
"""

from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.rule import FIRST_ORDER, ControllerKind, Rule, Tuning, Wishes, first_order, tuning

PI = ControllerKind.PI


def template(model: ProcessModel, kind: ControllerKind = PI, wishes: Wishes | None = None) -> Tuning:
    """Settings (ideal form) for a first order model with dead time.

    Parameters
    ----------
    model : the process, lags and dead time in seconds, gain in pv units per % of co.
    kind : PI, the only one that the source has. wishes : none are taken; Rule.wishes names what is.

    Raises
    ------
    ValueError
        The process has no dead time (first_order says so).
    """
    del kind, wishes
    k, tau, dead = first_order(model)
    return tuning("template", "ideal", tau / (2 * k * (tau + dead)), tau, 0.0, tau)


RULES = (
    Rule(
        name="template",
        form="ideal",
        formulas={PI: ("Kc = tau/(2 K (tau + L))", "Ti = tau")},
        source="AUTHOR, TITLE, JOURNAL VOLUME (YEAR), equation NUMBER",
        valid="the range of L/tau that the source names",
        types=FIRST_ORDER,
        from_model=template,
    ),
)
