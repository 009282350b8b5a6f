"""retuner doctor: what works on this machine, and what to do about the rest. Each check does the thing itself.

No frame is sent on a bus that a controller may hang on: SocketCAN interfaces are opened, listened to and closed.
"""

import json
import logging
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from retuner.commands.options import Json
from retuner.errors import UserError
from retuner.schedule.late_dataclass import asdict, dataclass

NETWORK = Path("/sys/class/net")
ARPHRD_CAN = "280"  # linux/if_arp.h
GROUP = "239.74.163.9"  # of the organisation-local block, as python-can's default is; nothing else here uses it
LATE_MS = 5.0  # A timer later than this in a quarter of a second disturbs loops at 100 Hz
TIMER_TRIES = 50
FRAME_ID, PAYLOAD = 0x123, b"doctor"
WAIT_S = 1.0


class Level(StrEnum):
    """How a check ended."""

    OK = "ok"
    OPTIONAL = "not there"  # retuner works without it
    BROKEN = "broken"  # something of the base does not work


@dataclass(frozen=True, slots=True)
class MachineFinding:
    """What was found of one thing. what : in a line. remedy : what to do, empty where nothing is to be done."""

    name: str
    level: Level
    what: str
    remedy: str = ""

    def to_dict(self) -> dict[str, str]:
        """Keys name, level, what, remedy."""
        return asdict(self)


