"""[adaptation.limits], [adaptation.admission], [adaptation.pattern] and [adaptation.nudge]: how far the guard lets
gains go, what may teach a region, what may be done without a model, and whether the setpoint may be bumped. The
settings are declared where they are used.
"""

from collections.abc import Iterator

from retuner.adaptive.guard.settings import GuardSettings
from retuner.adaptive.setpoint_bumps.bump_settings import NudgeSettings
from retuner.adaptive.supervision.admission import AdmissionSettings
from retuner.adaptive.without_model.pattern_rule import PatternSettings
from retuner.config.section import Problem, Section, holding, setting


@holding(GuardSettings)
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
        unit="-",
        default=True,
        source="in small steps only, on trial, and never for other causes",
    )

    def problems(self) -> Iterator[Problem]:
        """Targets that the dead zone leaves."""
        given = self.model_dump()
        for name in ("overshoot_target", "damping_target"):
            if given["dead_zone"] > given[name]:
                yield Problem(("dead_zone",), f"= {given['dead_zone']:g} must be at most {name} = {given[name]:g}")


@holding(NudgeSettings)
class NudgeConfig(Section):
    """[adaptation.nudge]: small setpoint bumps where nothing else shows the process, in modes trial and auto."""

    allowed: bool = setting(
        "Whether retuner may move the setpoint a little, for a while, where nothing else shows the process",
        unit="-",
        default=False,
        source="no test signal unless someone asks for it",
    )

    def problems(self) -> Iterator[Problem]:
        """Hours in which there is time."""
        given = self.model_dump()
        if given["from_h"] == given["to_h"]:
            yield Problem(("to_h",), f"= {given['to_h']:g} must differ from from_h, or no bump could ever begin")
