"""kill -9 of host and device processes at random moments: see faults.py.

The host keeps a ledger as `retuner run` does: a row before it writes, a row when the write was read back as running.
After each kill an observer asks the device what it runs, and that must be a set whose intent stands in the ledger; and
if nothing was begun after the last row "committed", just that set.
"""

import os
import random
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from bench import FIRMWARE, FIRST, HOST, LOOK_S, NODE, link, some_gains

from retuner.adaptive.process.model import LinearProcess
from retuner.drivers.clock import MonotonicClock
from retuner.drivers.controller.device_process import DeviceOnBus, fresh_epoch, run_devices
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.device import WriteDone, WriteRefusedError
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import fresh_owner
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.errors import LedgerError
from retuner.ledger import Ledger, LedgerReader
from retuner.schedule.gains import PidGains

CHANNEL = "vcan0"
LONGEST_LIFE_S = 2.0  # of a host between two kills
CONNECT_S = 15.0
STOP_EVERY = 3  # kills between two hosts that are stopped for a while and go on: a suspended machine


def child(work: Callable[[], None]) -> int:
    """Run it in a forked process."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
        finally:
            os._exit(1)
    return pid


def device() -> None:
    """A controller that loses everything when it is killed."""
    clock = MonotonicClock()
    machine = VirtualDevice(FIRMWARE, LinearPlant(LinearProcess(1.0, (1.0,)), start_pv=50.0), fresh_epoch())
    with link(CHANNEL, clock) as bus:
        run_devices([DeviceOnBus(machine, bus)], clock)


def host(path: Path, seed: int) -> None:
    """Write one set of gains after the other, each in the ledger before it is begun."""
    rng, clock = random.Random(seed), MonotonicClock()
    with link(CHANNEL, clock) as bus, Ledger(path) as ledger:
        controller = CanDevice(bus, replace(HOST, owner=fresh_owner()))
        while True:
            now_s = clock.now_s()
            for event in controller.poll(now_s):
                if isinstance(event, WriteDone):
                    ledger.append("committed", {"gains": list(_numbers(event.gains))}, now_s)
            if controller.connected and not controller.writing:
                gains = some_gains(rng)
                ledger.append("intent", {"gains": list(_numbers(gains))}, now_s)
                try:
                    controller.begin_write(gains, now_s)
                except WriteRefusedError:
                    ledger.append("refused", {}, now_s)
            bus.wait_until(now_s + LOOK_S)


def _numbers(gains: PidGains) -> tuple[float, float, float]:
    return gains.kp, gains.ki, gains.kd


class Observer:
    """Asks what runs, and commands nothing that matters."""

    def __init__(self) -> None:
        self.clock = MonotonicClock()
        self.bus = link(CHANNEL, self.clock)
        self.controller = CanDevice(self.bus, replace(HOST, owner=fresh_owner(), connect_floor_s=1e6))

    def running(self) -> tuple[float, float, float] | None:
        """What a device that has been left alone runs, read anew; None when it does not answer in time."""
        self.bus.receive_all()
        self.controller = CanDevice(self.bus, replace(HOST, owner=fresh_owner(), connect_floor_s=1e6))
        end_s = self.clock.now_s() + CONNECT_S
        while self.clock.now_s() < end_s:
            self.controller.poll(self.clock.now_s())
            if self.controller.connected and self.controller.running is not None:
                return _numbers(self.controller.running.gains)
            self.bus.wait_until(self.clock.now_s() + LOOK_S)
        return None


def read(path: Path) -> tuple[list[tuple[str, tuple[float, ...]]], list[str]]:
    """Kind and gains of the ledger's rows, and what is wrong with it; a host killed at once may have left none."""
    if not path.exists():
        return [], []
    try:
        with LedgerReader(path) as ledger:
            report = ledger.verify()
            rows = [(row.kind, tuple(row.body.get("gains", ()))) for row in ledger.rows() if row.kind != "refused"]
    except LedgerError as error:
        return [], [] if "holds nothing" in str(error) else [str(error)]
    return rows, [] if report.ok else [report.reason]


def judge(path: Path, running: tuple[float, float, float] | None, *, rebooted: bool) -> tuple[list[str], int]:
    """What is wrong with what runs after a kill; and how many sets the ledger holds as committed."""
    if running is None:
        return ["the device does not answer"], 0
    rows, wrong = read(path)
    intended = {gains for kind, gains in rows if kind == "intent"} | {_numbers(FIRST)}
    if running not in intended:
        wrong.append(f"{running} runs, which no row intends")
    if rows and rows[-1][0] == "committed" and not rebooted and running != rows[-1][1]:
        wrong.append(f"{running} runs, the last row says {rows[-1][1]}")
    return wrong, sum(kind == "committed" for kind, _ in rows)


def pause(process: int, rng: random.Random) -> bool:
    """Stop a host for longer than its lease, and let it go on for a moment: it must not act on what it knew."""
    os.kill(process, signal.SIGSTOP)
    time.sleep(rng.uniform(1.0, 3.0))
    os.kill(process, signal.SIGCONT)
    time.sleep(rng.uniform(0.0, 0.5))
    return True


def kill(share: float, seed: int) -> dict[str, object]:
    """Kill the host 100 times and the device 100 times."""
    rng, wrong = random.Random(seed), []
    kills = {"host": 0, "device": 0}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger.sqlite"
        machine = child(device)
        committed, number, stopped, rebooted, observer = 0, 0, 0, False, Observer()
        while min(kills.values()) < max(round(100 * share), 2):
            number += 1
            master = child(lambda number=number: host(path, seed * 10_000 + number))
            time.sleep(rng.uniform(0.3, LONGEST_LIFE_S))
            if number % STOP_EVERY == 0:
                stopped += pause(master, rng)
            if number % 2 == 0:
                os.kill(machine, signal.SIGKILL)
                os.waitpid(machine, 0)
                kills["device"] += 1
                machine, rebooted = child(device), True
                time.sleep(rng.uniform(0.0, LONGEST_LIFE_S))
            os.kill(master, signal.SIGKILL)
            os.waitpid(master, 0)
            kills["host"] += 1
            faults, committed = judge(path, observer.running(), rebooted=rebooted)
            rebooted = rebooted and number % 2 == 0
            wrong += [f"kill {number}: {fault}" for fault in faults]
        os.kill(machine, signal.SIGKILL)
        os.waitpid(machine, 0)
        observer.bus.close()
    return {
        "kills": kills,
        "hosts stopped for seconds": stopped,
        "sets committed": committed,
        "node": NODE,
        "wrong": wrong[:10],
    }
