"""[bus], [device], [scenario] and [output]: where the controller hangs, what stands in for it, what happens."""

from collections.abc import Iterator
from typing import Literal

from retuner.config.plants import PlantConfig
from retuner.config.section import Many, Problem, Section, setting

NODES = 63  # the identifier is node << 5 | command in 11 bits; node 0 is for all


class BusConfig(Section):
    """[bus]: the CAN bus, in python-can's own words."""

    interface: str = setting(
        "python-can interface: virtual, socketcan, udp_multicast, ...",
        "1..64 characters",
        "virtual",
        "needs no hardware",
    )
    channel: str = setting("Channel of the interface", "1..256 characters", "retuner")
    node: int = setting("Node number of the controller", f"1..{NODES}", 1, "retuner.dbc")
    hop_limit: int = setting(
        "Networks that udp_multicast frames may cross; 0 keeps them on this host",
        "0..255",
        0,
        "no frame leaves the host unasked",
    )
    lease_s: float = setting(
        "How long the controller stays reserved for a host that has died; at least 30 samples",
        ">0..3600 s",
        3.0,
        "a restart of the host",
    )
    probation_samples: int = setting(
        "Samples that must show a new set running before it is confirmed",
        "0..10000 samples",
        5,
        "the link must be seen to work",
    )
    key_file: str = setting(
        "File with the key that authenticates commits, hexadecimal, readable by you alone; empty for none",
        "0..1024 characters",
        "",
    )


CONFIRM_SAMPLES = 60
"""Samples of the trial time where none is given: the session has all the time to confirm, and a dead one does not."""


class DeviceConfig(Section):
    """[device] with kind = "virtual": our own virtual controller. Leave the section out for a real one."""

    kind: Literal["virtual"] = setting("Which device", default="virtual", source="the native protocol")
    confirm_within_s: float | None = setting(
        "Time within which a new set must be confirmed, or the confirmed one runs again; 0 for any time; absent: "
        f"{CONFIRM_SAMPLES} samples",
        "0..1e6 s",
        None,
        "twice what a lost link and the probation take",
    )
    seed: int = setting("Seed of the measurement noise", f"0..{2**32 - 1}", 1)
    plant: PlantConfig = setting("The simulated plant behind the virtual device")


class StepConfig(Section):
    """One entry of [scenario] steps: from at_s on, this setpoint, this load, or both."""

    at_s: float = setting("When", "0..1e9 s")
    sp: float | None = setting("New setpoint", "-1e9..1e9 pv", None)
    load: float | None = setting("New load on the plant", "-200..200 %", None)

    def problems(self) -> Iterator[Problem]:
        """A step that steps."""
        if self.sp is None and self.load is None:
            yield Problem((), "has neither sp nor load; give one of them")


class ScenarioConfig(Section):
    """[scenario]: what happens in a run on the virtual device."""

    duration_s: float = setting("Length of the run", ">0..1e9 s")
    steps: Many[StepConfig] = setting("Setpoint and load steps, in the order of time")

    def problems(self) -> Iterator[Problem]:
        """Steps in order, inside the run, and a setpoint to start with."""
        for i, step in enumerate(self.steps):
            if i > 0 and step.at_s < self.steps[i - 1].at_s:
                above = f"the step above it at {self.steps[i - 1].at_s:g} s; order the steps by time"
                yield Problem(("steps", i, "at_s"), f"= {step.at_s:g} s lies before {above}")
            if step.at_s >= self.duration_s:
                end = f"the end of the run, duration_s = {self.duration_s:g} s; make the run longer"
                yield Problem(("steps", i, "at_s"), f"= {step.at_s:g} s lies at or after {end}")
        if not any(step.at_s == 0 and step.sp is not None for step in self.steps):
            yield Problem(("steps",), "give no setpoint to start with; add {at_s = 0.0, sp = ...}")


class OutputConfig(Section):
    """[output]: what a run leaves behind, and where."""

    directory: str = setting(
        "Folder for report, ledger, trend and bus log, relative to where the command runs",
        "1..1024 characters",
        "runs/latest",
        "git-ignored",
    )
    trend: Literal["csv", "parquet"] = setting(
        "Format of the trend; parquet needs the extra of that name", default="csv", source="base install"
    )
    bus_log_mb: float = setting(
        "Size that the bus log may reach; then its oldest half goes, and the run cannot be replayed from its beginning",
        "1..1e6 MB",
        256.0,
        "a day at 100 samples a second: 27 bytes a sample, 233 MB",
    )
    ledger_mb_warn: float = setting(
        "Size of the ledger past which a run says so once; the ledger is never cut",
        "1..1e6 MB",
        256.0,
        "32,000 decisions of 8 kB: three weeks with one a minute",
    )
