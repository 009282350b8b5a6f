"""[bus], [device], [scenario] and [output]: where the controller hangs, what stands in for it, what happens."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from retuner.config.setting import Many, Problem, Section, setting
from retuner.drivers.plants.boiler_plant import BoilerSettings
from retuner.drivers.plants.oven_plant import OvenSettings

OVEN, BOILER = OvenSettings(), BoilerSettings()  # the defaults of oven and boiler are the plants' own
NODES = 63  # the identifier is node << 5 | command in 11 bits; node 0 is for all


class BusConfig(Section):
    """[bus]: the CAN bus, in python-can's own words."""

    interface: str = setting(
        "python-can interface: virtual, socketcan, udp_multicast, ...",
        unit="-",
        text=(1, 64),
        default="virtual",
        source="needs no hardware",
    )
    channel: str = setting("Channel of the interface", unit="-", text=(1, 256), default="retuner", source="the user")
    node: int = setting("Node number of the controller", unit="-", low=1, high=NODES, default=1, source="retuner.dbc")
    hop_limit: int = setting(
        "Networks that udp_multicast frames may cross; 0 keeps them on this host",
        unit="-",
        low=0,
        high=255,
        default=0,
        source="no frame leaves the host unasked",
    )
    lease_s: float = setting(
        "How long the controller stays reserved for a host that has died; at least 30 samples",
        unit="s",
        above=0,
        high=3600,
        default=3.0,
        source="a restart of the host",
    )
    probation_samples: int = setting(
        "Samples that must show a new set running before it is confirmed",
        unit="samples",
        low=0,
        high=10000,
        default=5,
        source="the link must be seen to work",
    )
    key_file: str = setting(
        "File with the key that authenticates commits, hexadecimal, readable by you alone; empty for none",
        unit="-",
        text=(0, 1024),
        default="",
        source="the user",
    )


class OvenPlantConfig(Section):
    """[device.plant] with kind = "oven": a laboratory oven, 20 to 220 degC."""

    kind: Literal["oven"] = setting("Which plant", unit="-", source="the user")
    start_c: float = setting("Temperature at the start", unit="degC", low=-50, high=500, default=20.0, source="a room")
    power_w: float = setting("Heater power at 100 %", unit="W", above=0, high=1e6, default=OVEN.power_w, source="plant")
    phase_share: float = setting(
        "Share of the power under phase-angle control",
        unit="1",
        low=0,
        high=0.9,
        default=OVEN.phase_share,
        source="plant",
    )
    jacket_c: float = setting(
        "Temperature of the cooled jacket", unit="degC", low=-273.15, high=500, default=OVEN.jacket_c, source="plant"
    )
    convection_w_k: float = setting(
        "Heat lost by convection", unit="W/K", above=0, high=1e4, default=OVEN.convection_w_k, source="plant"
    )
    radiating_area_m2: float = setting(
        "Emissivity times radiating area", unit="m2", low=0, high=100, default=OVEN.radiating_area_m2, source="plant"
    )
    heat_capacity_j_k: float = setting(
        "Heat capacity at 20 degC", unit="J/K", above=0, high=1e8, default=OVEN.heat_capacity_j_k, source="plant"
    )
    capacity_growth_1_k: float = setting(
        "Growth of the heat capacity", unit="1/K", low=0, high=1, default=OVEN.capacity_growth_1_k, source="plant"
    )
    theta_cold_s: float = setting(
        "Transport delay at 20 degC", unit="s", above=0, high=1e5, default=OVEN.theta_cold_s, source="plant"
    )
    theta_hot_s: float = setting(
        "Transport delay at 220 degC", unit="s", above=0, high=1e5, default=OVEN.theta_hot_s, source="plant"
    )
    tau_sensor_s: float = setting("Sensor lag", unit="s", above=0, high=1e5, default=OVEN.tau_sensor_s, source="plant")
    noise_c: float = setting(
        "Standard deviation of the measurement noise",
        unit="degC",
        low=0,
        high=100,
        default=OVEN.noise_c,
        source="plant",
    )

    def settings(self) -> OvenSettings:
        """The oven's physics as the plant takes it."""
        return OvenSettings(**self.model_dump(exclude={"kind", "start_c"}))


