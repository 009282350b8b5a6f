"""The whole configuration, schema 1, and what must hold between its sections."""

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Discriminator, Tag

from retuner.config.adaptation import AdaptationConfig
from retuner.config.bench_config import CONFIRM_SAMPLES, BusConfig, DeviceConfig, OutputConfig, ScenarioConfig
from retuner.config.foreign import CanOpenDeviceConfig, DbcDeviceConfig
from retuner.config.schedule_config import AxisConfig, RegionConfig, ScheduleConfig
from retuner.config.section import Problem, Section, setting
from retuner.drivers.controller.firmware_settings import SAMPLES_MAX
from retuner.schedule.controller_units import DEFAULT, Acting, ControllerUnits
from retuner.schedule.gains import PidGains, in_form
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup

# [loop]: the controller and its ranges.


class LoopConfig(Section):
    """[loop]: what is controlled and with what limits."""

    name: str = setting("Name of the loop in reports and the ledger", "1..64 characters", source="the plant's tag")
    pv_unit: str = setting("Engineering unit of pv and sp", "1..16 characters", source="the transmitter")
    pv_min: float = setting("Lower end of the pv range", "-1e9..1e9 pv", source="the transmitter")
    pv_max: float = setting("Upper end of the pv range", "-1e9..1e9 pv", source="the transmitter")
    sample_time_s: float = setting("Sampling interval of the controller", "0.0001..3600 s", source="the controller")
    co_min_pct: float = setting("Lower limit of the output", "-200..200 %", 0.0, "actuator")
    co_max_pct: float = setting("Upper limit of the output", "-200..200 %", 100.0, "actuator")
    co_rate_pct_per_s: float | None = setting(
        "Fastest move of the output; absent: no limit", ">0..1e6 %/s", None, "actuator"
    )
    b: float = setting(
        "Setpoint weight of the proportional action: 1 acts on the error, 0 on pv alone",
        "0..1 1",
        1.0,
        "Astrom & Hagglund 2006, section 3.4; 1 is what SIMC assumes",
    )
    tau_f_s: float = setting("Filter time of the derivative action; 0: no filter", "0..1e6 s", 0.0, "controller")

    plant: str = setting(
        "Plant that the loop shares with others of the session, by a name: they are retuned with regard to each other; "
        "empty: its own",
        "0..64 characters",
        "",
    )
    controller: str | None = setting(
        'How gains are shown: "yokogawa", "kc-s", "pb-rpm" and so on (docs/coming-from.md); absent: as the first '
        "region has them",
        "1..32 characters",
        None,
    )
    action: Literal["reverse", "direct"] | None = setting(
        "What the output does when pv rises: reverse, it falls (heating); direct, it rises (cooling); absent: the sign "
        "of the gains says it, negative for direct",
        default=None,
        source="the controller's switch",
    )

    @property
    def acting(self) -> Acting | None:
        """The controller's action, where it is given."""
        return None if self.action is None else Acting(self.action)

    def problems(self) -> Iterator[Problem]:
        """Ranges with room between their ends, and units that there are."""
        if self.pv_min >= self.pv_max:
            message = (
                f"= {self.pv_max:g} must be greater than pv_min = {self.pv_min:g}; give the range of the transmitter"
            )
            yield Problem(("pv_max",), message)
        if self.co_min_pct >= self.co_max_pct:
            message = f"= {self.co_max_pct:g} must be greater than co_min_pct = {self.co_min_pct:g}"
            yield Problem(("co_max_pct",), message)
        try:
            ControllerUnits.named(self.controller or DEFAULT, 1.0)
        except ValueError as error:
            yield Problem(("controller",), f"= {error}")


SCHEMA = 1
CONFIRM_ROOM = 10
"""Samples that a confirmation may take beside the probation: the write's own read-back, and repeated frames."""


def _kind(device: object) -> str:
    """Which device a section is of; without a word about it, our own virtual one."""
    kind = device.get("kind", "virtual") if isinstance(device, Mapping) else getattr(device, "kind", "virtual")
    return kind if isinstance(kind, str) else "virtual"


