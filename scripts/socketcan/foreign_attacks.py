"""Somebody with can-utils against a session with a controller that is not ours, on real SocketCAN.

    python scripts/socketcan/run.py -- PYTHON -P scripts/socketcan/foreign_attacks.py CONFIG FOLDER [SPEED [NODE]]

A session of CONFIG and a virtual device, or the program NODE (examples/nodes), run as two processes; meanwhile frames
of random content under each identifier that was heard, floods, remote and FD frames, bus-off, a second NODE, and what
was recorded, again. Prints one line of JSON: what was sent, how both ended, and what was wrong: a traceback, a broken
ledger, a number in it that is none, an order of writes that is not proved. Status 1 when anything was.

What cannot be held here: such a controller obeys whoever writes to it. Where it can be read back, the session tells.
"""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import can

from retuner.ledger import LedgerReader

CHANNEL = "vcan0"
HEARD_S, BETWEEN_S, END_S = 120.0, 0.5, 300.0
RETUNER = [sys.executable, "-P", "-c", "import sys; from retuner.cli import main; sys.exit(main())"]
RANDOM = ["cangen", CHANNEL, "-g", "2", "-i", "-n", "150"]


def heard(device: "subprocess.Popen[bytes]") -> set[int]:
    """Identifiers of the frames of a second, once there are any."""
    found: set[int] = set()
    with can.Bus(interface="socketcan", channel=CHANNEL) as bus:
        last_s = time.monotonic() + HEARD_S
        while time.monotonic() < last_s and device.poll() is None:
            message = bus.recv(1.0)
            if message is not None:
                found.add(message.arbitration_id)
                last_s = min(last_s, time.monotonic() + 5.0)
    return found


def attacks(ids: set[int], record: Path, second: list[str]) -> Iterator[list[str]]:
    """One after the other, again and again."""
    near = sorted({one ^ bit for one in ids for bit in (0, 1, 2, 4, 8, 0x80, 0x600 ^ 0x580)} & set(range(0x800)))
    while True:
        for one in near:
            yield [*RANDOM, "-I", f"{one:X}", "-L", "8"]
            yield [*RANDOM, "-I", f"{one:X}", "-L", "i"]
            yield [*RANDOM[:-1], "20", "-I", f"{one:X}", "-R"]
        yield [*RANDOM[:-1], "3000", "-m"]
        yield ["timeout", "5", "canplayer", "-I", str(record), "-g", "1"]
        yield [sys.executable, "-P", __file__, "bus-off"]
        if second:
            yield ["timeout", "10", *second]


def numbers(value: object) -> Iterator[float]:
    """Every number in a row."""
    if isinstance(value, dict):
        for one in value.values():
            yield from numbers(one)
    elif isinstance(value, list):
        for one in value:
            yield from numbers(one)
    elif isinstance(value, float):
        yield value


def wrong_in(folder: Path) -> tuple[list[str], dict[str, int]]:
    """What must not be, and how many rows of each kind there are."""
    said = "".join((folder / name).read_text(errors="replace") for name in ("run.err", "device.err"))
    found = ["traceback"] if "Traceback" in said else []
    kinds: dict[str, int] = {}
    if not (folder / "run" / "ledger.sqlite").exists():  # it did not find the controller
        return [*found, f"no session: {said[-200:]}"], kinds
    with LedgerReader(folder / "run" / "ledger.sqlite") as ledger:
        found += [] if ledger.verify().ok else ["ledger"]
        for row in ledger.rows():
            kinds[row.kind] = kinds.get(row.kind, 0) + 1
            found += [f"{row.kind}: {n}" for n in numbers(dict(row.body)) if math.isnan(n)]
            found += ["an order that is not proved"] * (row.kind == "order_of_writes" and not row.body["proved"])
    return found, kinds


def main() -> int:
    """Attack one session."""
    if sys.argv[1:] == ["bus-off"]:
        with can.Bus(interface="socketcan", channel=CHANNEL) as bus:
            bus.send(can.Message(is_error_frame=True, arbitration_id=0x40, is_extended_id=False, data=bytes(8)))
        return 0
    config, out, speed = sys.argv[1], Path(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else "1"
    out.mkdir(parents=True, exist_ok=True)
    where = ["--interface", "socketcan", "--channel", CHANNEL, "--speed", speed]
    record, sent = out / "record.log", 0
    with (out / "device.err").open("wb") as device_err, (out / "run.err").open("wb") as run_err:
        node = [sys.executable, "-P", *sys.argv[4:5], *where] if sys.argv[4:] else []
        device = subprocess.Popen(node or [*RETUNER, "device", config, *where], stderr=device_err)
        ids = heard(device)
        run = [*RETUNER, "run", config, *where, "--out", str(out / "run"), "--no-compare"]
        session = subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=run_err)
        with record.open("wb") as file, subprocess.Popen(["candump", "-L", CHANNEL], stdout=file) as dump:
            ids |= heard(session)
            dump.terminate()
        last_s, tried = time.monotonic() + END_S, attacks(ids, record, node)
        while session.poll() is None and time.monotonic() < last_s:
            subprocess.run(next(tried), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
            sent += 1
            time.sleep(BETWEEN_S)
        session.send_signal(signal.SIGINT)
        ended = session.wait(HEARD_S)
        device.send_signal(signal.SIGINT)
        device.wait(HEARD_S)
    found, kinds = wrong_in(out)
    print(json.dumps({"config": config, "kernel": os.uname().release, "attacks": sent, "identifiers": len(ids),
                      "session": ended, "device": device.returncode, "rows": kinds, "wrong": found}))  # fmt: skip
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