class LinearPlantConfig(Section):
    """[device.plant] with kind = "linear": G(s) = k prod(1 + lead s) / (s^n prod(1 + lag s)) e^(-theta s), exact."""

    kind: Literal["linear"] = setting("Which plant", unit="-", source="the user")
    k: float = setting("Gain; per second for an integrating plant", unit="pv/%", low=-1e9, high=1e9, source="the user")
    lags_s: Many[Annotated[float, Field(ge=0, le=1e9)]] = setting("Lags", unit="s", default=(), source="the user")
    leads_s: Many[Annotated[float, Field(ge=-1e9, le=1e9)]] = setting(
        "Leads; a negative one is an inverse response", unit="s", default=(), source="the user"
    )
    theta_s: float = setting("Dead time", unit="s", low=0, high=1e7, default=0.0, source="the user")
    integrators: int = setting("Number of integrators", unit="-", low=0, high=2, default=0, source="the user")
    start_pv: float = setting("pv at the start, at rest", unit="pv", low=-1e9, high=1e9, default=0.0, source="the user")
    start_co_pct: float = setting(
        "Output that holds start_pv", unit="%", low=-200, high=200, default=50.0, source="user"
    )
    noise: float = setting(
        "Standard deviation of the measurement noise", unit="pv", low=0, default=0.0, source="the user"
    )

    def problems(self) -> Iterator[Problem]:
        """A process that moves and that can be built."""
        if self.k == 0:
            yield Problem(("k",), "= 0: the output would not move this plant; give its gain")
        if len(self.leads_s) > len(self.lags_s) + self.integrators:
            yield Problem(
                ("leads_s",),
                f"has {len(self.leads_s)} leads for {len(self.lags_s) + self.integrators} lags "
                "and integrators; a plant needs at least as many of these",
            )


class BoilerPlantConfig(Section):
    """[device.plant] with kind = "boiler": a continuous-flow boiler: gain by temperature, lag and delay by flow."""

    kind: Literal["boiler"] = setting("Which plant; a load is the change of its flow", unit="-", source="the user")
    start_c: float = setting("Temperature at the start", unit="degC", low=0, high=500, default=30.0, source="the user")
    inlet_c: float = setting(
        "Temperature of the water that comes in", unit="degC", low=-50, high=500, default=BOILER.inlet_c, source="plant"
    )
    power_max_c: float = setting(
        "How much full power heats the nominal flow",
        unit="K",
        above=0,
        high=1e4,
        default=BOILER.power_max_c,
        source="plant",
    )
    rangeability: float = setting(
        "Rangeability of the fuel valve (equal percentage)",
        unit="1",
        low=1.001,
        high=1000,
        default=BOILER.rangeability,
        source="plant",
    )
    tank_s: float = setting(
        "Lag of the tank at nominal flow", unit="s", above=0, high=1e5, default=BOILER.tank_s, source="plant"
    )
    pipe_s: float = setting(
        "Delay of the pipe at nominal flow", unit="s", above=0, high=1e5, default=BOILER.pipe_s, source="plant"
    )
    tau_sensor_s: float = setting(
        "Sensor lag", unit="s", above=0, high=1e5, default=BOILER.tau_sensor_s, source="plant"
    )
    noise_c: float = setting(
        "Standard deviation of the measurement noise",
        unit="degC",
        low=0,
        high=100,
        default=BOILER.noise_c,
        source="plant",
    )
    flow_noise_pct: float = setting(
        "Standard deviation of the measured flow's noise, which the device publishes as PLANT.aux",
        unit="%",
        low=0,
        high=100,
        default=BOILER.flow_noise_pct,
        source="plant",
    )

    def settings(self) -> BoilerSettings:
        """The boiler's physics as the plant takes it."""
        return BoilerSettings(**self.model_dump(exclude={"kind", "start_c"}))


