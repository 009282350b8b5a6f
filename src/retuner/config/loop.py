"""[loop]: the controller and its ranges."""

from collections.abc import Iterator

from retuner.config.setting import Problem, Section, setting


class LoopConfig(Section):
    """[loop]: what is controlled and with what limits."""

    name: str = setting("Name of the loop in reports and the ledger", unit="-", text=(1, 64), source="the plant's tag")
    pv_unit: str = setting("Engineering unit of pv and sp", unit="-", text=(1, 16), source="the transmitter")
    pv_min: float = setting("Lower end of the pv range", unit="pv", low=-1e9, high=1e9, source="the transmitter")
    pv_max: float = setting("Upper end of the pv range", unit="pv", low=-1e9, high=1e9, source="the transmitter")
    sample_time_s: float = setting(
        "Sampling interval of the controller", unit="s", low=0.001, high=3600, source="the controller"
    )
    co_min_pct: float = setting(
        "Lower limit of the output", unit="%", low=-200, high=200, default=0.0, source="actuator"
    )
    co_max_pct: float = setting(
        "Upper limit of the output", unit="%", low=-200, high=200, default=100.0, source="actuator"
    )
    co_rate_pct_per_s: float | None = setting(
        "Fastest move of the output; absent: no limit", unit="%/s", above=0, high=1e6, default=None, source="actuator"
    )
    b: float = setting(
        "Setpoint weight of the proportional action: 1 acts on the error, 0 on pv alone", unit="1", low=0, high=1,
        default=1.0, source="Astrom & Hagglund 2006, section 3.4; 1 is what SIMC assumes",
    )  # fmt: skip
    tau_f_s: float = setting(
        "Filter time of the derivative action; 0: no filter",
        unit="s",
        low=0,
        high=1e6,
        default=0.0,
        source="controller",
    )

    def problems(self) -> Iterator[Problem]:
        """Ranges with room between their ends."""
        if self.pv_min >= self.pv_max:
            message = (
                f"= {self.pv_max:g} must be greater than pv_min = {self.pv_min:g}; give the range of the transmitter"
            )
            yield Problem(("pv_max",), message)
        if self.co_min_pct >= self.co_max_pct:
            message = f"= {self.co_max_pct:g} must be greater than co_min_pct = {self.co_min_pct:g}"
            yield Problem(("co_max_pct",), message)
