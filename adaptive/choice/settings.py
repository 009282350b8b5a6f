"""What the decision on a change weighs with (expected_cost.py), each number with where it comes from."""

from dataclasses import dataclass, replace
from typing import Annotated

from retuner.adaptive.declared_setting import Setting, require_in_range


@dataclass(frozen=True, slots=True)
class ChoiceSettings:
    """Costs are natural logarithms of IAE: 0.1 is a tenth of it. Odds are of something else against the models."""

    ms_limit: Annotated[
        float, Setting("Ms above which settings are out of specification", 1.2, 3.2, source="Grimholt & Skogestad 2012")
    ] = 1.8
    j_limit: Annotated[
        float, Setting("IAE over that of SIMC above which they are as well", 1.0, 2.0, source="the benchmarks' judge")
    ] = 1.25
    out: Annotated[
        float,
        Setting("Cost of being out of specification", 0.0, 2.0, source="ln 1.25: as much as the limit of IAE allows"),
    ] = 0.22
    ms_width: Annotated[
        float,
        Setting(
            "How far ln Ms of a model is from the truth", 0.01, 0.3, source="0.04 on 204 changes of batch, seed 51"
        ),
    ] = 0.04
    ms_width_loads: Annotated[
        float,
        Setting(
            "The same where no setpoint step is among the records: a load does not tell its own time from a dead time",
            0.01,
            0.3,
            source="0.08 on 41 decisions of harm, seed 9531, and 36 of loads alone, seed 602; else 0.012",
        ),
    ] = 0.08
    j_width: Annotated[float, Setting("The same of ln J", 0.01, 0.5, source="the same changes")] = 0.06
    ms_slope: Annotated[
        float,
        Setting(
            "Cost of an Ms over its limit, per unit of ln Ms", 0.0, 10.0, source="Ms 3.6 as an IAE seven times as large"
        ),
    ] = 2.5
    most: Annotated[
        float, Setting("Cost of an unstable loop, and the most that an Ms costs", 0.5, 10.0, source="IAE x10")
    ] = 2.3
    temper: Annotated[
        float,
        Setting(
            "Factor by which the excess of a model's deviance counts less", 1.0, 10.0, source="remainders are not white"
        ),
    ] = 2.0
    price: Annotated[
        float,
        Setting("Expected gain below which a change is not worth it", 0.0, 1.0, source="a tenth of the IAE, seed 51"),
    ] = 0.1
    sure: Annotated[
        float,
        Setting(
            "Standard deviations over the models by which it must be more: what one more record costs is little",
            0.0,
            3.0,
            source="a wait costs a tenth of a gain that ten responses would have; normal loss 0.08 at 1",
        ),
    ] = 1.0
    doubt: Annotated[
        float, Setting("Odds of something else after one record", 0.0, 10.0, source="one in five, batch seed 51")
    ] = 0.25
    doubt_agrees: Annotated[
        float,
        Setting("Factor on the odds by each further record that agrees", 0.0, 1.0, source="as one record by itself"),
    ] = 0.25
    doubt_alike: Annotated[
        float,
        Setting(
            "The same where no setpoint step was clear", 0.0, 1.0, source="what passes for a load comes back alike"
        ),
    ] = 0.7
    doubt_clear: Annotated[
        float,
        Setting("The same by setpoint steps from rest that the loop explains", 0.0, 1.0, source="a known input"),
    ] = 0.5
    doubt_load: Annotated[
        float,
        Setting("The same by each load of unknown shape in the last record", 1.0, 10.0, source="a load fits much"),
    ] = 1.5
    doubt_limited: Annotated[
        float, Setting("The same by an output that stood at a limit", 1.0, 20.0, source="harm by saturation, seed 72")
    ] = 4.0
    doubt_left: Annotated[
        float, Setting("The same by more than noise that the model leaves", 1.0, 10.0, source="swing.unexplained")
    ] = 2.0
    most_agree: Annotated[
        int, Setting("Further records that count", 1, 20, "records", source="odds of 1 in 250 are no longer counted")
    ] = 3
    risk: Annotated[
        float,
        Setting("Risk of more action on an unknown process, per unit of ln", 0.0, 10.0, source="kc x2 costs kc x2"),
    ] = 1.0
    risk_swing: Annotated[
        float, Setting("The same more by the decay ratio that was seen", 0.0, 10.0, source="tripled where it swings on")
    ] = 2.0
    most_risk: Annotated[
        float, Setting("Most that more action costs", 0.1, 10.0, source="the trial ends within a response")
    ] = 1.0
    calm_decay: Annotated[
        float, Setting("Decay ratio from which a loop is helped by less action", 0.1, 0.5, source="quarter decay")
    ] = 0.25
    relief: Annotated[
        float,
        Setting("What that brings per unit of ln and of decay above it", 0.0, 20.0, source="even at a decay of a half"),
    ] = 4.0

    def __post_init__(self) -> None:
        require_in_range(self, "choice")

    def by_loads(self) -> "ChoiceSettings":
        """The same for models that rest on loads alone."""
        return replace(self, ms_width=max(self.ms_width, self.ms_width_loads))
