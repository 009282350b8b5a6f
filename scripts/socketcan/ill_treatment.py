"""What is done to the bus between a device and a host, part by part: see faults.py."""

import contextlib
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import can
from bench import NODE, SAMPLE_S, Bench, sh

from retuner.drivers.bus.bus import SO_RCVBUFFORCE, LinkFault

IFACE = "vcan0"
BURST = 5000
SMALL_QUEUE = 100_000  # bytes; holds some 130 frames
COMMANDS = range(1, 26)  # of retuner.dbc; one by one they are corrupted or withheld
ERROR_CLASSES = {
    "bus-off": (0x40, 0),
    "error-passive": (0x04, 0x20),
    "no acknowledge": (0x20, 0),
    "overrun": (0x04, 0x01),
}


@contextlib.contextmanager
def bench(far: str = IFACE, near: str = IFACE, seed: int = 1) -> Iterator[Bench]:
    """A bench that is connected."""
    made = Bench(far, near, seed)
    try:
        made.run(10.0, made.well)
        yield made
    finally:
        made.close()


def times(count: int, share: float) -> range:
    """So many of them."""
    return range(max(round(count * share), 2))


MIXES = (
    "loss 10%",
    "duplicate 20%",
    "delay 30ms 20ms reorder 25%",
    "corrupt 10%",
    "loss 5% duplicate 5% delay 20ms 20ms corrupt 3%",
)


def percentile_99(values: list[float]) -> float:
    """Rounded."""
    return round(sorted(values)[min(len(values) - 1, int(0.99 * len(values)))], 3)


def outages(
    made: Bench, share: float, count: int, break_it: list[list[str]], mend: list[list[str]]
) -> dict[str, object]:
    """Break and mend the interface, often in the middle of a write."""
    recovered: list[float] = []
    noticed = 0
    for _ in times(count, share):
        made.order()
        made.run(made.rng.uniform(0.0, 0.2))
        before = made.told["link down"] + made.told["link silent"]
        for command in break_it:
            sh(*command)
        made.run(made.rng.uniform(0.1, 0.5))
        for command in mend:
            sh(*command)
        recovered.append(made.run(20.0, made.well))
        noticed += made.told["link down"] + made.told["link silent"] > before
    return {
        "outages": len(recovered),
        "noticed by the host": noticed,
        "recovery s, median": percentile_50(recovered),
        "recovery s, 99 %": percentile_99(recovered),
        **made.report(),
    }


