"""What a configuration says of a controller that is not ours, read: its numbers, its description, its limits."""

from typing import TYPE_CHECKING

from retuner.config.foreign import NO_READ_BACK, CanOpenDeviceConfig, DbcDeviceConfig
from retuner.config.model import Config
from retuner.drivers.bus.link_settings import FramePort
from retuner.drivers.controller.device_process import BusDevice
from retuner.drivers.controller.virtual_device import VirtualDeviceSettings
from retuner.drivers.dbc.dbc_access import DbcAccess
from retuner.drivers.dbc.dbc_file import DbcFile, read_dbc_file
from retuner.drivers.dbc.dbc_virtual_device import VirtualDbcDevice
from retuner.drivers.plants.plant import Plant
from retuner.drivers.plants.shared_plant import PlantPort
from retuner.drivers.profiles.bench_loop import BenchLoop
from retuner.drivers.profiles.controller_access import Access, ProfileError
from retuner.drivers.profiles.foreign_device import ForeignDevice, ForeignSettings
from retuner.drivers.profiles.mapping import DeviceMapping
from retuner.drivers.profiles.ready import described_by
from retuner.drivers.recorded.sample_note import note_id
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.schedule.table import GainTable
from retuner.schedule.vendor_units import VendorUnits

if TYPE_CHECKING:
    from retuner.drivers.canopen.eds_file import EdsFile

SILENT_SAMPLES, SILENT_FLOOR_S = 6.0, 0.5
REPLY_SAMPLES, REPLY_FLOOR_S = 3.0, 0.3
CONNECT_SAMPLES, CONNECT_FLOOR_S = 20.0, 5.0
NEVER_S = 1e9

Foreign = DbcDeviceConfig | CanOpenDeviceConfig
CLOSED = (
    "its gains cannot be read back, so nothing is written (advice only); "
    f'accept that by name: [device] accept = ["{NO_READ_BACK}"]'
)

OUT_OF_REACH = (
    "its description has no gains, so nothing is written (advice only); set them by hand, at the device and in the "
    "region"
)


def make_access(config: Config, foreign: Foreign) -> Access:
    """The numbers of a foreign device, by its description.

    Raises ProfileError: the description cannot be used, or has not what the mapping names.
    """
    try:
        mapping = mapping_of(config, foreign)
        if isinstance(foreign, DbcDeviceConfig):
            return DbcAccess(dbc_file(config, foreign), mapping)
        try:
            from retuner.drivers.canopen.canopen_access import CanOpenAccess, NodeSettings  # noqa: PLC0415  an extra
        except ModuleNotFoundError as missing:
            raise ProfileError(f'needs {missing.name}: pip install "retuner[canopen]"', ("kind",)) from None
        settings = NodeSettings(foreign.start, foreign.heartbeat_s, foreign.own_node)
        return CanOpenAccess(eds_file(config, foreign), mapping, settings)
    except ProfileError as error:
        match error.key:
            case ("gains", "ki" | "tn" | "repeats" | "kd" | "tv" as gain, "object" | "message" | "signal"):
                remedy = f"; if the device has no such gain: {gain} = false under [device.gains]"
                raise ProfileError(f"{error}{remedy}", error.key) from None
        raise


def vendor_units(config: Config) -> VendorUnits | None:
    """How the device keeps gains; None for one that keeps them as they are. Errors as make_access."""
    foreign = config.foreign_device
    return None if foreign is None else make_access(config, foreign).units


def advice_only(config: Config) -> str:
    """Why gains are never written to the configured device; empty when they are."""
    foreign = config.foreign_device
    if foreign is None:
        return ""
    if foreign.gains is None:
        return OUT_OF_REACH
    reads_back = all(gain.read is not None for gain in foreign.gains.gains())
    return "" if reads_back or NO_READ_BACK in foreign.accept else CLOSED


