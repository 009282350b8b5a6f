"""A controller that hangs on CAN, in software: PID firmware with its plant, frame by frame what a real one would do.

One call of step() is one controller sample: the plant moves, pv is read, a committed gain set is swapped in without a
bump, co is worked out and applied, telemetry goes out. receive() answers at once, as an interrupt would. Nothing here
reads a clock or a bus: device_process.py and the tests move frames and time.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import can

from retuner.adaptive.signals.sample import LoopMode
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings
from retuner.drivers.controller.gain_memory import GainPages, GainSet
from retuner.drivers.plants.plant import Plant
from retuner.drivers.protocol import frames as wire
from retuner.drivers.protocol.authentication import CodeDesk, fresh_nonce
from retuner.drivers.protocol.checksum import CO_STEP, STAMP_SAMPLES, co_steps, lease_stamp, sample_crc
from retuner.drivers.protocol.codec import Codec, Refusal, Refused, schema
from retuner.drivers.telemetry.signal_source import plant_message
from retuner.schedule.pid import LIMITED, PV, StateTuple, change, start, step, track

# The device's side of the lease: which one host may command, and until when, counted in controller samples.
#
# A lease is asked for, prolonged and given back with LEASE frames. Their counter must be newer each time (AUTOSAR E2E:
# a repeated frame is never a good one), and their stamp must be of the device's present time: this boot epoch, and the
# present or the last STAMP_SAMPLES samples. So no frame of before a restart takes the lease, and nobody keeps the lease
# of a dead host alive by sending frames again, in whatever order.

NOBODY = 0


class LeaseDesk:
    """The lease of one device.

    longest_samples : longest lease that is granted; more is asked for in vain.
    """

    def __init__(self, longest_samples: int) -> None:
        self._longest = longest_samples
        self.owner = NOBODY
        self._left = 0
        self._last: wire.Lease | None = None

    def boot(self) -> None:
        """Nobody holds it after a restart."""
        self.owner, self._left, self._last = NOBODY, 0, None

    def request(self, frame: wire.Lease, epoch: int, sample: int) -> wire.Ack:
        """Take, prolong or give back, in this epoch and sample; latest of the answer is the owner in force."""
        reason = self._judge(frame, epoch, sample)
        if reason is wire.Reason.OK and frame != self._last:
            self._last = frame
            self._left = min(frame.samples, self._longest)
            self.owner = frame.owner if self._left else NOBODY
        return wire.Ack(wire.Kind.LEASE, frame.owner, reason, self.owner)

    def _judge(self, frame: wire.Lease, epoch: int, sample: int) -> wire.Reason:
        if frame.stamp not in {lease_stamp(epoch, sample), lease_stamp(epoch, max(sample - STAMP_SAMPLES, 0))}:
            return wire.Reason.STALE
        if self.owner not in {NOBODY, frame.owner}:
            return wire.Reason.NOT_OWNER
        last = self._last
        if last is None or last.owner != frame.owner or frame == last:
            return wire.Reason.OK
        return wire.Reason.OK if wire.newer(frame.counter, last.counter, COUNTER_BITS) else wire.Reason.STALE

    def tick(self) -> bool:
        """One controller sample has passed; whether the lease has just run out."""
        if self.owner == NOBODY:
            return False
        self._left -= 1
        if self._left > 0:
            return False
        self.owner = NOBODY
        return True

    def allows(self, owner: int, modulo: int = 1 << 16) -> bool:
        """Whether this owner (or its remainder that a short frame carries) holds the lease."""
        return self.owner != NOBODY and owner == self.owner % modulo


__all__ = ["VirtualDevice", "VirtualDeviceSettings"]

PV_WIRE = (-1e9, 1e9)  # range of pv in retuner.dbc
SAMPLE_WRAP = 1 << 32
EPOCHS = 1 << 16
COUNTER_BITS = 8


class VirtualDevice:
    """The firmware at work on a plant.

    settings : firmware.
    plant : what it controls; the loop starts at rest at the plant's pv, in auto.
    epoch : number of this boot, 0..65535; every restart takes the next one.
    nonce : makes the challenges that commit codes are worked out over.
    keep : how the writing of a set into non-volatile memory ends, see GainPages.
    """

    def __init__(
        self,
        settings: VirtualDeviceSettings,
        plant: Plant,
        epoch: int = 1,
        nonce: Callable[[], int] = fresh_nonce,
        keep: Callable[[], bool | None] = lambda: True,
    ) -> None:
        self.settings, self.plant = settings, plant
        self._codec = Codec(settings.node)
        self.pages = GainPages(settings.node, settings.box, settings.gains, settings.trial_samples, keep)
        self.lease = LeaseDesk(settings.lease_longest)
        self.code = CodeDesk(settings.key, nonce)
        self.epoch = epoch
        self.load = 0.0
        self._boot()

    def _boot(self) -> None:
        """State after power-on: in auto, at rest at the present pv."""
        self.pages.boot(self.epoch)
        self.lease.boot()
        self.sample = 0
        self.refused = 0
        self.auto, self.fault = True, False
        self._last: dict[wire.Kind, wire.Setpoint | wire.Mode | wire.Load] = {}
        self._law = self.settings.law_of(self.pages.running.gains)
        pv = self.plant.pv
        self._begun = is_reading(pv)
        self.blind = not self._begun
        try:
            co = self.plant.steady_co(pv, self.load)
        except ValueError:  # nothing holds this pv (restart in motion): begin at the lower limit
            co = self.settings.co_min
        self._begin(pv if self._begun else 0.0, co if math.isfinite(co) else self.settings.co_fault)
        self._manual_co = self.co

    def _begin(self, pv: float, co: float) -> None:
        """The law at rest at this pv, with this output; its first setpoint is pv, unless a host has given one."""
        low, high = self.settings.sp_min, self.settings.sp_max
        if wire.Kind.SETPOINT not in self._last:
            self.sp = min(max(pv, low), high)
        self.pv = pv if self._begun else self.sp
        first = start(self._law, self.sp, self.pv, co)
        self._state: StateTuple = first
        self.co = first.co

    @property
    def sample_time_s(self) -> float:
        """Controller sample time, s."""
        return self.settings.sample_time_s

    @property
    def running(self) -> GainSet:
        """The set that runs."""
        return self.pages.running

    def restart(self) -> None:
        """Power off and on: the plant goes on, the firmware begins anew from its store."""
        self.epoch = (self.epoch + 1) % EPOCHS
        self.code.boot()
        self._boot()

    def step(self, dt_s: float | None = None) -> list[can.Message]:
        """One controller sample of dt_s seconds (default: the sample time); the frames that it sends."""
        dt = self.settings.sample_time_s if dt_s is None else dt_s
        pv = self.plant.step(self.co, self.load, dt)
        seen = is_reading(pv)
        self.blind = not seen
        if seen and not self._begun:
            self._begun = True
            self._begin(pv, self.co)
        self.pv = pv if seen else self.pv
        frames: list[wire.DeviceFrame] = []
        # without a number nobody can tell what keeps co where it is: a swap waits for the next one
        acknowledge = (self.pages.swap() if seen else None) or self.pages.revert(seen=seen)
        if acknowledge is not None:
            frames.append(acknowledge)
            new = self.settings.law_of(self.running.gains)
            self._state = change(self._law, new, self._state, self.sp, self.pv, dt)
            self._law = new
        # The output of this sample: a fault before manual before automatic, which waits for a number
        pv = self._state[PV] if self.blind else self.pv
        if self.fault:
            at_once = replace(self._law, co_rate_per_s=None)
            self._state, self.co = track(at_once, self._state, self.sp, pv, self.settings.co_fault, dt)
        elif not self.auto:
            self._state, self.co = track(self._law, self._state, self.sp, pv, self._manual_co, dt)
        elif not self.blind:
            self._state, self.co = step(self._law, self._state, self.sp, pv, dt)
        self.sample = (self.sample + 1) % SAMPLE_WRAP
        if self.lease.tick():
            self.pages.drop_staged()
        counter = self.sample % (1 << COUNTER_BITS)
        mode = LoopMode.AUTO if self.auto else LoopMode.MANUAL
        low, high = PV_WIRE
        told = wire.TelemetryPv(counter, min(max(self.pv, low), high), co_steps(self.co) * CO_STEP)
        limited, running = int(self._state[LIMITED]), self.running.seq % wire.RUNNING_TAG
        crc = sample_crc(self.settings.node, told, wire.TelemetrySp(counter, self.sp, mode, limited, running, 0))
        frames += [told, wire.TelemetrySp(counter, self.sp, mode, limited, running, crc)]
        if self.sample % self.settings.heartbeat_samples == 0 or self.sample == 1:
            frames += self._life_sign()
        # What the plant measures beside pv, before the telemetry of its sample
        aux: float | None = getattr(self.plant, "aux", None)  # of a plant with a second measurement
        return [*([] if aux is None else [plant_message(self.settings.node, aux)]), *map(self._encode, frames)]

    def tell_fault(self, *, fault: bool) -> None:
        """The fault input changes."""
        self.fault = fault

    def stored(self, *, done: bool) -> list[can.Message]:
        """A set that was to be kept is there (done), or could not be written; the answer to STORE."""
        return [self._encode(answer) for answer in _some(self.pages.stored(done=done))]

    def receive(self, message: can.Message) -> list[can.Message]:
        """Take a frame from the bus; the frames that answer it. Anything whatsoever may come."""
        frame = self._codec.decode(message)
        if isinstance(frame, Refused):
            self.refused += frame.refusal is not Refusal.FOREIGN
            return []
        return [self._encode(answer) for answer in self._answer(frame)]

    def _encode(self, frame: wire.DeviceFrame) -> can.Message:
        """The frame as a message; an acknowledge tells in which epoch it was given."""
        if isinstance(frame, wire.Ack):
            frame = replace(frame, epoch=self.epoch % wire.EPOCH_TAG)
        return self._codec.encode(frame)

    def _answer(self, frame: wire.Frame) -> list[wire.DeviceFrame]:
        match frame:
            case wire.Read(page=wire.Page.IDENTITY):
                return [wire.Identity(wire.PROTOCOL_VERSION, schema(), self.settings.sample_time_s), *self._life_sign()]
            case wire.Read(page=wire.Page.CHALLENGE):
                return [wire.Challenge(frame.token % wire.CHALLENGE_TAG, int(self.code.demanded), self.code.nonce)]
            case wire.Read():
                return list(self.pages.read(frame))
            case wire.Lease():
                # Give, prolong or take back the lease; a page staged under one that ends is dropped
                before = self.lease.owner
                answer = self.lease.request(frame, self.epoch, self.sample)
                if self.lease.owner != before:
                    self.pages.drop_staged()
                return [answer]
            case wire.Abort():
                answer = self.pages.abort(frame)
                if answer.reason is wire.Reason.OK:
                    self.code.renew()
                return [answer]
            case wire.Stage() | wire.Commit() | wire.Auth() | wire.Confirm() | wire.Store():
                return _some(self._change(frame))
            case wire.Setpoint() | wire.Mode() | wire.Load():
                return [self._command(frame)]
            case _:  # a frame that only devices send: another device under this node's number
                self.refused += 1
                return []

    def _change(self, frame: wire.Stage | wire.Commit | wire.Auth | wire.Confirm | wire.Store) -> wire.Ack | None:
        """A step towards another running or stored set: for the owner of the lease alone."""
        lease, pages = self.lease, self.pages
        match frame:
            case wire.Stage():
                if lease.allows(frame.owner, wire.OWNER_TAG):
                    return pages.stage(frame)
                return wire.Ack(wire.Kind.STAGE, frame.seq, wire.Reason.NOT_OWNER, pages.latest, frame.item)
            case wire.Commit():  # its CRC covers the owner
                who = self.settings.node, self.epoch, lease.owner
                return pages.commit(frame, lease.owner, lambda f, gains: self.code.judge(*who, f.seq, f.base, gains))
            case wire.Auth():
                self.code.take(frame)
                return None
            case wire.Confirm():
                if lease.allows(frame.owner):
                    return pages.confirm(frame)
                return wire.Ack(wire.Kind.CONFIRM, frame.seq, wire.Reason.NOT_OWNER, pages.latest)
            case wire.Store():
                if lease.allows(frame.owner, wire.STORE_TAG):
                    return pages.store(frame)
                return wire.Ack(wire.Kind.STORE, frame.seq, wire.Reason.NOT_OWNER, pages.latest)

    def _command(self, frame: wire.Setpoint | wire.Mode | wire.Load) -> wire.Ack:
        """Act once on a newer frame, answer a repeated one again, refuse an older one."""
        settings = self.settings
        match frame:
            case wire.Setpoint():
                kind, inside = wire.Kind.SETPOINT, settings.sp_min <= frame.sp <= settings.sp_max
            case wire.Mode():
                inside = settings.co_min <= frame.co <= settings.co_max or frame.mode == LoopMode.AUTO
                kind = wire.Kind.MODE
            case wire.Load():
                kind, inside = wire.Kind.LOAD, True
        if not self.lease.allows(frame.owner):
            return wire.Ack(kind, frame.counter, wire.Reason.NOT_OWNER, frame.counter)
        last = self._last.get(kind)
        if last is not None and frame != last and not wire.newer(frame.counter, last.counter, COUNTER_BITS):
            return wire.Ack(kind, frame.counter, wire.Reason.STALE, last.counter)
        if not inside:
            return wire.Ack(kind, frame.counter, wire.Reason.OUT_OF_RANGE, frame.counter)
        if frame != last:
            self._last[kind] = frame
            match frame:
                case wire.Setpoint():
                    self.sp = frame.sp
                case wire.Mode():
                    self.auto, self._manual_co = frame.mode == LoopMode.AUTO, frame.co
                case wire.Load():
                    self.load = frame.load
        return wire.Ack(kind, frame.counter, wire.Reason.OK, frame.counter)

    def _life_sign(self) -> list[wire.DeviceFrame]:
        pages = self.pages
        flags = (
            wire.Flags.AUTO * self.auto
            + wire.Flags.STAGED * pages.has_staged
            + wire.Flags.STORED * pages.is_stored
            + wire.Flags.TRIAL * pages.on_trial
            + wire.Flags.OWNED * (self.lease.owner != NOBODY)
            + wire.Flags.WRONG_CODE * (self.code.wrong > 0)
            + wire.Flags.BLIND * self.blind
            + wire.Flags.FAULT * self.fault
        )
        return [
            wire.Heartbeat(self.sample, self.epoch, flags),
            wire.Status(self.running.seq, self.pages.latest, self.refused % wire.REFUSED_WRAP, self.lease.owner),
        ]


def is_reading(pv: float) -> bool:
    """Whether a sensor's value is a number that a frame can carry."""
    return PV_WIRE[0] <= pv <= PV_WIRE[1]


def _some(answer: wire.Ack | None) -> list[wire.DeviceFrame]:
    return [] if answer is None else [answer]
