"""retuner device: the virtual controller as a process of its own on a bus."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from retuner.commands.init import starter
from retuner.commands.options import Channel, Interface, on_bus
from retuner.errors import UserError

if TYPE_CHECKING:  # slow to load, and `--help` needs none of it
    from retuner.config.model import Config

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner device examples/oven.toml -i udp_multicast -c 239.74.163.2 --speed 50")
def device(
    path: Annotated[Path | None, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).")] = None,
    interface: Interface = None,
    channel: Channel = None,
    speed: Annotated[float, typer.Option(help="How much faster than real time the simulated plant runs.")] = 1.0,
    profile: Annotated[
        str,
        typer.Option(help="In place of a configuration: a virtual odrive, cia402 or cia404."),
    ] = "",
    duration: Annotated[float | None, typer.Option(help="Stop after so many simulated seconds.")] = None,
) -> int:
    """Be the controller: PID firmware with its simulated plant on a CAN bus, until stopped."""
    config = on_bus(_read(path, profile), interface, channel)
    if not 0 < speed < float("inf"):
        raise UserError(f"--speed {speed}: give a positive number, 1 for real time")
    if duration is not None and not 0 < duration < float("inf"):
        raise UserError(f"--duration {duration}: give a positive number of seconds, or leave it out")
    if config.bus.interface == "virtual":
        raise UserError(
            "bus.interface = virtual reaches no other process: give --interface udp_multicast --channel 239.74.163.2, "
            "or socketcan and its interface; `retuner run` needs no device for virtual"
        )
    _be(config, speed, duration or float("inf"))
    return 0


def _read(path: Path | None, profile: str) -> "Config":
    """The configuration of the file, or of a profile's example."""
    from retuner.config.loading import load_config, parse_config  # noqa: PLC0415  see above

    if (path is None) == (not profile):
        raise UserError("give a configuration file, or --profile odrive, cia402 or cia404: one of them")
    return load_config(path) if path is not None else parse_config(starter(profile))


def _be(config: "Config", speed: float, until_s: float) -> None:
    """The controller on its bus, until its time is over or somebody stops it."""
    from retuner.drivers.bus.bus import CanLink  # noqa: PLC0415  see above
    from retuner.drivers.clock import MonotonicClock  # noqa: PLC0415
    from retuner.drivers.controller.device_process import DeviceOnBus, fresh_epoch, run_device  # noqa: PLC0415
    from retuner.session.assembly import link_settings  # noqa: PLC0415
    from retuner.session.devices import make_far_side  # noqa: PLC0415
    from retuner.stopping import stoppable  # noqa: PLC0415

    machine = make_far_side(config, fresh_epoch())
    clock = MonotonicClock(speed)
    with CanLink(link_settings(config, speed), clock) as link:
        on_bus = DeviceOnBus(machine, link)
        sys.stderr.write(
            f"{config.loop.name}: node {config.bus.node} on {config.bus.interface} {config.bus.channel}, "
            f"{speed:g} times real time; Ctrl-C ends it\n"
        )
        sys.stderr.flush()
        try:
            with stoppable():
                report = run_device(on_bus, clock, until_s=until_s)
        except KeyboardInterrupt:
            sys.stderr.write(f"{on_bus.samples} samples\n")
            raise
    sys.stderr.write(f"{report.samples} samples, {report.overruns} overruns\n")
