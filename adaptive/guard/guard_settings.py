"""Settings of the guard, each with its meaning, range and source."""

import math
from typing import Any

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.schedule.late_dataclass import dataclass, replace

UP, DOWN = "absent: step_up_max", "absent: step_down_max"
BOTH_UP = "absent: none beside those of kc and tau_I, so 4 by default"


def _factor(what: str, absent: str) -> float | None:
    return setting(None, f"Greatest factor of one change of {what}; {absent}", "1..100", "user", absent=True)


def _gain(which: str, default: float) -> float:
    meaning = f"{which} absolute proportional gain; absent: no limit"
    return setting(default, meaning, "0.. %/pv", "user", absent=True)


def _bound(what: str, default: float = math.inf) -> float:
    return setting(default, f"{what}; absent: no limit", "0.. s", "user", absent=True)


GENERAL = ("step_up_max", "step_down_max")
OWN = (
    "kc_up_max", "kc_down_max", "tau_i_shorter_max", "tau_i_longer_max", "tau_d_up_max", "tau_d_down_max",
    "integral_up_max", "integral_down_max",
)  # fmt: skip
"""Limits on the size of one change: of all parameters, and a parameter's own, None for the general one."""


@dataclass(frozen=True, slots=True)
class GuardSettings:
    """Settings. More action is a larger kc, tau_D or kc/tau_I and a shorter tau_I.

    Raises ValueError: a setting is outside its range, or two of them leave no room between them.
    """

    ms_nominal: float = setting(
        1.75,
        "Largest Ms on the identified process",
        "1.2..3",
        "between SIMC's 1.59 (first order) and 1.70 (integrating) and the limit 1.8",
    )
    ms_worst: float = setting(
        2.1,
        "Largest worst-case Ms over the plausible models",
        "1.2..5",
        "a phase margin of at least 27 degrees and a gain margin of 1.9 remain",
    )
    tau_c_max_ratio: float = setting(
        1.3,
        "Largest tau_c over the dead time that the guard may choose before it shortens the step",
        "1..3",
        "slower costs more than a smaller step",
    )
    corner_std: float = setting(2.0, "How many std out the corners lie where nothing but a covariance is known", "0..6")
    kc_min: float = _gain("Least", 0.0)
    kc_max: float = _gain("Greatest", math.inf)
    step_up_max: float = setting(
        2.0, "Greatest factor of one change towards more action", "1..100", "half of ABB ECA06's permitted factor of 4"
    )
    step_down_max: float = setting(4.0, "Greatest factor of one change towards less action", "1..100", "ABB ECA06")
    total_ratio_max: float = setting(
        4.0, "Greatest factor of kc, tau_I and tau_D relative to the baseline gains", "1..1000", "ABB ECA06, page 152"
    )
    kc_up_max: float | None = _factor("kc upwards", UP)
    kc_down_max: float | None = _factor("kc downwards", DOWN)
    tau_i_shorter_max: float | None = _factor("tau_I, shorter", UP)
    tau_i_longer_max: float | None = _factor("tau_I, longer", DOWN)
    tau_d_up_max: float | None = _factor("tau_D upwards", UP)
    tau_d_down_max: float | None = _factor("tau_D downwards", DOWN)
    integral_up_max: float | None = _factor("kc/tau_I upwards", BOTH_UP)
    integral_down_max: float | None = _factor("kc/tau_I downwards", DOWN)
    tau_i_min_s: float = _bound("Shortest tau_I", 0.0)
    tau_i_max_s: float = _bound("Longest tau_I")
    tau_d_max_s: float = _bound("Longest tau_D")
    tau_i_samples: float = setting(
        0.3,
        "Shortest tau_I in sampling intervals",
        "0..100",
        "the shortest lag that a fit gives; an almost pure dead time asks for hardly more than an integral",
    )
    tau_d_samples: float = setting(
        1.0,
        "Shortest tau_D in sampling intervals; what is shorter is left out",
        "0..100",
        "a shorter one sees one sample's noise",
    )
    ms_border: float = setting(
        2.1,
        "Largest Ms where the gains meet a neighbouring region's process or are mixed with its gains",
        "1.2..5",
        "as ms_worst",
    )
    urgent_damping: float = setting(
        0.9,
        "Half-cycle decay ratio from which a loop counts as oscillating and may take "
        "the full change to less action at once",
        "0.5..10",
        "ten half cycles then leave a third",
    )
    pattern_step_max: float = setting(
        1.5, "Greatest factor of a change that no model proves", "1..4", "a loop with a gain margin of 2 stays stable"
    )
    believed: float = setting(
        4.0,
        "Excess of the deviance up to which a model counts as allowed by the records",
        "0..20",
        "two standard deviations of one parameter",
    )
    smallest_change: float = setting(
        1.05,
        "Changes below this factor are not written, unless the loop is over its Ms limit",
        "1..2",
        "no record knows a gain better",
    )
    records_min: int = setting(
        1,
        "Least number of records behind a model",
        "1..100 records",
        "every change is proved on what the records leave open",
    )
    age_max_s: float = setting(30 * 86400.0, "Greatest age of the last record", "0.. s", "a month")

    def __post_init__(self) -> None:
        require_in_range(self, "guard")
        for least, most in (("ms_nominal", "ms_worst"), ("kc_min", "kc_max"), ("tau_i_min_s", "tau_i_max_s")):
            if getattr(self, least) > getattr(self, most):
                raise ValueError(f"guard: {least} = {getattr(self, least):g} is above {most} = {getattr(self, most):g}")

    def whole_step(self) -> "GuardSettings":
        """These settings without a limit per change: a whole way at once. What may not move at all (factor 1) stays."""
        general: dict[str, Any] = {name: 1.0 if getattr(self, name) == 1.0 else 100.0 for name in GENERAL}
        own: dict[str, Any] = {name: None for name in OWN if getattr(self, name) != 1.0}
        return replace(self, **general, **own)

    def held_to(self, factor: float) -> "GuardSettings":
        """These settings with every limit on the size of one change at this factor at the most."""
        limits = {name: getattr(self, name) for name in (*GENERAL, *OWN)}
        return replace(self, **{name: min(limit, factor) for name, limit in limits.items() if limit is not None})

    def opened(self, factor: float) -> "GuardSettings":
        """These settings with every limit on the size of a change at one factor, the commissioned set's among them."""
        limits: dict[str, Any] = dict.fromkeys(OWN)
        limits |= dict.fromkeys((*GENERAL, "total_ratio_max", "integral_up_max"), factor)
        return replace(self, **limits)
