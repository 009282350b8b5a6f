"""What the decision on a change weighs with (expected_cost.py), each number with where it comes from."""

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.schedule.late_dataclass import dataclass, replace


@dataclass(frozen=True, slots=True)
class ChoiceSettings:
    """Costs are natural logarithms of IAE: 0.1 is a tenth of it. Odds are of something else against the models."""

    ms_limit: float = setting(
        1.8, "Ms above which settings are out of specification", "1.2..3.2", "Grimholt & Skogestad 2012"
    )
    j_limit: float = setting(
        1.25, "IAE over that of SIMC above which they are as well", "1..2", "the benchmarks' judge"
    )
    out: float = setting(
        0.22, "Cost of being out of specification", "0..2", "ln 1.25: as much as the limit of IAE allows"
    )
    ms_width: float = setting(
        0.04, "How far ln Ms of a model is from the truth", "0.01..0.3", "0.04 on 204 changes of batch, seed 51"
    )
    ms_width_loads: float = setting(
        0.08,
        "The same where no setpoint step is among the records: a load does not tell its own time from a dead time",
        "0.01..0.3",
        "0.08 on 41 decisions of harm, seed 9531, and 36 of loads alone, seed 602; else 0.012",
    )
    j_width: float = setting(0.06, "The same of ln J", "0.01..0.5", "the same changes")
    ms_slope: float = setting(
        2.5, "Cost of an Ms over its limit, per unit of ln Ms", "0..10", "Ms 3.6 as an IAE seven times as large"
    )
    most: float = setting(2.3, "Cost of an unstable loop, and the most that an Ms costs", "0.5..10", "IAE x10")
    temper: float = setting(
        2.0, "Factor by which the excess of a model's deviance counts less", "1..10", "remainders are not white"
    )
    price: float = setting(
        0.1, "Expected gain below which a change is not worth it", "0..1", "a tenth of the IAE, seed 51"
    )
    price_settled: float = setting(
        0.4, "Share of it that is left after many records that agree", "0..1", "at 0.2 a drift takes half more changes"
    )
    sure: float = setting(
        1.0,
        "Standard deviations over the models by which it must be more: what one more record costs is little",
        "0..3",
        "a wait costs a tenth of a gain that ten responses would have; normal loss 0.08 at 1",
    )
    doubt: float = setting(0.25, "Odds of something else after one record", "0..10", "one in five, batch seed 51")
    doubt_agrees: float = setting(
        0.25, "Factor on the odds by each further record that agrees", "0..1", "as one record by itself"
    )
    doubt_alike: float = setting(
        0.7, "The same where no setpoint step was clear", "0..1", "what passes for a load comes back alike"
    )
    doubt_clear: float = setting(
        0.5, "The same by setpoint steps from rest that the loop explains", "0..1", "a known input"
    )
    doubt_load: float = setting(
        1.5, "The same by each load of unknown shape in the last record", "1..10", "a load fits much"
    )
    doubt_limited: float = setting(
        4.0, "The same by an output that stood at a limit", "1..20", "harm by saturation, seed 72"
    )
    doubt_left: float = setting(2.0, "The same by more than noise that the model leaves", "1..10", "swing.unexplained")
    most_agree: int = setting(
        3, "Further records that count", "1..20 records", "odds of 1 in 250 are no longer counted"
    )
    risk: float = setting(
        1.0, "Risk of more action on an unknown process, per unit of ln", "0..10", "kc x2 costs kc x2"
    )
    risk_swing: float = setting(
        2.0, "The same more by the decay ratio that was seen", "0..10", "tripled where it swings on"
    )
    most_risk: float = setting(1.0, "Most that more action costs", "0.1..10", "the trial ends within a response")
    calm_decay: float = setting(
        0.25, "Decay ratio from which a loop is helped by less action", "0.1..0.5", "quarter decay"
    )
    relief: float = setting(
        4.0, "What that brings per unit of ln and of decay above it", "0..20", "even at a decay of a half"
    )

    def __post_init__(self) -> None:
        require_in_range(self, "choice")

    def by_loads(self) -> "ChoiceSettings":
        """These settings for models that rest on loads alone."""
        return replace(self, ms_width=max(self.ms_width, self.ms_width_loads))
