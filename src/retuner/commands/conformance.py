"""retuner conformance: play host and stranger to a device on a bus, and tell what it does wrong."""

import json
import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import Json
from retuner.errors import UserError

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner conformance -i socketcan -c can0")
def conformance(
    interface: Annotated[str, typer.Option("--interface", "-i", help="python-can interface.")],
    channel: Annotated[str, typer.Option("--channel", "-c", help="Channel of the interface.")],
    node: Annotated[
        int | None, typer.Option(help="Number of the device; else the one that is heard.", min=1, max=63)
    ] = None,
    sample_time: Annotated[float | None, typer.Option(help="Seconds between its samples; else it is asked.")] = None,
    speed: Annotated[float, typer.Option(help="How much faster than real time a simulated device runs.")] = 1.0,
    key_file: Annotated[Path | None, typer.Option(help="Key that authenticates commits.")] = None,
    trial_samples: Annotated[
        int, typer.Option(help="Its trial time, to test the return of gains that are not confirmed.", min=0, max=65535)
    ] = 0,
    restart: Annotated[bool, typer.Option("--restart", help="Test a power cycle too (you switch it).")] = False,
    as_json: Json = False,
) -> int:
    """Test a device on a bus against every chapter of docs/developers/protocol.md, faults included.

    Its gains are changed by a few per cent, stored, and restored at the end: use it on no process that matters.
    """
    for name, value in (("--sample-time", sample_time), ("--speed", speed)):
        if value is not None and not 0 < value < math.inf:
            raise UserError(f"{name} {value}: give a positive number")
    from retuner.drivers.bus.bus import CanLink, LinkSettings
    from retuner.drivers.clock import MonotonicClock
    from retuner.drivers.conformance.chapters import chapters, nodes_heard, sample_time_of
    from retuner.drivers.conformance.conversation import Conversation, NoAnswerError, OnBus
    from retuner.drivers.conformance.examination import examine
    from retuner.drivers.host.key_file import read_key

    clock, place = MonotonicClock(), f"{interface} {channel}"
    key = None if key_file is None else read_key(key_file)
    with CanLink(LinkSettings(interface=interface, channel=channel), clock) as link:
        node = _the_node(nodes_heard(link, clock), place) if node is None else node
        there = f"node {node} on {place}"
        sample_s = sample_time or sample_time_of(link, clock, node)
        if not sample_s:
            raise UserError(f"{there}: no Identity; is it there, and its number right?")

        def power_cycle() -> bool:
            if not restart:
                return False
            sys.stderr.write("switch the device off and on, then press Enter\n")
            sys.stderr.flush()
            done = sys.stdin.readline() != ""
            link.wait_until(clock.now_s() + 1.0)
            return done

        far = OnBus(link, clock, node, sample_s / speed, power_cycle)
        try:
            found = examine(Conversation(far, node, key), chapters(trial_samples))
        except NoAnswerError as error:
            raise UserError(f"{there}: {error}; is it there, and its number right?") from None
    if as_json:
        findings = [{"chapter": one.chapter, "said": one.said} for one in found.findings]
        document = {"tried": found.tried, "findings": findings, "left_out": found.left_out}
        sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")
    else:
        lines = [f"{one.chapter}: {one.said}" for one in found.findings]
        lines += [f"not tried: {one}" for one in found.left_out]
        verdict = f"{len(found.findings)} of {found.tried} answers are not those of docs/developers/protocol.md"
        sys.stdout.write("\n".join([*lines, verdict if found.findings else f"{found.tried} answers, all right"]) + "\n")
    return int(bool(found.findings))


def _the_node(heard: list[int], place: str) -> int:
    if len(heard) == 1:
        sys.stderr.write(f"node {heard[0]} found\n")
        return heard[0]
    if heard:
        raise UserError(f"{place}: nodes {', '.join(map(str, heard))} send samples; name one by --node")
    raise UserError(f"{place}: no device sends whole samples; is one there? Name it by --node if it sends none")
