"""The virtual device on the simulated bus: it may crash before or after any frame, and every change of its gains is
held to the invariants.
"""

from collections import deque
from collections.abc import Callable
from random import Random

import can

from bus_simulation import truth as t
from bus_simulation.bus import Bus
from bus_simulation.layers.door import Door
from bus_simulation.truth import Ran, Truth, ViolationError
from retuner.drivers.controller.gain_memory import Slot
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.protocol.codec import COMMAND_BITS

# ---- A second implementation of the device beside the first: told the same, it must answer the same, byte for byte.
#
# So every layer is looked at, also one whose work another layer would do as well: a device that lacks it is found
# by its answers, not by what they lead to.

TELEMETRY_PV, TELEMETRY_SP = 0x12, 0x13
NOT_LIMITED = 0b11111001  # of the byte with mode, limited and running: limited follows from co in other arithmetic


class Drawn:
    """Challenges for two devices: what the first has drawn, the second gets."""

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._waiting: deque[int] = deque()

    def first(self) -> int:
        """A new one."""
        self._waiting.append(self._rng.getrandbits(48))
        return self._waiting[-1]

    def second(self) -> int:
        """The same; none is left when the first should have drawn one and has not."""
        if not self._waiting:
            raise ViolationError("answers_as_its_twin: a challenge was not renewed")
        return self._waiting.popleft()


class _SamePlant:
    """The first device's plant as the second one sees it."""

    def __init__(self, device: VirtualDevice) -> None:
        self._device = device

    @property
    def pv(self) -> float:
        return float(self._device.pv)

    def step(self, *_: float) -> float:
        """As the first device has read it."""
        return self.pv

    def steady_co(self, *_: float) -> float:
        """As the first device began."""
        return float(self._device.co)


class Twin:
    """The second device.

    device : the first one. make : builds the second one on a plant.
    """

    def __init__(self, device: VirtualDevice, make: Callable[[_SamePlant], VirtualDevice]) -> None:
        self._first = device
        self.device = make(_SamePlant(device))

    def receive(self, message: can.Message, replies: list[can.Message]) -> None:
        """A frame that the first has answered so."""
        self._compare([bytes(m.data) for m in replies], [bytes(m.data) for m in self.device.receive(message)], message)

    def step(self, messages: list[can.Message], dt_s: float) -> None:
        """A sample of the first."""
        self._compare(*([_without_co(m) for m in ms] for ms in (messages, self.device.step(dt_s))), None)

    def restart(self) -> None:
        """Power off and on, as the first."""
        self.device.restart()

    def _compare(self, first: list[bytes], second: list[bytes], message: can.Message | None) -> None:
        """Raises ViolationError when they differ."""
        if first != second:
            about = "a sample" if message is None else f"{message.arbitration_id:03X}#{bytes(message.data).hex()}"
            raise ViolationError(f"answers_as_its_twin: {about}: {first} and {second}")


def _without_co(message: can.Message) -> bytes:
    """A frame's bytes without what follows from co: the two are computed in different arithmetic."""
    command, data = message.arbitration_id & 31, bytes(message.data)
    if command == TELEMETRY_PV:
        return data[:5]
    return data[:5] + bytes([data[5] & NOT_LIMITED]) if command == TELEMETRY_SP else data


# ---- The virtual device on the simulated bus: it may crash before or after any frame, and every change of its gains is
# held to the invariants.

NAME = "device"
COMMIT = 5
COMMAND = (1 << COMMAND_BITS) - 1
SEQUENCES = 1 << 16
LEAP = 64  # numbers by which no honest host goes ahead at once
BUFFER = 64  # frames that a device which hangs still receives
TORN = 0.1  # share of the times a place is written in which power fails meanwhile
SAFE = 1 << 60  # messages until a crash: none


class LagPlant:
    """First-order lag in a few operations: pv' = (2 co + load - pv) / 30 s."""

    def __init__(self) -> None:
        self.pv = 50.0

    def step(self, co: float, load: float, dt_s: float) -> float:
        """Hold co and load for dt_s."""
        self.pv += (co + load - 0.5 * self.pv) * dt_s / 30.0
        return self.pv

    def steady_co(self, pv: float, load: float = 0.0) -> float:
        """Controller output that holds pv."""
        return 0.5 * pv - load


