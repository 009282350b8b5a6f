"""A controller that hangs on CAN, in software: PID firmware with its plant, frame by frame what a real one would do.

One call of step() is one controller sample: the plant moves, pv is read, a committed gain set is swapped in without a
bump, co is worked out and applied, telemetry goes out. receive() answers at once, as an interrupt would. Nothing here
reads a clock or a bus: device_process.py and the tests move frames and time.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import can

from retuner.adaptive.sample import LoopMode
from retuner.drivers.codec import Codec, Refusal, Refused, schema
from retuner.drivers.frames import (
    PROTOCOL_VERSION,
    Abort,
    Ack,
    Commit,
    DeviceFrame,
    Flags,
    Frame,
    Heartbeat,
    Identity,
    Kind,
    Load,
    Mode,
    Page,
    Read,
    Reason,
    Setpoint,
    Stage,
    Status,
    Store,
    TelemetryPv,
    TelemetrySp,
    newer,
)
from retuner.drivers.gain_box import GainBox
from retuner.drivers.gain_pages import GainPages, GainSet
from retuner.drivers.plant import Plant
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import LIMITED, PidLaw, StateTuple, change, law, start, step, track

Command = TypeVar("Command", Setpoint, Mode, Load)

CO_WIRE = (-100.0, 200.0)  # percent, range of co in retuner.dbc
SAMPLE_WRAP = 1 << 32
STATUS_WRAP = 1 << 16
COUNTER_BITS = 8


@dataclass(frozen=True, slots=True)
class VirtualDeviceSettings:
    """What is burnt into the firmware.

    Parameters
    ----------
    gains : set that runs until another is committed or found in the store.
    node : address on the bus, 1..63.
    sample_time_s : controller sample time in s.
    box : gains that the device accepts.
    sp_min, sp_max : setpoints that it accepts, pv units.
    co_min, co_max : range of the output, percent, within -100..200.
    co_rate_per_s : largest rate of the output, percent per second; None for no limit.
    b : setpoint weight. tau_f_s : filter time of the derivative, s.
    heartbeat_samples : samples between life signs.

    Raises
    ------
    ValueError
        A setting is outside its range (named).
    """

    gains: PidGains
    node: int = 1
    sample_time_s: float = 2.0
    box: GainBox = field(default_factory=GainBox)
    sp_min: float = -1e9
    sp_max: float = 1e9
    co_min: float = 0.0
    co_max: float = 100.0
    co_rate_per_s: float | None = None
    b: float = 1.0
    tau_f_s: float = 0.0
    heartbeat_samples: int = 5

    def __post_init__(self) -> None:
        if not 1e-4 <= self.sample_time_s <= 3600:
            raise ValueError(f"device: sample_time_s = {self.sample_time_s}; give 0.0001 to 3600 s")
        if not CO_WIRE[0] <= self.co_min < self.co_max <= CO_WIRE[1]:
            raise ValueError(f"device: co {self.co_min}..{self.co_max}; give a range within {CO_WIRE}")
        if not self.sp_min < self.sp_max:
            raise ValueError(f"device: sp_min = {self.sp_min} must be below sp_max = {self.sp_max}")
        if not 1 <= self.heartbeat_samples <= 100:
            raise ValueError(f"device: heartbeat_samples = {self.heartbeat_samples}; give 1 to 100")
        self.law_of(self.gains)

    def law_of(self, gains: PidGains) -> PidLaw:
        """The PID law with these gains."""
        return law(gains, b=self.b, tau_f_s=self.tau_f_s, co_min=self.co_min, co_max=self.co_max,
                   co_rate_per_s=self.co_rate_per_s)  # fmt: skip


class VirtualDevice:
    """The firmware at work on a plant.

    Parameters
    ----------
    settings : firmware.
    plant : what it controls; the loop starts at rest at the plant's pv, in auto.
    epoch : number of this boot, 0..65535; every restart takes the next one.
    """

    def __init__(self, settings: VirtualDeviceSettings, plant: Plant, epoch: int = 1) -> None:
        self.settings, self.plant = settings, plant
        self._codec = Codec(settings.node)
        self.pages = GainPages(settings.node, settings.box, settings.gains)
        self.epoch = epoch
        self.load = 0.0
        self._boot()

    def _boot(self) -> None:
        """State after power-on: in auto, at rest at the present pv."""
        self.pages.boot(self.epoch)
        self.sample = 0
        self.refused = 0
        self.sp = self.pv = self.plant.pv
        self.auto = True
        self._law = self.settings.law_of(self.pages.running.gains)
        try:
            co = self.plant.steady_co(self.pv, self.load)
        except ValueError:  # nothing holds this pv (restart in motion): begin at the lower limit
            co = self.settings.co_min
        first = start(self._law, self.sp, self.pv, co)
        self._state: StateTuple = first
        self.co = self._manual_co = first.co
        self._last: dict[Kind, Setpoint | Mode | Load] = {}

    @property
    def running(self) -> GainSet:
        """The set that runs."""
        return self.pages.running

    def restart(self) -> None:
        """Power off and on: the plant goes on, the firmware begins anew from its store."""
        self.epoch = (self.epoch + 1) % STATUS_WRAP
        self._boot()

    def step(self, dt_s: float | None = None) -> list[can.Message]:
        """One controller sample of dt_s seconds (default: the sample time); the frames that it sends."""
        dt = self.settings.sample_time_s if dt_s is None else dt_s
        self.pv = self.plant.step(self.co, self.load, dt)
        frames: list[DeviceFrame] = []
        acknowledge = self.pages.swap()
        if acknowledge is not None:
            frames.append(acknowledge)
            new = self.settings.law_of(self.running.gains)
            self._state = change(self._law, new, self._state, self.sp, self.pv, dt)
            self._law = new
        if self.auto:
            self._state, self.co = step(self._law, self._state, self.sp, self.pv, dt)
        else:
            self._state, self.co = track(self._law, self._state, self.sp, self.pv, self._manual_co, dt)
        self.sample = (self.sample + 1) % SAMPLE_WRAP
        frames += self._telemetry()
        if self.sample % self.settings.heartbeat_samples == 0 or self.sample == 1:
            frames += self._life_sign()
        return [self._codec.encode(frame) for frame in frames]

    def receive(self, message: can.Message) -> list[can.Message]:
        """Take a frame from the bus; the frames that answer it. Anything whatsoever may come."""
        frame = self._codec.decode(message)
        if isinstance(frame, Refused):
            self.refused += frame.refusal is not Refusal.FOREIGN
            return []
        answers = self._answer(frame)
        return [self._codec.encode(answer) for answer in answers]

    def _answer(self, frame: Frame) -> list[DeviceFrame]:
        """What the firmware says to a host's frame."""
        match frame:
            case Read(page=Page.IDENTITY):
                return [Identity(PROTOCOL_VERSION, schema(), self.settings.sample_time_s), *self._life_sign()]
            case Read():
                return list(self.pages.read(frame))
            case Stage():
                return _some(self.pages.stage(frame))
            case Commit():
                return _some(self.pages.commit(frame))
            case Abort():
                return [self.pages.abort(frame)]
            case Store():
                return [self.pages.store(frame)]
            case Setpoint():
                inside = self.settings.sp_min <= frame.sp <= self.settings.sp_max
                return [self._obey(Kind.SETPOINT, frame, inside=inside, act=self._take_setpoint)]
            case Mode():
                inside = self.settings.co_min <= frame.co <= self.settings.co_max or frame.mode == LoopMode.AUTO
                return [self._obey(Kind.MODE, frame, inside=inside, act=self._take_mode)]
            case Load():
                return [self._obey(Kind.LOAD, frame, inside=True, act=self._take_load)]
            case _:  # a frame that only devices send: another device under this node's number
                self.refused += 1
                return []

    def _obey(self, kind: Kind, frame: Command, *, inside: bool, act: Callable[[Command], None]) -> Ack:
        """Act once on a newer frame, answer a repeated one again, refuse an older one."""
        last = self._last.get(kind)
        if last is not None and frame != last and not newer(frame.counter, last.counter, COUNTER_BITS):
            return Ack(kind, frame.counter, Reason.STALE, last.counter)
        if not inside:
            return Ack(kind, frame.counter, Reason.OUT_OF_RANGE, frame.counter)
        if frame != last:
            self._last[kind] = frame
            act(frame)
        return Ack(kind, frame.counter, Reason.OK, frame.counter)

    def _take_setpoint(self, frame: Setpoint) -> None:
        self.sp = frame.sp

    def _take_mode(self, frame: Mode) -> None:
        self.auto = frame.mode == LoopMode.AUTO
        self._manual_co = frame.co

    def _take_load(self, frame: Load) -> None:
        self.load = frame.load

    def _telemetry(self) -> list[DeviceFrame]:
        """Both halves of this sample."""
        counter = self.sample % (1 << COUNTER_BITS)
        mode = LoopMode.AUTO if self.auto else LoopMode.MANUAL
        return [
            TelemetryPv(counter, self.pv, self.co),
            TelemetrySp(counter, self.sp, mode, int(self._state[LIMITED]), self.running.seq),
        ]

    def _life_sign(self) -> list[DeviceFrame]:
        """Heartbeat and status."""
        flags = Flags(0)
        flags |= Flags.AUTO if self.auto else Flags(0)
        flags |= Flags.STAGED if self.pages.has_staged else Flags(0)
        flags |= Flags.STORED if self.pages.is_stored else Flags(0)
        return [
            Heartbeat(self.sample, self.epoch, int(flags)),
            Status(self.running.seq, self.pages.latest, self.refused % STATUS_WRAP),
        ]


def _some(answer: Ack | None) -> list[DeviceFrame]:
    """An answer or none, as a list."""
    return [] if answer is None else [answer]