def percentile_50(values: list[float]) -> float:
    """Rounded."""
    return round(sorted(values)[len(values) // 2], 3)


def updown(share: float, seed: int) -> dict[str, object]:
    """The interface goes down and comes up."""
    with bench(seed=seed) as made:
        return outages(made, share, 100, [["ip", "link", "set", IFACE, "down"]], [["ip", "link", "set", IFACE, "up"]])


def recreate(share: float, seed: int) -> dict[str, object]:
    """The interface is removed and made anew: the old socket is deaf for ever."""
    with bench(seed=seed) as made:
        make = [["ip", "link", "add", "dev", IFACE, "type", "vcan"], ["ip", "link", "set", IFACE, "up"]]
        return outages(made, share, 20, [["ip", "link", "del", IFACE]], make)


def overflow(share: float, seed: int) -> dict[str, object]:
    """A host that does not look for a while, on a queue of the usual length: what the kernel drops is counted."""
    with bench(seed=seed) as made, can.Bus(interface="socketcan", channel=IFACE) as other:
        sent = 0
        for _ in times(20, share):
            with socket.socket(fileno=_duplicate(made)) as queue:
                queue.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, SMALL_QUEUE)
            made.run(0.1)
            received, dropped = made.near.counters.received, made.near.counters.overflows
            for i in range(BURST):
                other.send(can.Message(arbitration_id=0x700 + i % 16, is_extended_id=False, data=[i % 256]))
            made.far.receive_all(limit=BURST)
            came = len(made.near.receive_all(limit=2 * BURST))
            counted = made.near.counters.overflows - dropped
            sent += BURST
            if came + counted != BURST:
                made.wrong.append(f"{BURST} sent, {came} received, {counted} counted as dropped")
            assert made.near.counters.received - received >= came
            made.order()
            made.run(20.0, made.well)
        return {"frames sent": sent, "dropped and counted": made.near.counters.overflows, **made.report()}


def _duplicate(made: Bench) -> int:
    """A handle on the host's socket."""
    return socket.dup(made.near._fileno())  # noqa: SLF001  to make its queue small


def clock(share: float, seed: int) -> dict[str, object]:
    """The wall clock is set an hour or a day forward and back while writes go on."""
    with bench(seed=seed) as made:
        honest = time.time() - time.monotonic()
        for i in times(20, share):
            jump = (3600.0, -7200.0, 86400.0, -86400.0 * 2)[i % 4]
            time.clock_settime(time.CLOCK_REALTIME, time.time() + jump)
            made.order()
            took = made.run(5.0, lambda: not made.host.writing)
            if took > 2.0:
                made.wrong.append(f"a write took {took:.1f} s over a jump of {jump:g} s")
            made.run(0.1)
        time.clock_settime(time.CLOCK_REALTIME, honest + time.monotonic())
        lost = made.lost
        if lost:
            made.wrong.append(f"{lost} samples lost by the clock")
        return {"jumps": len(times(20, share)), **made.report()}


def errors(share: float, seed: int) -> dict[str, object]:
    """Error frames of every kind that SocketCAN has; bus-off closes the bus and it comes back."""
    with bench(seed=seed) as made, can.Bus(interface="socketcan", channel=IFACE) as other:
        injected = 0
        for _ in times(20, share):
            for kind, state in ERROR_CLASSES.values():
                data = bytes([0, state, 0, 0, 0, 0, 0, 0])
                made.order()
                other.send(can.Message(is_error_frame=True, arbitration_id=kind, is_extended_id=False, data=data))
                injected += 1
                made.run(0.02)
                made.run(20.0, made.well)
        seen = made.near.faults.counts
        for fault in (LinkFault.BUS_OFF, LinkFault.ERROR_PASSIVE, LinkFault.NO_ACKNOWLEDGE, LinkFault.OVERFLOW):
            if seen[fault] != len(times(20, share)):
                made.wrong.append(f"{fault}: {seen[fault]} seen")
        return {"injected": injected, **made.report()}


def gateway(share: float, seed: int) -> dict[str, object]:
    """Device and host on two buses with a gateway that harms one kind of frame at a time, one way or both."""
    if not _can(["cangw", "-F"]):
        return {"not here": "cangw or its kernel module is missing"}
    sh("ip", "link", "add", "dev", "vcan1", "type", "vcan")
    sh("ip", "link", "set", "vcan1", "up")
    try:
        _forward([])
        with bench("vcan1", IFACE, seed) as made:
            harms = [(harm, command) for command in COMMANDS for harm in ("flip", "withhold")]
            tried = harms[:: max(round(1 / share), 1)]
            for harm, command in tried:
                _forward([(harm, command, made.rng.randrange(64))])
                made.order()
                made.run(40 * SAMPLE_S)
                _forward([])
                made.run(20.0, made.well)
            return {"harms": len(tried), **made.report()}
    finally:
        sh("cangw", "-F")
        sh("ip", "link", "del", "vcan1")


def _forward(harms: list[tuple[str, int, int]]) -> None:
    """Rules of the gateway: everything passes both ways, but the harmed kind of frame."""
    sh("cangw", "-F")
    for source, target in ((IFACE, "vcan1"), ("vcan1", IFACE)):
        route = ["cangw", "-A", "-s", source, "-d", target, "-e"]
        if not harms:
            sh(*route)
        for harm, command, bit in harms:
            id_ = f"{NODE << 5 | command:X}"
            sh(*route, "-f", f"{id_}~C00007FF")
            if harm == "flip":
                data = (1 << bit).to_bytes(8, "big").hex()
                sh(*route, "-f", f"{id_}:C00007FF", "-m", f"XOR:D:0.0.{data}")


def netem(share: float, seed: int) -> dict[str, object]:
    """Loss, duplication, delay with reordering and corruption on both ways of a vxcan pair."""
    pair = ["ip", "link", "add", "dev", "vxcan0", "type", "vxcan", "peer", "name", "vxcan1"]
    if not _can(pair):
        return {"not here": "vxcan is missing"}
    for end in ("vxcan0", "vxcan1"):
        sh("ip", "link", "set", end, "up")
    try:
        if not _can(["tc", "qdisc", "add", "dev", "vxcan0", "root", "netem", "loss", "1%"]):
            return {"not here": "netem is missing"}
        with bench("vxcan1", "vxcan0", seed) as made:
            for mix in (text.split() for text in MIXES):
                for end in ("vxcan0", "vxcan1"):
                    sh("tc", "qdisc", "replace", "dev", end, "root", "netem", *mix)
                for _ in times(20, share):
                    made.order()
                    made.run(6 * SAMPLE_S)
            for end in ("vxcan0", "vxcan1"):
                sh("tc", "qdisc", "del", "dev", end, "root")
            return {"mixes": MIXES, **made.report()}
    finally:
        sh("ip", "link", "del", "vxcan0")


def foreign(share: float, seed: int) -> dict[str, object]:
    """Somebody with can-utils: floods, frames under our identifiers, and our own traffic once more."""
    if not _can(["sh", "-c", "command -v cangen && command -v candump && command -v canplayer"]):
        return {"not here": "can-utils are missing"}
    count = str(max(round(20_000 * share), 500))
    few = str(int(count) // 25)
    ours = [
        ["cangen", IFACE, "-g", "0", "-i", "-n", few, "-I", f"{NODE << 5 | command:X}", "-L", length]
        for command in COMMANDS
        for length in ("8", "i")
    ][:: max(round(1 / share), 1)]
    with bench(seed=seed) as made, tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "record.log"
        with record.open("wb") as out:
            dump = subprocess.Popen(["candump", "-L", IFACE], stdout=out)
            for _ in times(10, share):
                made.order()
                made.run(20.0, made.well)
            dump.terminate()
            dump.wait()
        flood = ["cangen", IFACE, "-g", "0", "-i", "-n", count]
        floods = [flood, [*flood, "-m"], [*flood, "-I", "0", "-L", "0"]]
        replay = [["canplayer", "-I", str(record), "-g", "1"], ["canplayer", "-I", str(record), "-l", "3", "-g", "2"]]
        commands = [*floods, *ours, *replay]
        for command in commands:
            with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as other:
                made.order()
                made.run(60.0, lambda other=other: other.poll() is not None)
            made.run(20.0, made.well)
        return {
            "attacks": len(commands),
            "frames received": made.near.counters.received,
            "foreign commands seen": made.host.foreign_commands,
            **made.report(),
        }


def _can(command: list[str]) -> bool:
    """Whether a command works here."""
    with contextlib.suppress(FileNotFoundError):
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    return False
