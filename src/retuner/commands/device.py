"""retuner device: the virtual controller as a process of its own on a bus."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import Channel, Interface, Loop, all_on_bus
from retuner.errors import UserError, one_line
from retuner.templates import starter

app = typer.Typer(add_completion=False)

MANY_OVERRUNS = 0.02  # overruns for each sample from which it is said that the machine is too slow


@app.command(epilog="Example: retuner device examples/oven.toml -i udp_multicast -c 239.74.163.2 --speed 50")
def device(
    path: Annotated[Path | None, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).")] = None,
    interface: Interface = None,
    channel: Channel = None,
    speed: Annotated[float, typer.Option(help="How much faster than real time the simulated plant runs.")] = 1.0,
    profile: Annotated[str, typer.Option(help="In place of a configuration: a virtual odrive, cia402 or cia404.")] = "",
    duration: Annotated[float | None, typer.Option(help="Stop after so many simulated seconds.")] = None,
    loop: Loop = None,
) -> int:
    """Run a virtual controller with a simulated plant on a CAN bus, until stopped; of several loops, all."""
    from retuner.config.loading import load_session, parse_session
    from retuner.config.session_config import SessionConfig
    from retuner.drivers.clock import MonotonicClock
    from retuner.drivers.controller.device_process import fresh_epoch, run_devices
    from retuner.session.bench_or_buses import far_ends
    from retuner.stopping import stoppable

    if (path is None) == (not profile):
        raise UserError("give a configuration file, or --profile odrive, cia402 or cia404: one of them")
    session = all_on_bus(
        load_session(path)[0] if path is not None else parse_session(starter(profile)), interface, channel
    )
    configs = session.loops if loop is None else (session.loops[session.place(loop)],)
    if not 0 < speed < float("inf"):
        raise UserError(f"--speed {speed}: give a positive number, 1 for real time")
    if duration is not None and not 0 < duration < float("inf"):
        raise UserError(f"--duration {duration}: give a positive number of seconds, or leave it out")
    if configs[0].bus.interface == "virtual":
        raise UserError(
            "bus.interface = virtual reaches no other process: give --interface udp_multicast --channel 239.74.163.2, "
            "or socketcan and its interface; `retuner run` needs no device for virtual"
        )
    until_s, clock = duration or float("inf"), MonotonicClock(speed)
    with far_ends(SessionConfig(configs, session.several), speed, clock, fresh_epoch, _say) as devices:
        for config in configs:
            at = f"node {config.node} on {config.bus.interface} {config.bus.channel}"
            _say(f"{config.loop.name}: {at}, {speed:g} times real time; Ctrl-C ends it")
        stopped: KeyboardInterrupt | None = None
        try:
            with stoppable():
                run_devices(devices, clock, until_s=until_s)
        except KeyboardInterrupt as stop:
            stopped = stop
        samples, overruns = sum(one.samples for one in devices), sum(one.overruns for one in devices)
        slow = f": this machine is too slow for --speed {speed:g}" * (overruns > MANY_OVERRUNS * samples)
        _say(f"{samples} samples, {overruns} overruns{slow}")
    if stopped is not None:
        raise stopped
    return 0


def _say(text: str) -> None:
    sys.stderr.write(f"{one_line(text)}\n")
    sys.stderr.flush()
