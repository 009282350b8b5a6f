"""Settings of the guard, with their ranges."""

import math
from dataclasses import dataclass, fields, replace

RANGES = {
    "ms_nominal": (1.2, 3.0), "ms_target": (1.2, 3.0), "ms_worst": (1.2, 5.0), "ms_border": (1.2, 5.0),
    "tau_c_max_ratio": (1.0, 3.0), "believed": (0.0, 20.0), "corner_std": (0.0, 6.0),
    "step_up_max": (1.0, 100.0), "step_down_max": (1.0, 100.0), "pattern_step_max": (1.0, 4.0),
    "kc_up_max": (1.0, 100.0), "kc_down_max": (1.0, 100.0),
    "tau_i_shorter_max": (1.0, 100.0), "tau_i_longer_max": (1.0, 100.0),
    "tau_d_up_max": (1.0, 100.0), "tau_d_down_max": (1.0, 100.0),
    "integral_up_max": (1.0, 100.0), "integral_down_max": (1.0, 100.0),
    "urgent_damping": (0.5, 10.0), "total_ratio_max": (1.0, 1000.0),
    "kc_min": (0.0, math.inf), "kc_max": (0.0, math.inf),
    "tau_i_min_s": (0.0, math.inf), "tau_i_max_s": (0.0, math.inf), "tau_d_max_s": (0.0, math.inf),
    "tau_i_samples": (0.0, 100.0), "tau_d_samples": (0.0, 100.0),
    "records_min": (1, 100), "age_max_s": (0.0, math.inf), "smallest_change": (1.0, 2.0),
}  # fmt: skip
"""Least and greatest value of every setting."""


@dataclass(frozen=True, slots=True)
class GuardSettings:
    """Settings.

    ms_nominal : largest Ms on the identified process; default 1.75.
    ms_target : Ms that proposals aim at by their tau_c; default 1.65 (what is between the two is for the process that
        is never quite the one identified).
    ms_worst : largest Ms on any model that the records allow; default 2.1.
    ms_border : largest Ms where the gains meet a neighbouring region's process or are mixed with its gains; 2.1.
    tau_c_max_ratio : largest tau_c over theta that robustness may ask for; default 1.3.
    believed : excess of the deviance up to which a model counts as allowed; default 4 (two standard deviations).
    corner_std : how many standard deviations out the corners lie where nothing but a covariance is known; default 2.
    step_up_max, step_down_max : largest factor per change towards more and towards less action, of kc, tau_I, tau_D and
        kc/tau_I; defaults 2 and 4. More action is a larger kc, tau_D or kc/tau_I and a shorter tau_I.
    kc_up_max ... integral_down_max : the same for one of them (integral: kc/tau_I); None for the general limit.
    urgent_damping : damping (E3 - E2)/(E1 - E2) of a response from which the loop counts as oscillating; default 0.9.
    pattern_step_max : largest factor either way of a change that no model proves; default 1.5.
    total_ratio_max : largest factor of kc, tau_I and tau_D against the commissioned set; default 4 (ABB ECA06).
    kc_min, kc_max : absolute limits on |kc|. tau_i_min_s, tau_i_max_s, tau_d_max_s : of the times, seconds.
    tau_i_samples, tau_d_samples : least tau_I and tau_D in sampling intervals; defaults 1 and 1. A tau_I that is
        shorter already may stay, a shorter derivative is left out.
    records_min : least records behind a model; default 1. age_max_s : greatest age of the last one; default 30 days.
    smallest_change : changes below this factor are not worth a write; default 1.05. Not for a loop over its limit.

    Raises
    ------
    ValueError
        A setting is outside its range, or two of them leave no room between them.
    """

    ms_nominal: float = 1.75
    ms_target: float = 1.65
    ms_worst: float = 2.1
    ms_border: float = 2.1
    tau_c_max_ratio: float = 1.3
    believed: float = 4.0
    corner_std: float = 2.0
    step_up_max: float = 2.0
    step_down_max: float = 4.0
    kc_up_max: float | None = None
    kc_down_max: float | None = None
    tau_i_shorter_max: float | None = None
    tau_i_longer_max: float | None = None
    tau_d_up_max: float | None = None
    tau_d_down_max: float | None = None
    integral_up_max: float | None = None
    integral_down_max: float | None = None
    urgent_damping: float = 0.9
    pattern_step_max: float = 1.5
    total_ratio_max: float = 4.0
    kc_min: float = 0.0
    kc_max: float = math.inf
    tau_i_min_s: float = 0.0
    tau_i_max_s: float = math.inf
    tau_d_max_s: float = math.inf
    tau_i_samples: float = 1.0
    tau_d_samples: float = 1.0
    records_min: int = 1
    age_max_s: float = 30 * 86400.0
    smallest_change: float = 1.05

    def __post_init__(self) -> None:
        for field in fields(self):
            value, (low, high) = getattr(self, field.name), RANGES[field.name]
            if value is not None and not low <= value <= high:
                raise ValueError(f"guard: {field.name} = {value} is outside {low:g} to {high:g}")
        for least, most in (("ms_nominal", "ms_worst"), ("kc_min", "kc_max"), ("tau_i_min_s", "tau_i_max_s")):
            if getattr(self, least) > getattr(self, most):
                raise ValueError(f"guard: {least} = {getattr(self, least):g} is above {most} = {getattr(self, most):g}")

    def opened(self, factor: float) -> "GuardSettings":
        """The same with every limit on the size of a change at one factor, the commissioned set's among them."""
        return replace(
            self,
            step_up_max=factor,
            step_down_max=factor,
            total_ratio_max=factor,
            kc_up_max=None,
            kc_down_max=None,
            tau_i_shorter_max=None,
            tau_i_longer_max=None,
            tau_d_up_max=None,
            tau_d_down_max=None,
            integral_up_max=None,
            integral_down_max=None,
        )
