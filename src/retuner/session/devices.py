"""Which device a configuration means: the one place where the host's side of it, and a virtual one, are made."""

from dataclasses import replace

from retuner.config import Config
from retuner.config.described import Foreign, closed, dbc_file, eds_file, make_access, mapping_of, node_of
from retuner.config.foreign import UNPROVED_ORDER, DbcDeviceConfig
from retuner.decisions.order_of_writes import OrderOfWrites
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.controller.device_process import BusDevice
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.dbc.virtual_device import VirtualDbcDevice
from retuner.drivers.device import Device
from retuner.drivers.host.connection import CanDevice
from retuner.drivers.profiles.access import Access
from retuner.drivers.profiles.bench_loop import BenchLoop
from retuner.drivers.profiles.foreign_device import ForeignDevice
from retuner.drivers.profiles.foreign_settings import ForeignSettings
from retuner.ledger import Recorder
from retuner.session.assembly import device_settings, make_plant, schedule_inputs, virtual_device_settings
from retuner.session.session import Session

SILENT_SAMPLES, SILENT_FLOOR_S = 6.0, 0.5
REPLY_SAMPLES, REPLY_FLOOR_S = 3.0, 0.3
CONNECT_SAMPLES, CONNECT_FLOOR_S = 20.0, 5.0
NEVER_S = 1e9


def make_device(
    config: Config, link: CanLink, speed: float = 1.0, *, after_s: float | None = None, owner: int | None = None
) -> CanDevice | ForeignDevice:
    """The host's side of the configured device on an open link.

    speed : of the far side's clock. after_s : time of the newest sample of an earlier session. owner : number in the
    lease, where there is one; absent: as configured.

    Raises
    ------
    ProfileError
        A foreign device's description cannot be used.
    """
    foreign = config.foreign_device
    if foreign is None:
        settings = device_settings(config, speed)
        return CanDevice(link, settings if owner is None else replace(settings, owner=owner), after_s)
    access = make_access(config, foreign)
    return ForeignDevice(link, access, foreign_settings(config, foreign, access, speed, after_s))


def make_far_side(config: Config, epoch: int = 1) -> BusDevice:
    """The virtual device that the configuration describes.

    Raises
    ------
    UserError
        The configuration has no plant for it.
    ProfileError
        A foreign device's description cannot be used.
    """
    foreign = config.foreign_device
    if foreign is None:
        return VirtualDevice(virtual_device_settings(config), make_plant(config), epoch=epoch)
    loop = BenchLoop(virtual_device_settings(config), make_plant(config))
    mapping = mapping_of(config, foreign)
    if isinstance(foreign, DbcDeviceConfig):
        return VirtualDbcDevice(dbc_file(config, foreign), mapping, loop, node_of(config, foreign))
    from retuner.drivers.canopen.virtual_node import VirtualCanOpenNode  # noqa: PLC0415  an extra

    return VirtualCanOpenNode(eds_file(config, foreign), mapping, loop)


def prove_order(config: Config, device: Device, session: Session, record: Recorder) -> None:
    """Have a device that takes a set in several messages ask the session's retuner for their order."""
    foreign, units = config.foreign_device, session.retuner.settings.units
    if foreign is not None and units is not None and isinstance(device, ForeignDevice):
        accepted = UNPROVED_ORDER in foreign.accept
        device.choose_way = OrderOfWrites(session.retuner, units, record, lambda: session.writer.t_s, unproved=accepted)


def foreign_settings(
    config: Config, foreign: Foreign, access: Access, speed: float, after_s: float | None = None
) -> ForeignSettings:
    """How to treat a foreign device."""
    sample = config.loop.sample_time_s
    floor_s = SILENT_FLOOR_S * speed
    return ForeignSettings(
        gains=config.gains()[0],
        where=f"node {node_of(config, foreign)} on {config.bus.interface} {config.bus.channel}",
        sample_time_s=sample,
        variable=schedule_inputs(config),
        co_min=config.loop.co_min_pct,
        co_max=config.loop.co_max_pct,
        sp_start=foreign.sp_start,
        reply_s=max(REPLY_SAMPLES * sample, REPLY_FLOOR_S * speed),
        silent_s=max(foreign.silent_s or 0.0, SILENT_SAMPLES * sample, floor_s),
        connect_s=max(CONNECT_SAMPLES * sample, CONNECT_FLOOR_S * speed),
        feed_s=foreign.feed_s * speed or NEVER_S,
        look_s=foreign.look_s,
        closed=closed(foreign, access),
        bench_node=node_of(config, foreign) if foreign.plant is not None else None,
        after_s=after_s,
    )
