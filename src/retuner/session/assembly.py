"""From the configuration to the objects of the rooms, each made in one place."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.request import Locks
from retuner.adaptive.guard.step_size import change_factor
from retuner.adaptive.supervision.admission import AdmissionSettings
from retuner.adaptive.supervision.decision import Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings, demanded
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.adaptive.without_model.pattern_rule import PatternSettings
from retuner.adaptive.without_model.proposal_without_model import WithoutModelSettings
from retuner.config import Config
from retuner.config.loading import signal_source
from retuner.config.section import held_by
from retuner.drivers.bus.bus import LinkSettings
from retuner.drivers.bus.link_settings import FramePort
from retuner.drivers.controller.device_process import BusDevice
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings, fresh_owner
from retuner.drivers.host.key_file import read_key
from retuner.drivers.plants.plant import Plant
from retuner.drivers.plants.shared_plant import PlantPort
from retuner.drivers.protocol.frames import GainBox
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.products import product

if TYPE_CHECKING:
    from retuner.drivers.profiles.foreign_device import ForeignDevice

REGION_ROOM = 4.0
"""The device takes steps this much larger than those between the commissioned regions: regions get retuned."""


def _of_foreign(config: Config, name: str) -> Any:  # noqa: ANN401  as the function of that name
    """What the description of a foreign device says; None for a controller of our own."""
    return None if config.foreign_device is None else getattr(product("foreign device"), name)(config)


def guard_settings(config: Config) -> GuardSettings:
    """The guard's limits: those of [adaptation] and of [adaptation.limits]; what is absent is no limit."""
    a = config.adaptation
    return GuardSettings(**held_by(a, GuardSettings), **held_by(a.limits, GuardSettings))


def locks(names: Sequence[str]) -> Locks:
    """Parameters that stay as they are, by name."""
    return Locks(kc="kc" in names, tau_i="tau_i" in names, tau_d="tau_d" in names)


def retuner_settings(config: Config, mode: Mode | None = None) -> RetunerSettings:
    """The retuner's settings; mode overrides the configured one. A device that is only watched is only advised on."""
    a, loop = config.adaptation, config.loop
    if _of_foreign(config, "advice_only"):
        mode = min(mode or Mode(config.adaptation.mode), Mode.ADVISE, key=list(Mode).index)
    # what may be done where no process can be identified: [adaptation.pattern]
    pattern = config.adaptation.pattern
    settings = RetunerSettings(
        sample_time_s=loop.sample_time_s,
        pv_span=loop.pv_max - loop.pv_min,
        pv_range=(loop.pv_min, loop.pv_max),
        mode=mode or Mode(a.mode),
        region_modes=region_modes(config, mode),
        band=a.noise_band,
        wait_s=a.wait_s,
        setpoint_weight=loop.b,
        filter_s=loop.tau_f_s,
        trial=TrialSettings(**held_by(a, TrialSettings, "trial_")),
        guard=guard_settings(config),
        locks=locks(a.locked),
        region_locks=tuple(
            None if region.locked is None else locks(region.locked) for region in config.schedule.regions
        ),
        admission=AdmissionSettings(**a.admission.model_dump()),
        without_model=WithoutModelSettings(
            PatternSettings(**pattern.model_dump(exclude={"allowed"})), allowed=pattern.allowed
        ),
        units=_of_foreign(config, "vendor_units"),
    )
    return demanded(settings)


def region_modes(config: Config, mode: Mode | None = None) -> tuple[Mode | None, ...]:
    """What may be done in single regions; a mode given for the run is the most that any region may do."""
    own = tuple(None if region.mode is None else Mode(region.mode) for region in config.schedule.regions)
    if mode is None:
        return own
    rising = list(Mode)
    return tuple(None if region is None else min(region, mode, key=rising.index) for region in own)


def make_retuner(config: Config, mode: Mode | None = None) -> Retuner:
    """A retuner that knows nothing yet, on the table as commissioned."""
    return Retuner(_of_foreign(config, "held_table") or config.gain_table(), retuner_settings(config, mode))


