"""[adaptation]: what the retuner may do, and the limits of the proof before a change.

[adaptation.limits], [adaptation.admission], [adaptation.pattern] and [adaptation.bumps]: how far the guard lets
gains go, what may teach a region, what may be done without a model, and whether the setpoint may be bumped. The
settings are declared where they are used.
"""

from collections.abc import Iterator
from typing import Literal

from retuner.adaptive.diagnosis.cause import CauseSettings
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.setpoint_bumps.bump_settings import BumpSettings
from retuner.adaptive.supervision.admission import AdmissionSettings
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.adaptive.without_model.pattern_rule import PatternSettings
from retuner.config.section import Many, Problem, Section, holding, setting

GENERAL = ("ms_nominal", "ms_worst", "tau_c_max_ratio", "kc_min", "kc_max", "step_up_max", "step_down_max")
"""Settings of the guard that stand in [adaptation] itself."""
FACTOR = {"high": 10.0, "positive": True}
NARROWER = {"ms_nominal": {"high": 2.0}, "ms_worst": {"high": 3.0}, "step_up_max": FACTOR, "step_down_max": FACTOR}
"""Limits in the file of what the guard, in trying ways of a change, sets farther."""

# ---- The sections below [adaptation]


@holding(GuardSettings, but=GENERAL)
class LimitsConfig(Section):
    """[adaptation.limits]: limits of a change that are seldom needed."""

    def problems(self) -> Iterator[Problem]:
        """Limits that leave room."""
        given = self.model_dump()
        least, most = given["tau_i_min_s"], given["tau_i_max_s"]
        if least is not None and most is not None and least >= most:
            yield Problem(("tau_i_max_s",), f"= {most:g} must be greater than tau_i_min_s = {least:g}")


@holding(AdmissionSettings)
class AdmissionConfig(Section):
    """[adaptation.admission]: which responses may update the model of their region."""


@holding(PatternSettings)
class PatternConfig(Section):
    """[adaptation.pattern]: small steps by the look of a response, where no process can be identified."""

    allowed: bool = setting(
        "Whether gains may be moved without a model",
        default=True,
        source="in small steps only, on trial, and never for other causes",
    )

    def problems(self) -> Iterator[Problem]:
        """Targets that the dead zone leaves."""
        given = self.model_dump()
        for name in ("overshoot_target", "damping_target"):
            if given["dead_zone"] > given[name]:
                yield Problem(("dead_zone",), f"= {given['dead_zone']:g} must be at most {name} = {given[name]:g}")


@holding(BumpSettings)
class BumpsConfig(Section):
    """[adaptation.bumps]: small setpoint bumps where nothing else shows the process, in modes trial and auto."""

    allowed: bool = setting(
        "Whether retuner may move the setpoint a little, for a while, where nothing else shows the process",
        default=False,
        source="no test signal unless someone asks for it",
    )

    def problems(self) -> Iterator[Problem]:
        """Hours in which there is time."""
        given = self.model_dump()
        if given["from_h"] == given["to_h"]:
            yield Problem(("to_h",), f"= {given['to_h']:g} must differ from from_h, or no bump could ever begin")


@holding(TrialSettings, "trial_")
@holding(GuardSettings, narrower=NARROWER)
class AdaptationConfig(Section):
    """[adaptation]: mode, rule and limits of changes."""

    mode: Literal["off", "advise", "trial", "auto"] = setting(
        "off: only watch; advise: propose, and write what an operator approves; trial: write one proved change a "
        "region, roll it back when worse, else wait for operator approval; auto: the same, without waiting",
        default="advise",
        source="nothing changes until someone allows it",
    )
    rule: Literal["simc"] = setting("Tuning rule", default="simc", source="Skogestad 2003")
    ms_nominal: float
    ms_worst: float
    tau_c_max_ratio: float
    kc_min: float | None
    kc_max: float | None
    step_up_max: float
    step_down_max: float
    locked: Many[Literal["kc", "tau_i", "tau_d"]] = setting(
        'Parameters that stay as they are: ["tau_d"] for no derivative, ["tau_i", "tau_d"] for kc only',
        default=(),
        source="user",
    )
    limits: LimitsConfig = setting("Further limits of a change", default=LimitsConfig(), source="see there")
    admission: AdmissionConfig = setting(
        "Which responses may update a region's model", default=AdmissionConfig(), source="see there"
    )
    pattern: PatternConfig = setting("What may be done without a model", default=PatternConfig(), source="see there")
    bumps: BumpsConfig = setting(
        "Small setpoint bumps where days pass without evidence",
        default=BumpsConfig(),
        source="see there",
        names=("bumps", "nudge"),
    )
    approval_s: float = setting(
        "How long a proposal may be approved after it was made", ">0..1e8 s", 86400.0, "a day: every shift sees it"
    )
    decision_deadline_s: float = setting(
        "On a real bus: machine's time that a decision may take; past it nothing is changed, and the screen says so",
        "1..1e5 s",
        300.0,
        "a hundred times a decision's usual time",
    )
    decision_delay_samples: int = setting(
        "In simulated time: samples after which a decision is entered; 0 at the sample that raised it",
        "0..100000 samples",
        0,
        "time stands still there while a decision is made",
    )
    trial_responses: int
    trial_level: float
    trial_inconclusive: int
    trial_settles: float
    edit_hold_s: float
    cool_down_s: float | None
    lock_out_after: int
    pretune: bool = setting(
        "Before a run: first model and settings from a commanded step of co, the loop restored as it was",
        default=False,
        source="no test signal unless someone allows it",
    )
    pretune_step_pct: float | None = setting(
        "That step, negative for down; absent: 5 % of the range of co", "-50..50 %", None, "user"
    )
    noise_band: float | None = setting("Noise band of pv; absent: estimated from the data", ">0..1e9 pv", None, "user")
    wait_s: float | None = setting(
        "Longest wait for the next peak; absent: from the active integral time", ">0..1e7 s", None, "user"
    )

    @property
    def ms_marked(self) -> float:
        """Ms from which a loop is marked as not robust: of the true process, where it is known, 1.8 by design."""
        return max(self.ms_nominal, CauseSettings().ms_high)

    def problems(self) -> Iterator[Problem]:
        """Limits that leave room."""
        if self.ms_worst < self.ms_nominal:
            yield Problem(("ms_worst",), f"= {self.ms_worst:g} must be at least ms_nominal = {self.ms_nominal:g}")
        if self.kc_min is not None and self.kc_max is not None and self.kc_min >= self.kc_max:
            yield Problem(("kc_max",), f"= {self.kc_max:g} must be greater than kc_min = {self.kc_min:g}")
