"""Settings of trial and rollback, each with its range."""

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.schedule.late_dataclass import dataclass


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """Settings. Raises ValueError: one is outside its range."""

    responses: int = setting(
        1,
        "Responses that must match a change's prediction before it has passed its trial",
        "1..10 responses",
        "more are surer and slower",
    )
    level: float = setting(
        3.0,
        "Standard deviations of noise beyond the prediction from which a response is worse",
        "2..6",
        "one false alarm in 700 by noise alone",
    )
    decay_slack: float = setting(0.15, "Margin in half-cycle decay ratio: a model is never exact", "0..0.5")
    iae_slack: float = setting(1.5, "Margin in IAE, a factor", "1..4")
    harmless_decay: float = setting(0.25, "Half-cycle decay ratio that is never called worse", "0.1..0.5")
    harmless_ms: float = setting(
        2.1, "Ms on the models left allowed that is never called worse, as the guard's", "1.2..5"
    )
    seen_bands: float = setting(4.0, "Noise bands that the largest peak must have to be judged", "2..20")
    seen_wanders: float = setting(
        6.0, "Deviations of the error at rest before the change that it must have; half begin a half cycle", "2..10"
    )
    rest_share: float = setting(0.05, "Share of a setpoint step that may be left of the upset before it", "0..0.1")
    cool_down_s: float | None = setting(
        None,
        "No change of a region for this long after one was rolled back, doubled each time; absent: 20 integral times",
        "0..1e8 s",
        "as long as several responses",
    )
    cool_down_tau_i: float = setting(20.0, "Integral times of the restored set without a change", "1..1000")
    cool_down_most: int = setting(6, "Doublings of it by rollbacks at the most", "0..20")
    lock_out_after: int = setting(
        3,
        "Changes rolled back in a row after which a region is locked until an operator unlocks it",
        "1..20 changes",
        "what fails three times is not a matter of gains",
    )
    inconclusive: int = setting(
        5,
        "Responses that may say nothing for or against a change before its trial is over: what nothing speaks against "
        "stays",
        "1..100 responses",
        "further ones of that kind say nothing either",
    )
    settles: float = setting(
        50.0,
        "In mode trial: predicted settling times after which an undecided change waits for operator approval",
        "1..1e4 settling times",
        "in the loop's own time; time alone is no verdict on a change",
    )
    edit_hold_s: float = setting(
        28800.0,
        "Gains that an operator has set stay for this long, while changes are only proposed; doubled each time that an "
        "operator replaces gains of retuner",
        "0..1e8 s",
        "a shift",
    )
    grows: float = setting(1.05, "Half-cycle decay ratio from which two in a row diverge", "1..2")
    stays: float = setting(0.95, "Half-cycle decay ratio from which `stays_for` in a row do", "0.8..1")
    stays_for: int = setting(5, "Peaks in a row that hardly fall and diverge", "3..20")
    limited_settles: float = setting(2.0, "Predicted settling times for which the output may stand at a limit", "1..20")
    limit_swings: int = setting(2, "Ways of the output from limit to limit in one upset that diverge", "2..10")

    def __post_init__(self) -> None:
        require_in_range(self, "trial")
