"""[adaptation.limits]: how far the guard lets gains go, beside the general limits of [adaptation]."""

from collections.abc import Iterator

from retuner.config.setting import Problem, Section, setting

FACTOR = "absent: step_up_max"
LESS = "absent: step_down_max"


def _factor(meaning: str, absent: str) -> float | None:
    """A limit per change of one parameter."""
    found: float | None = setting(
        f"Greatest factor of one change of {meaning}; {absent}", unit="1", low=1, high=100, default=None, source="user"
    )
    return found


def _bound(meaning: str, unit: str) -> float | None:
    """An absolute limit."""
    found: float | None = setting(
        f"{meaning}; absent: no limit", unit=unit, above=0, high=1e9, default=None, source="user"
    )
    return found


class LimitsConfig(Section):
    """[adaptation.limits]: limits of a change that are seldom needed."""

    total_ratio_max: float = setting(
        "Greatest factor of kc, tau_I and tau_D against the commissioned set",
        unit="1",
        low=1,
        high=1000,
        default=4.0,
        source="ABB ECA06, page 152",
    )
    kc_up_max: float | None = _factor("kc upwards", FACTOR)
    kc_down_max: float | None = _factor("kc downwards", LESS)
    tau_i_shorter_max: float | None = _factor("tau_I, shorter", FACTOR)
    tau_i_longer_max: float | None = _factor("tau_I, longer", LESS)
    tau_d_up_max: float | None = _factor("tau_D upwards", FACTOR)
    tau_d_down_max: float | None = _factor("tau_D downwards", LESS)
    integral_up_max: float | None = _factor("kc/tau_I upwards", FACTOR)
    integral_down_max: float | None = _factor("kc/tau_I downwards", LESS)
    tau_i_min_s: float | None = _bound("Shortest tau_I", "s")
    tau_i_max_s: float | None = _bound("Longest tau_I", "s")
    tau_d_max_s: float | None = _bound("Longest tau_D", "s")
    tau_i_samples: float = setting(
        "Shortest tau_I in sampling intervals",
        unit="1",
        low=0,
        high=100,
        default=1.0,
        source="below that the integral moves more in one sample than the gain does",
    )
    tau_d_samples: float = setting(
        "Shortest tau_D in sampling intervals; what is shorter is left out",
        unit="1",
        low=0,
        high=100,
        default=1.0,
        source="a shorter one sees one sample's noise",
    )
    ms_border: float = setting(
        "Largest Ms where the gains meet a neighbouring region's process or are mixed with its gains",
        unit="1",
        low=1.2,
        high=5,
        default=2.1,
        source="as ms_worst",
    )
    urgent_damping: float = setting(
        "Damping of a response, the ratio of successive half swings, from which the loop counts as oscillating and may "
        "take the whole step to less action at once",
        unit="1",
        low=0.5,
        high=10,
        default=0.9,
        source="ten half swings then leave a third",
    )
    pattern_step_max: float = setting(
        "Greatest factor of a change that no model proves",
        unit="1",
        low=1,
        high=4,
        default=1.5,
        source="a loop with a gain margin of 2 stays stable",
    )
    believed: float = setting(
        "Excess of the deviance up to which a model counts as allowed by the records",
        unit="1",
        low=0,
        high=20,
        default=4.0,
        source="two standard deviations of one parameter",
    )
    smallest_change: float = setting(
        "Changes below this factor are not written, unless the loop is over its Ms limit",
        unit="1",
        low=1,
        high=2,
        default=1.05,
        source="no record knows a gain better",
    )
    records_min: int = setting(
        "Least number of records behind a model",
        unit="records",
        low=1,
        high=100,
        default=1,
        source="every change is proved on what the records leave open",
    )
    age_max_s: float = setting(
        "Greatest age of the last record", unit="s", above=0, high=1e9, default=30 * 86400.0, source="a month"
    )

    def problems(self) -> Iterator[Problem]:
        """Limits that leave room."""
        if self.tau_i_min_s is not None and self.tau_i_max_s is not None and self.tau_i_min_s >= self.tau_i_max_s:
            yield Problem(
                ("tau_i_max_s",), f"= {self.tau_i_max_s:g} must be greater than tau_i_min_s = {self.tau_i_min_s:g}"
            )