def findings(folder: Path, *, adapters: bool = False) -> Iterator[MachineFinding]:
    """Every check, one after another.

    folder : where sessions are going to be kept. adapters : ask the drivers of CAN adapters too, which takes seconds
        and wakes hardware.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    where = f"{platform.python_implementation()} {platform.python_version()} on {platform.system()}"
    yield MachineFinding("Python", Level.OK, f"{where}, {platform.machine()}, {cores} cores")
    # our own version, and every package of the base install at a version that is enough
    if wrong := [text for text in map(_shortfall, _required(None)) if text]:
        yield MachineFinding("retuner", Level.BROKEN, "; ".join(wrong), "pip install --upgrade retuner")
    else:
        yield MachineFinding("retuner", Level.OK, f"version {version('retuner')}; all its packages are installed")
    yield _engine()
    from importlib.metadata import metadata

    for extra in metadata("retuner").get_all("Provides-Extra") or ():
        needed = _required(extra)
        if not needed:  # names other extras
            continue
        wrong = [text for text in map(_shortfall, needed) if text]
        if wrong:
            yield MachineFinding(f"extra {extra}", Level.OPTIONAL, "; ".join(wrong), f'pip install "retuner[{extra}]"')
        else:
            yield MachineFinding(f"extra {extra}", Level.OK, ", ".join(needed))
    yield _checked(
        "virtual bus",
        lambda: _there_and_back("virtual", "retuner-doctor", {}),
        'python-can is damaged; install it again: pip install --force-reinstall "python-can>=4.6"',
    )
    yield _multicast()
    yield from _socketcan()
    if adapters:
        yield _adapters()
    # A ledger in the folder where sessions are kept: rows on disk, locked for one writer
    from retuner.ledger import Ledger

    def written() -> str:
        with TemporaryDirectory(prefix=".retuner-doctor-", dir=folder) as inside:
            path = Path(inside) / "ledger.sqlite"
            begun_s = time.perf_counter()
            with Ledger(path) as ledger:
                ledger.append("doctor", {"writes": "here"}, 0.0)
                if not ledger.verify().ok:
                    raise OSError("a row was written and reads back differently")
            return f"a ledger can be kept here; opened and written in {(time.perf_counter() - begun_s) * 1e3:.0f} ms"

    remedy = "give a folder on a local disk that you may write to: retuner doctor --folder PATH, retuner run --out PATH"
    yield _checked(f"folder {folder}", written, remedy)
    yield _timer()
    yield _terminal()


def _required(extra: str | None) -> list[str]:
    from packaging.requirements import Requirement

    found = []
    for text in requires("retuner") or ():
        one = Requirement(text)
        base = one.marker is None or one.marker.evaluate({"extra": ""})
        wanted = (
            base if extra is None else not base and one.marker is not None and one.marker.evaluate({"extra": extra})
        )
        if wanted and one.name != "retuner":
            found.append(f"{one.name}{one.specifier}")
    return found


def _shortfall(requirement: str) -> str:
    """What is wrong with a package; empty where it is there in a version that is enough."""
    from packaging.requirements import Requirement

    one = Requirement(requirement)
    try:
        there = version(one.name)
    except PackageNotFoundError:
        return f"{one.name} is not installed"
    return (
        ""
        if one.specifier.contains(there, prereleases=True)
        else f"{one.name} {there} is there, {one.specifier} is needed"
    )


def _engine() -> MachineFinding:
    from retuner.adaptive.fit.engine import compiled, engine_name

    try:
        if compiled() is not None:
            return MachineFinding("engine of fits", Level.OK, f"compiled, {engine_name()}")
    except ValueError as error:  # the variable of the environment
        return MachineFinding("engine of fits", Level.BROKEN, str(error), "take the variable away")
    remedy = (
        "install a C compiler and Python's headers, then: pip install --force-reinstall --no-binary retuner retuner"
    )
    return MachineFinding(
        "engine of fits", Level.OPTIONAL, f"{engine_name()}: many times slower than the compiled one", remedy
    )


def _checked(name: str, check: Callable[[], str], remedy: str) -> MachineFinding:
    from retuner.drivers.device import DeviceError

    try:
        return MachineFinding(name, Level.OK, check())
    except (OSError, ValueError, UserError, DeviceError) as error:
        return MachineFinding(name, Level.BROKEN, getattr(error, "strerror", None) or str(error), remedy)


def _there_and_back(interface: str, channel: str, options: dict[str, object]) -> str:
    import can

    from retuner.drivers.bus.bus_opening import open_bus

    with open_bus(interface, channel, 0, options) as one, open_bus(interface, channel, 0, options) as other:
        one.send(can.Message(arbitration_id=FRAME_ID, data=PAYLOAD, is_extended_id=False))
        until_s = time.monotonic() + WAIT_S
        while time.monotonic() < until_s:
            came = other.recv(timeout=WAIT_S)
            if came is not None and bytes(came.data) == PAYLOAD:
                return "a frame went over it"
    raise OSError(f"a frame was sent and did not arrive within {WAIT_S:g} s")


def _multicast() -> MachineFinding:
    from retuner.drivers.device import DeviceError

    name = "udp_multicast"
    try:
        return MachineFinding(name, Level.OK, _there_and_back(name, GROUP, {}) + ", none left this machine")
    except DeviceError as error:  # a BusError, with what to do about it in its last part
        what, _, remedy = str(error).rpartition("; ")
        return MachineFinding(name, Level.OPTIONAL, what, remedy)
    except OSError as error:
        return MachineFinding(
            name, Level.OPTIONAL, str(error), "let the loopback interface carry multicast: ip link set lo multicast on"
        )


def _socketcan() -> Iterator[MachineFinding]:
    """Every CAN interface of the kernel, by listening only."""
    from retuner.drivers.bus.bus_opening import SOCKETCAN, open_bus
    from retuner.drivers.device import DeviceError

    names = sorted(path.parent.name for path in NETWORK.glob("*/type") if path.read_text("ascii").strip() == ARPHRD_CAN)
    if not names:
        if platform.system() != "Linux":
            yield MachineFinding(
                "SocketCAN", Level.OPTIONAL, "only Linux has it", "use --interface udp_multicast, or your adapter's"
            )
            return
        remedy = "modprobe vcan && ip link add dev vcan0 type vcan && ip link set vcan0 up; else use udp_multicast"
        yield MachineFinding("SocketCAN", Level.OPTIONAL, "the kernel shows no CAN interface", remedy)
    for name in names:
        what, remedy, level = "is up and can be opened", "", Level.OK
        if not (int((NETWORK / name / "flags").read_text("ascii"), 16) & 1):
            what, remedy, level = "is down", f"ip link set {name} up", Level.OPTIONAL
        else:
            try:
                open_bus(SOCKETCAN, name, 0, {}).shutdown()
            except (DeviceError, OSError) as error:
                what, remedy, level = str(error), "ask for the right to open it", Level.OPTIONAL
        yield MachineFinding(f"SocketCAN {name}", level, what, remedy)


def _adapters() -> MachineFinding:
    import can

    logging.disable(
        logging.CRITICAL
    )  # drivers that are not installed tell it on stderr, some of them by the root logger
    try:
        seen = can.detect_available_configs()
    finally:
        logging.disable(logging.NOTSET)
    own = ("virtual", "udp_multicast", "socketcan")
    found = [f"{one['interface']} {one['channel']}" for one in seen if one["interface"] not in own]
    if found:
        return MachineFinding("CAN adapters", Level.OK, ", ".join(found))
    remedy = "install the vendor's driver and python-can's package for it"
    return MachineFinding("CAN adapters", Level.OPTIONAL, "no driver of python-can finds one", remedy)


def _timer() -> MachineFinding:
    late_s = 0.0
    for _ in range(TIMER_TRIES):
        asleep_s = time.perf_counter()
        time.sleep(0.005)
        late_s = max(late_s, time.perf_counter() - asleep_s - 0.005)
    what = f"wakes up at most {late_s * 1e3:.1f} ms late, in {TIMER_TRIES} tries"
    if late_s * 1e3 <= LATE_MS:
        return MachineFinding("timer", Level.OK, what)
    remedy = f"fast enough for loops slower than {late_s * 10:.1f} s; for faster loops reduce the load on this machine"
    return MachineFinding("timer", Level.OPTIONAL, what, remedy)


def _terminal() -> MachineFinding:
    encoding = (sys.stdout.encoding or "").lower()
    colour = "without colour (NO_COLOR)" if os.environ.get("NO_COLOR") else "with colour on a terminal"
    if encoding.startswith("utf"):
        return MachineFinding("screen", Level.OK, f"{encoding}, {colour}")
    remedy = "set PYTHONIOENCODING=utf-8 for the signs of units and graphs; without it they are escaped"
    return MachineFinding("screen", Level.OPTIONAL, f"encoding {encoding or 'unknown'}, {colour}", remedy)


app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner doctor --folder runs")
def doctor(
    folder: Annotated[Path, typer.Option(help="Where sessions are going to be kept.")] = Path(),
    adapters: Annotated[bool, typer.Option("--adapters", help="Ask the drivers of CAN adapters too.")] = False,
    as_json: Json = False,
) -> int:
    """Try Python, packages, buses, engine, folder and screen: what works, and what to do about the rest.

    The exit status is 1 where something does not work that every session needs.
    """
    from retuner.verbosity import quiet

    if not folder.is_dir():
        raise UserError(f"--folder {folder}: there is no such folder; make it or name another")
    found = []
    for finding in findings(folder, adapters=adapters):
        found.append(finding)
        if not as_json and not (quiet() and finding.level == Level.OK):
            sys.stdout.write("".join(f"{line}\n" for line in lines(finding)))
            sys.stdout.flush()
    works = all(finding.level != Level.BROKEN for finding in found)
    if as_json:
        sys.stdout.write(json.dumps({"ok": works, "findings": [one.to_dict() for one in found]}, indent=2) + "\n")
    else:
        broken = [finding.name for finding in found if finding.level == Level.BROKEN]
        sys.stdout.write("retuner works here\n" if works else f"does not work here: {', '.join(broken)}\n")
    return 0 if works else 1


def lines(finding: MachineFinding) -> list[str]:
    """A finding for a person."""
    told = [f"{finding.level:<11}{finding.name}: {finding.what}"]
    return [*told, f"{'':<11}  to do: {finding.remedy}"] if finding.remedy else told