class DeviceEnd:
    """One device.

    fuse counts the messages until it crashes, down the steps for which it then stays off, hung those for which it does
    nothing while its receive buffer fills.
    """

    def __init__(
        self, bus: Bus, device: VirtualDevice, truth: Truth, rng: Random, door: Door, twin: Twin | None = None
    ) -> None:
        self.bus, self.device, self.truth, self._rng, self._twin, self._door = bus, device, truth, rng, twin, door
        door.watch(device)
        self._way = bus.ways[NAME]
        self.fuse = SAFE
        self.down = self.hung = 0
        self.slow = 1.0
        self._running = device.pages.running
        self._confirmed = device.pages.confirmed
        self._holder: dict[int, int] = {}

    def answer(self) -> None:
        """Take what has arrived."""
        if self.hung:
            del self._way.inbox[:-BUFFER]
            return
        if self.down:
            self._way.take()
            return
        for message in self._way.take():
            pages = self.device.pages
            if message.arbitration_id & COMMAND == COMMIT and len(message.data) == 8:
                self._holder[int.from_bytes(message.data[:2], "little")] = self.device.lease.owner
            self.fuse -= 1
            latest, slots = pages.latest, list(pages.slots)
            self._door.coming(message)
            replies = self.device.receive(message)
            self._door.came(message, replies)
            if self._twin is not None:
                self._twin.receive(message, replies)
            if (pages.latest - latest) % SEQUENCES > LEAP:
                self.truth.driven = True
            if pages.running is not self._running:
                raise ViolationError(f"running_set_is_a_committed_one: {pages.running} began between samples")
            if pages.confirmed is not self._confirmed:
                self._confirmed = pages.confirmed
                self.truth.confirmed.add((pages.confirmed.seq, pages.confirmed.gains))
            written = next((i for i, slot in enumerate(pages.slots) if slot != slots[i]), None)
            if written is not None and self._rng.random() < TORN:
                self.crash(written)
            else:
                self._send(replies)
            if self.down:
                return

    def sample(self) -> None:
        """One controller sample, unless it is off."""
        if self.down or self.hung:
            self.down, self.hung = max(self.down - 1, 0), max(self.hung - 1, 0)
            return
        messages = self.device.step(2.0 * self.slow)
        if self._twin is not None:
            self._twin.step(messages, 2.0 * self.slow)
        if self.device.pages.running is not self._running:
            device, truth = self.device, self.truth
            running, before = device.pages.running, truth.ran[-1]
            now = Ran(self.bus.step, device.epoch, running.seq, running.gains)
            self._running = running
            if running is device.pages.confirmed:
                truth.counts["reverts"] += 1
                t.reverted_to_the_confirmed_set(truth, now)
                truth.began(now)
            else:
                truth.counts["swaps"] += 1
                order = t.running_set_is_a_committed_one(truth, now, self._holder.get(now.seq, 0))
                t.built_on_what_ran(order, before)
                t.authentic(truth, order)
                t.one_owner(order, self._holder.get(now.seq, 0))
                t.finite_and_inside_the_box(truth, now, before)
                t.sequence_is_monotonic(truth, now)
                t.failed_sets_stay_dead(truth, now)
                if order.who in truth.ledgers:
                    t.ledger_has_the_intent(truth.ledgers[order.who], order)
                else:
                    truth.counts["sets of the intruder"] += 1
                truth.began(now)
        self._door.sampled(messages, 2.0 * self.slow)
        self._send(messages)

    def _send(self, messages: list[can.Message]) -> None:
        """Frames to the bus, until a crash."""
        for message in messages:
            if self.fuse <= 0:
                break
            self.fuse -= 1
            self.bus.send(NAME, message)
        if self.fuse <= 0:
            self.crash()

    def crash(self, written: int | None = None) -> None:
        """Power fails; what was stored last may be lost."""
        device, rng = self.device, self._rng
        self.truth.counts["device crashes"] += 1
        self.fuse, self.down = SAFE, rng.choice((0, 0, 1, 3, 8, 30))
        torn = written if written is not None else self._last_written() if rng.random() < 0.3 else None
        if torn is not None:
            self._tear(torn)
        device.restart()
        if self._twin is not None:
            self._twin.restart()
        self._door.restarted(torn=torn is not None)
        running = device.pages.running
        now = Ran(self.bus.step, device.epoch, running.seq, running.gains)
        t.restarted_on_a_confirmed_set(self.truth, now)
        t.restarted(self.truth)
        self._running = self._confirmed = running
        self.truth.began(now)

    def _last_written(self) -> int | None:
        """The place written last, where both are whole: it may be damaged and the other one must do."""
        slots = self.device.pages.slots
        there = [slot for slot in slots if slot is not None and slot.whole]
        if len(there) < len(slots):
            return None
        return slots.index(max(there, key=lambda slot: slot.generation))

    def _tear(self, place: int) -> None:
        """A place that is not whole."""
        slots = self.device.pages.slots
        was = slots[place]
        if was is None:
            return
        torn = slots[place] = Slot(was.generation, was.content, was.crc ^ 1 << self._rng.randrange(32))
        if self._twin is not None:
            self._twin.device.pages.slots[place] = torn
