"""[adaptation.admission] and [adaptation.pattern]: what may teach a region, and what may be done without a model."""

from collections.abc import Iterator

from retuner.config.setting import Problem, Section, setting


class AdmissionConfig(Section):
    """[adaptation.admission]: which responses may teach their region anything."""

    limited_share: float = setting(
        "Largest share of a response with the output at a limit",
        unit="1",
        low=0,
        high=1,
        default=0.5,
        source="a fit takes co as it was applied; half of it must still move",
    )
    lost_share: float = setting(
        "Largest share of lost samples", unit="1", low=0, high=0.5, default=0.1, source="one in ten"
    )
    uneven_share: float = setting(
        "Largest share of samples at uneven times", unit="1", low=0, high=1, default=0.1, source="one in ten"
    )
    repeated_share: float = setting(
        "Largest share of samples that repeat the one before although the error is outside the noise band",
        unit="1",
        low=0,
        high=1,
        default=0.2,
        source="integral action moves co at every such sample",
    )
    outside_share: float = setting(
        "Largest share of samples outside the region",
        unit="1",
        low=0,
        high=0.5,
        default=0.05,
        source="noise of a measured variable",
    )
    moves_most: int = setting(
        "Movements of the setpoint in one response that are still a person's",
        unit="moves",
        low=1,
        high=20,
        default=4,
        source="a cascade's master moves it all the time",
    )
    moving_share: float = setting(
        "Largest share of samples at which the setpoint moves",
        unit="1",
        low=0,
        high=1,
        default=0.3,
        source="a ramp is one movement, and shorter than the response",
    )
    excitation_bands: float = setting(
        "Least height of a response in noise bands",
        unit="1",
        low=2,
        high=10,
        default=2.2,
        source="the recogniser starts at 2; weaker ones are weighed by the fit",
    )


class PatternConfig(Section):
    """[adaptation.pattern]: small steps by the look of a response, where no process can be identified."""

    allowed: bool = setting(
        "Whether gains may be moved without a model",
        unit="-",
        default=True,
        source="in small steps only, on trial, and never for other causes",
    )
    overshoot_target: float = setting(
        "Overshoot that is aimed at",
        unit="1",
        low=0.05,
        high=0.5,
        default=0.15,
        source="below the 0.3 of Astrom & Hagglund 1995, section 6.5: Ms stays below 2",
    )
    damping_target: float = setting(
        "Damping that is aimed at (0 is dead-beat, 1 swings on)",
        unit="1",
        low=0.05,
        high=0.5,
        default=0.15,
        source="as the overshoot: for a clean decay both are equal",
    )
    dead_zone: float = setting(
        "Distance from the targets within which nothing moves",
        unit="1",
        low=0.02,
        high=0.2,
        default=0.05,
        source="what noise makes of an overshoot",
    )
    step_up: float = setting(
        "Greatest factor per response towards more action",
        unit="1",
        low=1.05,
        high=2,
        default=1.3,
        source="a gain margin of 1.9 outlives two of them",
    )
    step_down: float = setting(
        "Greatest factor per response towards less action",
        unit="1",
        low=1.05,
        high=2,
        default=1.5,
        source="safety is reached faster than speed",
    )

    def problems(self) -> Iterator[Problem]:
        """Targets that the dead zone leaves."""
        for name in ("overshoot_target", "damping_target"):
            target: float = getattr(self, name)
            if self.dead_zone > target:
                yield Problem(("dead_zone",), f"= {self.dead_zone:g} must be at most {name} = {target:g}")
