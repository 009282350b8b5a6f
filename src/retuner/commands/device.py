"""retuner device: the virtual controller as a process of its own on a bus."""

import sys
from pathlib import Path

from retuner.commands.run import RunOptions, overridden
from retuner.config import load_config
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import MonotonicClock
from retuner.drivers.controller.device_process import DeviceOnBus, fresh_epoch, run_device
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.errors import UserError
from retuner.session.assembly import link_settings, make_plant, virtual_device_settings
from retuner.stopping import stoppable


def device(path: Path, *, interface: str | None, channel: str | None, speed: float, duration_s: float | None) -> int:
    """Run the virtual device of a configuration until it is stopped; the exit status.

    Raises
    ------
    ConfigError, UserError, DeviceError
        The configuration, an option or the bus cannot be used.
    """
    config = overridden(load_config(path), RunOptions(interface, channel))
    if not 0 < speed < float("inf"):
        raise UserError(f"--speed {speed}: give a positive number, 1 for real time")
    if duration_s is not None and not 0 < duration_s < float("inf"):
        raise UserError(f"--duration {duration_s}: give a positive number of seconds, or leave it out")
    if config.bus.interface == "virtual":
        raise UserError(
            "bus.interface = virtual reaches no other process: give --interface udp_multicast --channel 239.74.163.2, "
            "or socketcan and its interface; `retuner run` needs no device for virtual"
        )
    machine = VirtualDevice(virtual_device_settings(config), make_plant(config), epoch=fresh_epoch())
    clock = MonotonicClock(speed)
    with CanLink(link_settings(config, speed), clock) as link:
        sys.stderr.write(
            f"{config.loop.name}: node {config.bus.node} on {config.bus.interface} {config.bus.channel}, "
            f"{speed:g} times real time; Ctrl-C ends it\n"
        )
        sys.stderr.flush()
        try:
            with stoppable():
                report = run_device(DeviceOnBus(machine, link), clock, until_s=duration_s or float("inf"))
        except KeyboardInterrupt:
            sys.stderr.write(f"{machine.sample} samples\n")
            raise
    sys.stderr.write(f"{report.samples} samples, {report.overruns} overruns\n")
    return 0
