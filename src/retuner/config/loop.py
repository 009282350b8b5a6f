"""[loop] and [schedule]: the controller, its ranges, and which gains are in force where."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from retuner.config.setting import Many, Problem, Section, setting
from retuner.schedule.forms import from_form
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions

IntegralTime = Annotated[float, Field(gt=0, le=1e9)]
NO_INTEGRAL = "none"  # how a person writes "no integral action": leaving it out by mistake must not mean the same


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


class RegionConfig(Section):
    """[[schedule.region]]: the gains of one operating region, in a named form."""

    name: str = setting("Name of the region in reports", unit="-", text=(1, 32), source="the user")
    kc: float = setting(
        "Controller gain of the named form, negative for a reverse-acting process", unit="%/pv", low=-1e9, high=1e9,
        source="the gains in force",
    )  # fmt: skip
    tau_i_s: IntegralTime | Literal["none"] = setting(
        'Integral time of the named form, or "none" for no integral action', unit="s", source="the gains in force"
    )  # fmt: skip
    tau_d_s: float = setting(
        "Derivative time of the named form", unit="s", low=0, high=1e9, default=0.0, source="the gains in force"
    )
    form: Literal["series", "ideal", "parallel"] = setting(
        "Form of kc, tau_i_s and tau_d_s; parallel means the times are kp/ki and kd/kp", unit="-", default="series",
        source="SIMC's native form",
    )  # fmt: skip

    def problems(self) -> Iterator[Problem]:
        """Gains that a controller can have."""
        if self.kc == 0:
            yield Problem(("kc",), "= 0 would control nothing; give the gain in force, negative when reverse-acting")

    @property
    def integral_time_s(self) -> float | None:
        """tau_i_s, or None for no integral action."""
        return None if self.tau_i_s == NO_INTEGRAL else float(self.tau_i_s)

    def gains(self) -> PidGains:
        """The gains in parallel form."""
        return from_form(self.form, self.kc, self.integral_time_s, self.tau_d_s)


class ScheduleConfig(Section):
    """[schedule]: regions along a scheduling variable."""

    variable: Literal["sp", "pv", "co"] = setting("What the gains follow", unit="-", default="sp", source="sp is quiet")
    bounds: Many[float] = setting(
        "Borders between the regions, increasing; none for a single region",
        unit="pv or %",
        default=(),
        source="the user",
    )
    hysteresis: float = setting(
        "How far beyond a border a region is kept", unit="pv or %", low=0, high=1e9, default=0.0,
        source="more than the noise of the variable; 0 suits sp",
    )  # fmt: skip
    min_stay_s: float = setting("Shortest stay in a region", unit="s", low=0, high=1e6, default=0.0, source="the user")
    lookup: Literal["hard", "interpolated"] = setting(
        "hard: the gains of the region; interpolated: weighted between the regions' centres", unit="-", default="hard",
        source="the simplest to judge",
    )  # fmt: skip
    region: Many[RegionConfig] = setting(
        "One [[schedule.region]] for each region, from the lowest to the highest", unit="-", text=(1, 64), source="user"
    )

    @property
    def regions(self) -> tuple[RegionConfig, ...]:
        """The regions from the lowest to the highest."""
        return self.region

    def problems(self) -> Iterator[Problem]:
        """As many regions as the bounds make, in order, all acting one way."""
        if len(self.region) != len(self.bounds) + 1:
            made = len(self.bounds) + 1
            yield Problem(("region",), f"{len(self.region)} given, but {len(self.bounds)} bounds make {made} regions; "
                          f"give {made} [[schedule.region]] or other bounds")  # fmt: skip
        for i, (low, high) in enumerate(zip(self.bounds, self.bounds[1:], strict=False), 1):
            if low >= high:
                yield Problem(("bounds", i), f"= {high:g} must be greater than the bound before it, {low:g}")
        yield from self._region_problems()

    def _region_problems(self) -> Iterator[Problem]:
        seen: set[str] = set()
        for i, region in enumerate(self.region):
            if region.name in seen:
                yield Problem(("region", i, "name"), f"{region.name!r} is taken by another region; give each its own")
            seen.add(region.name)
            if region.kc * self.region[0].kc < 0:
                yield Problem(("region", i, "kc"), f"= {region.kc:g} acts against the first region's "
                              f"{self.region[0].kc:g}; all regions act one way")  # fmt: skip

    def as_regions(self, unit: str, low: float, high: float) -> Regions:
        """The regions as the schedule room knows them, over a range from low to high in this unit."""
        names = tuple(region.name for region in self.region)
        return Regions(self.variable, unit, names, low, self.bounds, high, self.hysteresis, self.min_stay_s)