def held_table(config: Config) -> GainTable:
    """The gain table as commissioned, as the device holds it.

    Raises ProfileError: it cannot hold one of the sets; otherwise as make_access.
    """
    table, units = config.gain_table(), vendor_units(config)
    if units is None:
        return table
    held = []
    for i, gains in enumerate(table.gains):
        try:
            held.append(units.rounded(gains))
        except ValueError as error:
            name = table.regions.names[i]
            raise ProfileError(f"the device cannot hold the gains of region {name}: {error}", ("gains",)) from None
    return GainTable(table.loop, table.regions, tuple(held), table.lookup)


def mapping_of(config: Config, foreign: Foreign) -> DeviceMapping:
    """What of the device is what."""
    loop = config.loop
    return foreign.mapping(loop.pv_max - loop.pv_min, loop.co_max_pct - loop.co_min_pct, config.gains()[0])


def eds_file(config: Config, foreign: CanOpenDeviceConfig) -> "EdsFile":
    """The device's EDS, for its node."""
    from retuner.drivers.canopen.eds_file import EdsFile, read_eds  # noqa: PLC0415  an extra

    path, node = described_by(foreign.eds), config.node
    return EdsFile(read_eds(path, node), path.name, node)


def dbc_file(config: Config, foreign: DbcDeviceConfig) -> DbcFile:
    """The device's DBC, moved to its node."""
    path = described_by(foreign.dbc)
    return DbcFile(read_dbc_file(path), path.name, config.node, foreign.described_node, foreign.node_shift)


def foreign_settings(
    config: Config, foreign: Foreign, inputs: ScheduleInputs, speed: float, after_s: float | None = None
) -> ForeignSettings:
    """How to treat a foreign device. inputs : of the schedule. speed, after_s : as make_device."""
    sample = config.loop.sample_time_s
    return ForeignSettings(
        gains=config.gains()[0],
        where=f"node {config.node} on {config.bus.interface} {config.bus.channel}",
        sample_time_s=sample,
        variable=inputs,
        co_min=config.loop.co_min_pct,
        co_max=config.loop.co_max_pct,
        sp_start=foreign.sp_start,
        reply_s=max(REPLY_SAMPLES * sample, REPLY_FLOOR_S * speed),
        silent_s=max(foreign.silent_s or 0.0, SILENT_SAMPLES * sample, SILENT_FLOOR_S * speed),
        connect_s=max(CONNECT_SAMPLES * sample, CONNECT_FLOOR_S * speed),
        feed_s=foreign.feed_s * speed or NEVER_S,
        look_s=foreign.look_s,
        closed=advice_only(config),
        bench_node=config.node if foreign.plant is not None else None,
        after_s=after_s,
        note_id=note_id(config.loop.name),
    )


def host_side(
    config: Config, link: FramePort, inputs: ScheduleInputs, speed: float, after_s: float | None
) -> ForeignDevice:
    """The host's side of the configured device on an open link. Errors as make_access.

    inputs : of the schedule. speed : of the far side's clock. after_s : time of an earlier session's newest sample.
    """
    foreign = config.foreign_device
    assert foreign is not None
    return ForeignDevice(link, make_access(config, foreign), foreign_settings(config, foreign, inputs, speed, after_s))


def far_side(config: Config, settings: VirtualDeviceSettings, plant: Plant) -> BusDevice:
    """The virtual device of this kind, on its plant. Errors as make_access."""
    foreign = config.foreign_device
    assert foreign is not None
    loop = BenchLoop(settings, plant)
    if isinstance(plant, PlantPort):
        plant.held_by = loop
    mapping = mapping_of(config, foreign)
    if isinstance(foreign, DbcDeviceConfig):
        return VirtualDbcDevice(dbc_file(config, foreign), mapping, loop, config.node)
    from retuner.drivers.canopen.virtual_node import VirtualCanOpenNode  # noqa: PLC0415  an extra

    return VirtualCanOpenNode(eds_file(config, foreign), mapping, loop)