AnyDevice = Annotated[
    Annotated[DeviceConfig, Tag("virtual")]
    | Annotated[DbcDeviceConfig, Tag("dbc")]
    | Annotated[CanOpenDeviceConfig, Tag("canopen")],
    Discriminator(_kind),
]


def _in_seconds(region: RegionConfig, gains: PidGains) -> dict[str, float | None]:
    if region.dials == ControllerUnits().dials:
        return {"kc": math.copysign(region.dialled, gains.kp), "tau_i": region.integral_time_s, "tau_d": region.tau_d_s}
    return in_form(gains, region.form)


class Config(Section):
    """One loop, its schedule, and how it is watched and retuned."""

    schema_version: Literal[1] = setting("Version of this file's layout", source="this release", alias="schema")
    loop: LoopConfig = setting("The loop")
    schedule: ScheduleConfig = setting("Which gains apply where")
    adaptation: AdaptationConfig = setting(
        "What the retuner may do", default=AdaptationConfig.model_validate({}), source="advise only"
    )
    bus: BusConfig = setting("The CAN bus", default=BusConfig(), source="virtual")
    device: AnyDevice | None = setting(
        "The device; absent: a controller of the native protocol is connected", default=None
    )
    scenario: ScenarioConfig | None = setting("What happens in a run; absent: watch until stopped", default=None)
    output: OutputConfig = setting("What a run leaves behind", default=OutputConfig(), source="runs/latest")

    @property
    def own_device(self) -> DeviceConfig | None:
        """The virtual device of the native protocol, if it is one."""
        return self.device if isinstance(self.device, DeviceConfig) else None

    @property
    def foreign_device(self) -> DbcDeviceConfig | CanOpenDeviceConfig | None:
        """The controller that is not ours, if it is one."""
        return self.device if isinstance(self.device, DbcDeviceConfig | CanOpenDeviceConfig) else None

    @property
    def node_key(self) -> tuple[str, str]:
        """Where the number of the controller stands: in [device], for one that is not ours, else in [bus]."""
        foreign = self.foreign_device
        return ("device" if foreign is not None and foreign.node is not None else "bus", "node")

    @property
    def node(self) -> int:
        """Number of the controller on its bus."""
        foreign = self.foreign_device
        return self.bus.node if foreign is None or foreign.node is None else foreign.node

    def limits_of(self, axis: AxisConfig) -> tuple[str, float, float]:
        """Unit and ends of an axis' variable."""
        if axis.variable == "co":
            return axis.limits("%", self.loop.co_min_pct, self.loop.co_max_pct)
        return axis.limits(self.loop.pv_unit, self.loop.pv_min, self.loop.pv_max)

    def regions(self) -> Regions:
        """The regions as the schedule room knows them."""
        return self.schedule.as_regions(tuple(map(self.limits_of, self.schedule.axes)))

    def gains(self) -> tuple[PidGains, ...]:
        """The gains of each region in parallel form, in the order of the regions."""
        return tuple(region.gains(self._span, self.loop.acting) for region in self.schedule.regions)

    def units_in(self, region: RegionConfig) -> ControllerUnits:
        """The units in which a region has its gains."""
        return region.units(self._span, self.loop.acting)

    @property
    def units(self) -> ControllerUnits:
        """The units in which people see the gains."""
        if self.loop.controller is not None:
            return ControllerUnits.named(self.loop.controller, self._span, action=self.loop.acting)
        return ControllerUnits(self.schedule.regions[0].dials, pv_span=self._span, action=self.loop.acting)

    def gain_table(self) -> GainTable:
        """The gain table as commissioned: revision 0."""
        return GainTable(self.loop.name, self.regions(), self.gains(), Lookup(self.schedule.lookup))

    def summary(self) -> dict[str, object]:
        """What it says, as JSON values: every setting with its defaults, and the gains of each region."""
        settings = self.model_dump(mode="json", by_alias=True)
        settings["loop"]["controller"] = self.loop.controller or self.units.name
        where = self.regions()
        regions = [
            {
                "name": region.name,
                "low": where.span(i)[0],
                "high": where.span(i)[1],
                "unit": where.unit,
                "along": [
                    {"variable": axis.label, "low": axis.span(part)[0], "high": axis.span(part)[1], "unit": axis.unit}
                    for axis, part in zip(where.axes, where.cell(i), strict=True)
                ],
                "neighbours": [where.names[other] for other in where.neighbours(i)],
                "form": region.form,
                "gains": _in_seconds(region, gains),
                "parallel": {"kp": gains.kp, "ki": gains.ki, "kd": gains.kd},
            }
            for i, (region, gains) in enumerate(zip(self.schedule.regions, self.gains(), strict=True))
        ]
        return {**settings, "regions": regions}

    def problems(self) -> Iterator[Problem]:
        """What must hold between sections."""
        loop, schedule, adaptation, scenario = self.loop, self.schedule, self.adaptation, self.scenario
        sample = loop.sample_time_s
        shortest = f"must be at least loop.sample_time_s = {sample:g} s"
        for k, axis in enumerate(schedule.axes):
            unit, low, high = self.limits_of(axis)
            path = ("schedule", *(("axis", k) if schedule.axis else ()))
            for i, bound in enumerate(axis.bounds):
                if not low < bound < high:
                    along = f"the range of the scheduling variable {axis.signal or axis.variable}"
                    told = f"= {bound:g} must lie between {low:g} and {high:g} {unit}, {along}"
                    yield Problem((*path, "bounds", i), told)
            narrowest = min(b - a for a, b in pairwise((low, *axis.bounds, high)))
            if axis.hysteresis > narrowest / 2 > 0:
                most = f"at most half of the narrowest region, {narrowest / 2:g} {unit}"
                yield Problem((*path, "hysteresis"), f"= {axis.hysteresis:g} must be {most}")
        for i, region in enumerate(schedule.region):
            if loop.action is not None and region.dialled < 0:  # gains have no sign of their own then
                told = f"= {region.dialled:g}: loop.action = {loop.action!r} says the direction; give it positive"
                yield Problem(("schedule", "region", i, region.dials[0].key), told)
        for i, region in enumerate(schedule.region):
            tau_i = region.integral_time_s
            if tau_i is not None and tau_i < sample:
                yield Problem(("schedule", "region", i, region.dials[1].key), f"= {tau_i:g} s {shortest}")
        if adaptation.wait_s is not None and adaptation.wait_s < sample:
            yield Problem(("adaptation", "wait_s"), f"= {adaptation.wait_s:g} s {shortest}")
        if scenario is not None and scenario.duration_s < sample:
            told = f"= {scenario.duration_s:g} s is shorter than one sample of {sample:g} s"
            yield Problem(("scenario", "duration_s"), told)
        confirm, probation = self.confirm_within_s, self.bus.probation_samples
        least, most_s = (probation + CONFIRM_ROOM) * sample, SAMPLES_MAX * sample
        if confirm and not least <= confirm <= most_s:
            why = f"the {probation} samples of probation and {CONFIRM_ROOM} more"
            told = f"= {confirm:g} s must be 0, or {least:g} to {most_s:g} s: {why}"
            yield Problem(("device", "confirm_within_s"), told)
        for i, step in enumerate(scenario.steps if scenario else ()):
            if step.sp is not None and not loop.pv_min <= step.sp <= loop.pv_max:
                told = f"= {step.sp:g} must lie in the pv range, {loop.pv_min:g} to {loop.pv_max:g} {loop.pv_unit}"
                yield Problem(("scenario", "steps", i, "sp"), told)
        if adaptation.noise_band is not None and adaptation.noise_band > self._span / 2:
            half = f"more than half of the pv range of {self._span:g}; give a few standard deviations of the noise"
            yield Problem(("adaptation", "noise_band"), f"= {adaptation.noise_band:g} is {half}")

    @property
    def _span(self) -> float:
        return self.loop.pv_max - self.loop.pv_min

    @property
    def confirm_within_s(self) -> float:
        """Trial time of the virtual device's firmware, s; 0: none."""
        if self.own_device is None:
            return 0.0
        given = self.own_device.confirm_within_s
        least = max(CONFIRM_SAMPLES, 2 * (self.bus.probation_samples + CONFIRM_ROOM))
        return given if given is not None else min(least, SAMPLES_MAX) * self.loop.sample_time_s