def virtual_device_settings(config: Config) -> VirtualDeviceSettings:
    """The virtual device's firmware; it starts on the gains of the region in which the plant starts."""
    loop, table = config.loop, config.gain_table()
    # limits that the virtual device's maker would certify: changing from any region to any other is one write
    steps = [change_factor(a, b) for a in table.gains for b in table.gains]
    widest = max((step for step in steps if math.isfinite(step)), default=1.0)
    return VirtualDeviceSettings(
        gains=table.gains[0],
        node=config.bus.node,
        sample_time_s=loop.sample_time_s,
        box=GainBox(ratio_max=max(GainBox().ratio_max, REGION_ROOM * widest), direction=table.gains[0].direction),
        sp_min=loop.pv_min,
        sp_max=loop.pv_max,
        co_min=loop.co_min_pct,
        co_max=loop.co_max_pct,
        co_rate_per_s=loop.co_rate_pct_per_s,
        b=loop.b,
        tau_f_s=loop.tau_f_s,
        trial_samples=round(config.confirm_within_s / loop.sample_time_s),
        key=commit_key(config),
    )


def schedule_inputs(config: Config) -> ScheduleInputs:
    """What the scheduling variables are, and where on the bus those come from that are other signals there.

    Raises DbcError: a DBC has not what the configuration names (loading a configuration from a file says so first, by
    line and key).
    """
    axes, node = config.schedule.axes, config.bus.node
    signals = [signal_source(axis, node) for axis in axes]
    names = [str(axis.variable) for axis in axes]
    return ScheduleInputs(names[0], names[1] if len(names) > 1 else "", tuple(signals))


def commit_key(config: Config) -> bytes | None:
    """The key that commits are authenticated with; None without one.

    Raises KeyFileError: the configured file cannot be used.
    """
    return read_key(Path(config.bus.key_file)) if config.bus.key_file else None


def link_settings(config: Config, speed: float = 1.0) -> LinkSettings:
    """How to open the bus; patience is in the far side's seconds."""
    bus = config.bus
    return LinkSettings(
        bus.interface,
        bus.channel,
        bus.hop_limit,
        silent_after_s=max(10.0 * speed, 10.0 * config.loop.sample_time_s),
        reopen_first_s=0.2 * speed,
        reopen_max_s=5.0 * speed,
        log_bytes_max=config.output.bus_log_mb * 1e6,
    )


def device_settings(config: Config, speed: float = 1.0) -> CanDeviceSettings:
    """The host's address book entry for the controller; floors are machine seconds, so they grow with speed.

    On a bus inside this process nobody else can be, and equal runs give equal bytes: the host is number 1 there.
    """
    standard = CanDeviceSettings()
    return replace(
        standard,
        node=config.bus.node,
        sample_time_s=config.loop.sample_time_s,
        variable=schedule_inputs(config),
        reply_floor_s=standard.reply_floor_s * speed,
        connect_floor_s=standard.connect_floor_s * speed,
        lease_floor_s=config.bus.lease_s * speed,
        probation_samples=config.bus.probation_samples,
        key=commit_key(config),
        owner=standard.owner if config.bus.interface == "virtual" else fresh_owner(),
    )


# Which device a configuration means: the one place where the host's side of it, and a virtual one, are made.


def make_device(
    config: Config, link: FramePort, speed: float = 1.0, *, after_s: float | None = None, owner: int | None = None
) -> "CanDevice | ForeignDevice":
    """The host's side of the configured device on an open link.

    speed : of the far side's clock. after_s : time of the newest sample of an earlier session. owner : number in the
    lease, where there is one; absent: as configured.

    Raises ProfileError: a foreign device's description cannot be used.
    """
    if config.foreign_device is None:
        settings = device_settings(config, speed)
        return CanDevice(link, settings if owner is None else replace(settings, owner=owner), after_s)
    made: ForeignDevice = product("foreign device").host_side(config, link, schedule_inputs(config), speed, after_s)
    return made


def make_far_side(config: Config, plant: Plant, epoch: int = 1) -> BusDevice:
    """The virtual device that the configuration describes, on its plant.

    Raises ProfileError: a foreign device's description cannot be used.
    """
    if config.foreign_device is None:
        device = VirtualDevice(virtual_device_settings(config), plant, epoch=epoch)
        if isinstance(plant, PlantPort):
            plant.held_by = device
        return device
    far: BusDevice = product("foreign device").far_side(config, virtual_device_settings(config), plant)
    return far
