"""A host on the simulated bus: the real client, a clerk who keeps the ledger, crashes at any frame or row."""

from contextlib import suppress
from random import Random

import can

from bus_simulation import truth as t
from bus_simulation.bus import Bus
from bus_simulation.layers.host_side import HostSide
from bus_simulation.truth import Order, Truth
from retuner import LoopSample, PidGains
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.device import (
    DeviceError,
    DeviceRestarted,
    LinkState,
    Reverted,
    RunningChanged,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
    WriteUnknown,
)
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.protocol.checksum import to_wire

READ, PAGE_RUNNING = 2, 0
COMMAND = 31
SAFE = 1 << 60
LINK = LinkSettings()
KEEPS = 0.1  # share of steps after a write in which the host confirms or stores
WAITS_FOR_A_WRITE = 30  # steps that a mishap waits for one
REACH = 1.5  # decades by which an ordered gain may differ from the running one: further than the box allows


class CrashError(Exception):
    """The host's process ends here and now."""


class HostEnd:
    """One host; when its process has died another one begins, with another number for the lease or the same.

    name : on the bus. bus, truth, rng : of the run. key : for codes. same_owner : every life has the same number.
    eager : share of steps in which it begins a write when it can.
    """

    settings = LINK
    state = LinkState.UP

    def __init__(
        self, name: str, bus: Bus, truth: Truth, rng: Random, *, key: bytes | None, same_owner: bool, eager: float
    ) -> None:
        self.name, self.bus, self.truth, self._rng, self._random = name, bus, truth, rng, rng.random
        self._way = bus.ways[name]
        self._key, self._same_owner, self._eager = key, same_owner, eager
        self.owner = rng.randrange(1, 65536)
        self.now_s = self._drift = self._ahead_s = 0.0
        self._jump_by = 0
        self.fuse = SAFE
        self.lives = 0
        self.calm = False
        self.start()

    def start(self) -> None:
        """A new process."""
        self.lives += 1
        if not self._same_owner:
            self.owner = self._rng.randrange(1, 65536)
        self.life = f"{self.name}{self.lives}"
        self.rows: list[tuple[str, object]] = []
        self.truth.ledgers[self.life] = self.rows
        settings = CanDeviceSettings(owner=self.owner, key=self._key)
        self.side = HostSide(settings, self.rows)
        self.device: CanDevice | None = CanDevice(self, settings)
        self.order: Order | None = None
        self.last_outcome: object = None
        self._asked = self._answered = self.bus.step
        self._t_s = float("-inf")
        self._back_at = 0

    def send(self, message: can.Message) -> bool:
        """Put a frame on the bus, unless this is where the process ends."""
        if message.arbitration_id & COMMAND == READ and message.data[0] == PAGE_RUNNING:
            self._asked = self.bus.step
        self._burn()
        self.side.sends(message, self.now_s)
        self.bus.send(self.name, message)
        return True

    def receive_all(self) -> list[can.Message]:
        """What has arrived."""
        messages = self._way.take()
        for message in messages:
            self.side.comes(message, self.now_s)
        return messages

    def _record(self, kind: str, body: object) -> None:
        """A row of the ledger, for good once this returns."""
        self._burn()
        self.rows.append((kind, body))

    def _burn(self) -> None:
        """One more thing done."""
        self.fuse -= 1
        if self.fuse <= 0:
            raise CrashError

    def clear_up(self) -> None:
        """No faults from now on: a process that has died is begun anew at once, the clock goes right."""
        self.calm, self.fuse, self._drift, self._back_at = True, SAFE, 0.0, 0
        self._ahead_s = 0.0

    def jump(self, seconds: float) -> None:
        """The machine is suspended, if possible in the middle of a write: its clock goes on."""
        self._ahead_s, self._jump_by = seconds, self.bus.step + WAITS_FOR_A_WRITE

    def drift(self, share: float) -> None:
        """The clock goes too fast by this share from now on."""
        self._drift = share

    def act(self) -> None:
        """One turn: poll, keep the ledger, perhaps begin a write."""
        self.now_s += 2.0 * (1.0 + self._drift)
        if self._ahead_s and (self.bus.step >= self._jump_by or (self.device is not None and self.device.writing)):
            self.now_s, self._ahead_s = self.now_s + self._ahead_s, 0.0
        if self.device is None:
            self._way.take()
            if self.bus.step >= self._back_at:
                self.start()
            return
        self._answered = self._asked  # what this turn's answers can be answers to
        try:
            events = self.device.poll(self.now_s)
            self.side.polled(self.now_s, connected=self.device.connected)
            for event in events:
                self.side.tells(event)
                self._event(event)
            # A write whose lease ran out goes on under another number
            seq = self.device.write.seq if self.device is not None else None
            if self.order is not None and seq not in {None, self.order.seq}:
                self.order = self.order._replace(seq=seq)
                self.truth.ordered(self.order)
            # Now and then what has been written is confirmed, and then stored
            if self.order is None and isinstance(self.last_outcome, WriteDone) and self._random() < KEEPS:
                with suppress(WriteRefusedError):
                    self.device.confirm(self.now_s) if self._random() < 0.5 else self.device.store(self.now_s)
            if self.order is None and not self.calm and self._random() < self._eager:
                running = self.device.running if self.device is not None else None
                other = None  # gains, mostly legal ones
                if running is not None:
                    gains, random = running.gains, self._random
                    reach = REACH if random() < 0.1 else 0.3
                    kp = gains.kp * 10.0 ** (reach * (2.0 * random() - 1.0))
                    ki = gains.ki * 10.0 ** (reach * (2.0 * random() - 1.0))
                    kd = (gains.kd or 0.3) * 10.0 ** (reach * (2.0 * random() - 1.0)) if random() < 0.9 else 0.0
                    sign = -1.0 if random() < 0.01 else 1.0
                    other = to_wire(PidGains(sign * kp, sign * ki, sign * kd))
                self.begin(other)
        except (CrashError, DeviceError):
            self.die()

    def die(self) -> None:
        """The process is gone, whatever it was about."""
        self.truth.counts["host crashes"] += 1
        if self.order is not None or sum(k == "intent" for k, _ in self.rows) > sum(
            k in {"committed", "failed", "refused"} for k, _ in self.rows
        ):
            self.rows.append(("died", None))
        t.ledger_has_every_outcome(self.rows, 0)
        self.device, self.order, self.fuse = None, None, SAFE
        self._back_at = 0 if self.calm else self.bus.step + self._rng.choice((0, 1, 5, 60))

    def _event(self, event: object) -> None:
        """What the client tells."""
        if isinstance(event, LoopSample):
            t.time_goes_forward(self._t_s, event.t_s)
            self._t_s = event.t_s
        elif isinstance(event, WriteDone | WriteFailed):
            order = self.order
            t.reported_is_what_ran(self.truth, event.running, self._answered)
            if order is None:
                raise t.ViolationError(f"done_is_what_was_ordered: {event} without an order")
            t.done_is_what_was_ordered(event, order)
            if isinstance(event, WriteFailed):
                self.truth.dead.add(order.gains)
                self.truth.counts[f"failed: {event.reason.split(' (')[0]}"] += 1
            else:
                self.truth.counts["done"] += 1
            self._record("committed" if isinstance(event, WriteDone) else "failed", order.gains)
            self.order, self.last_outcome = None, event
        elif isinstance(event, DeviceRestarted | RunningChanged | Reverted):
            t.reported_is_what_ran(self.truth, event.running, self._answered)
            self._record("news", event)
        else:
            self.truth.counts[type(event).__name__] += 1
            if isinstance(event, WriteUnknown):
                self._record("unknown", event)

    def begin(self, gains: PidGains | None) -> None:
        """Write these gains: the intent goes to the ledger first."""
        device = self.device
        if gains is None or device is None or device.running is None or device.writing:
            return
        base, epoch = device.running.seq, device.epoch or 0
        self._record("intent", gains)
        try:
            seq = device.begin_write(gains, self.now_s)
        except WriteRefusedError:
            self.truth.counts["not begun"] += 1
            self._record("refused", gains)
            return
        self.order = Order(epoch, seq, base, gains, self.owner, self.life)
        self.truth.ordered(self.order)
