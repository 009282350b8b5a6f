"""[adaptation]: what the retuner may do, and the limits of the proof before a change."""

from collections.abc import Iterator
from typing import Literal

from retuner.config.setting import Problem, Section, setting


class AdaptationConfig(Section):
    """[adaptation]: mode, rule and limits of changes."""

    mode: Literal["off", "advise", "auto"] = setting(
        "off: only watch; advise: say what it would change; auto: write proved changes to the controller", unit="-",
        default="advise", source="nothing changes until somebody says so",
    )  # fmt: skip
    rule: Literal["simc"] = setting("Tuning rule", unit="-", default="simc", source="Skogestad 2003")
    ms_nominal: float = setting(
        "Largest Ms on the identified process", unit="1", low=1.2, high=2.0, default=1.75,
        source="between SIMC's 1.59 (first order) and 1.70 (integrating) and the limit 1.8",
    )  # fmt: skip
    ms_worst: float = setting(
        "Largest Ms on the worst model that the records allow", unit="1", low=1.2, high=3.0, default=2.1,
        source="a phase margin of at least 27 degrees and a gain margin of 1.9 remain",
    )  # fmt: skip
    tau_c_max_ratio: float = setting(
        "Largest tau_c over the dead time that the guard may choose before it shortens the step", unit="1", low=1,
        high=3, default=1.3,
        source="slower costs more than a smaller step",
    )  # fmt: skip
    kc_min: float | None = setting(
        "Least absolute proportional gain; absent: no limit",
        unit="%/pv",
        above=0,
        high=1e9,
        default=None,
        source="user",
    )
    kc_max: float | None = setting(
        "Greatest absolute proportional gain; absent: no limit",
        unit="%/pv",
        above=0,
        high=1e9,
        default=None,
        source="user",
    )
    step_up_max: float = setting(
        "Greatest factor of one change towards more action", unit="1", above=1, high=10, default=2.0,
        source="half of ABB ECA06's permitted factor of 4",
    )  # fmt: skip
    step_down_max: float = setting(
        "Greatest factor of one change towards less action", unit="1", above=1, high=10, default=4.0, source="ABB ECA06"
    )
    approval_s: float = setting(
        "How long a proposal may be approved after it was made", unit="s", above=0, high=1e8, default=86400.0,
        source="a day: every shift sees it",
    )  # fmt: skip
    noise_band: float | None = setting(
        "Noise band of pv; absent: estimated from the data", unit="pv", above=0, high=1e9, default=None, source="user"
    )
    wait_s: float | None = setting(
        "Longest wait for the next peak; absent: from the integral time in force", unit="s", above=0, high=1e7,
        default=None, source="user",
    )  # fmt: skip

    def problems(self) -> Iterator[Problem]:
        """Limits that leave room."""
        if self.ms_worst < self.ms_nominal:
            yield Problem(("ms_worst",), f"= {self.ms_worst:g} must be at least ms_nominal = {self.ms_nominal:g}")
        if self.kc_min is not None and self.kc_max is not None and self.kc_min >= self.kc_max:
            yield Problem(("kc_max",), f"= {self.kc_max:g} must be greater than kc_min = {self.kc_min:g}")