PlantConfig = Annotated[OvenPlantConfig | LinearPlantConfig | BoilerPlantConfig, Field(discriminator="kind")]
CONFIRM_SAMPLES = 60
"""Samples of the trial time where none is given: the session has all the time to confirm, and a dead one does not."""


class DeviceConfig(Section):
    """[device] with kind = "virtual": our own virtual controller. Leave the section out for a real one."""

    kind: Literal["virtual"] = setting("Which device", unit="-", default="virtual", source="the native protocol")
    confirm_within_s: float | None = setting(
        "Time within which a new set must be confirmed, or the confirmed one runs again; 0 for any time; absent: "
        f"{CONFIRM_SAMPLES} samples",
        unit="s",
        low=0,
        high=1e6,
        default=None,
        source="twice what a lost link and the probation take",
    )
    seed: int = setting("Seed of the measurement noise", unit="-", low=0, high=2**32 - 1, default=1, source="the user")
    plant: PlantConfig = setting("The simulated plant behind the virtual device", unit="-", source="the user")


class StepConfig(Section):
    """One entry of [scenario] steps: from at_s on, this setpoint, this load, or both."""

    at_s: float = setting("When", unit="s", low=0, high=1e9, source="the user")
    sp: float | None = setting("New setpoint", unit="pv", low=-1e9, high=1e9, default=None, source="the user")
    load: float | None = setting("New load on the plant", unit="%", low=-200, high=200, default=None, source="the user")

    def problems(self) -> Iterator[Problem]:
        """A step that steps."""
        if self.sp is None and self.load is None:
            yield Problem((), "has neither sp nor load; give one of them")


class ScenarioConfig(Section):
    """[scenario]: what happens in a run on the virtual device."""

    duration_s: float = setting("Length of the run", unit="s", above=0, high=1e9, source="the user")
    steps: Many[StepConfig] = setting("Setpoint and load steps, in the order of time", unit="-", source="the user")

    def problems(self) -> Iterator[Problem]:
        """Steps in order, inside the run, and a setpoint to start with."""
        for i, step in enumerate(self.steps):
            if i > 0 and step.at_s < self.steps[i - 1].at_s:
                yield Problem(
                    ("steps", i, "at_s"),
                    f"= {step.at_s:g} s lies before the step above it at "
                    f"{self.steps[i - 1].at_s:g} s; order the steps by time",
                )
            if step.at_s >= self.duration_s:
                yield Problem(
                    ("steps", i, "at_s"),
                    f"= {step.at_s:g} s lies at or after the end of the run, "
                    f"duration_s = {self.duration_s:g} s; make the run longer",
                )
        if not any(step.at_s == 0 and step.sp is not None for step in self.steps):
            yield Problem(("steps",), "give no setpoint to start with; add {at_s = 0.0, sp = ...}")


class OutputConfig(Section):
    """[output]: what a run leaves behind, and where."""

    directory: str = setting(
        "Folder for report, ledger, trend and bus log, relative to where the command runs",
        unit="-",
        text=(1, 1024),
        default="runs/latest",
        source="git-ignored",
    )
    trend: Literal["csv", "parquet"] = setting(
        "Format of the trend; parquet needs the extra of that name", unit="-", default="csv", source="base install"
    )
    bus_log_mb: float = setting(
        "Size that the bus log may reach; then its oldest half goes, and the run cannot be replayed from its beginning",
        unit="MB",
        low=1,
        high=1e6,
        default=256.0,
        source="a day at 100 samples a second: 27 bytes a sample, 233 MB",
    )
    ledger_mb_warn: float = setting(
        "Size of the ledger past which a run says so once; the ledger is never cut",
        unit="MB",
        low=1,
        high=1e6,
        default=256.0,
        source="32,000 decisions of 8 kB: three weeks with one a minute",
    )
