"""A controller that is not ours, as a device: samples by arrival, gains by its own messages, its own word heard.

It promises less than the native protocol, and what it promises depends on the controller: see docs/devices.md. What is
the same: everything happens in poll(), nothing blocks, gains in force are those that were read back (or, where the user
has accepted it, those that were sent), and a write that goes wrong is taken back and told.

At which sample a value belongs, for devices that send no sample counter: by the time of its arrival.

Sample n stands at origin + n sample times. Where the controller sends at its own pace, the origin follows the arrivals
slowly, so that neither jitter nor clocks that differ a little lose or invent samples; where it is asked, the host's
clock is the pace.
"""

import math
import zlib
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.drivers.bus.link_settings import FramePort
from retuner.drivers.device import (
    CommandDone,
    CommandFailed,
    Contact,
    DeviceMismatchError,
    DeviceRestarted,
    DeviceSilentError,
    DeviceStopped,
    Event,
    LinkChanged,
    LinkState,
    RunningChanged,
    RunningSet,
    SamplesLost,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
    WriteUnknown,
)
from retuner.drivers.profiles.bench_loop import load_frame
from retuner.drivers.profiles.controller_access import (
    Access,
    Acknowledged,
    Denied,
    Doubted,
    Heard,
    NoFault,
    Started,
    Stopped,
    Told,
)
from retuner.drivers.profiles.gain_course import GainCourse
from retuner.drivers.recorded.sample_note import NOTES, note_of
from retuner.drivers.telemetry.signal_source import ScheduleInputs, SignalTap
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.regions import CAN

TIMES = ("sample_time_s", "reply_s", "silent_s", "connect_s", "feed_s", "look_s")


@dataclass(frozen=True, slots=True)
class ForeignSettings:
    """What the host knows of a foreign controller beside its numbers: its pace, its ranges, its patience.

    gains : set that it is believed to run where it cannot be asked.
    where : the device in words. sample_time_s : time between samples, s. variable : as CanDeviceSettings.
    co_min, co_max : range of the output, percent. sp_start : setpoint until one was sent, where it reports none.
    reply_s : longest wait for an answer. silent_s : age of the last frame at which it counts as silent. connect_s :
    longest wait for the first connection. feed_s : the setpoint is sent again after so long, which feeds a watchdog.
    look_s : its gains are read again after so long. closed : why gains are never written, "" when they are.
    bench_node : number of a virtual one, which takes loads; None for a real one. after_s : as CanDevice.
    note_id : identifier under which its samples are noted in the log (sample_note.py).

    Raises ValueError: a time is not a positive finite number.
    """

    gains: PidGains
    where: str = "device"
    sample_time_s: float = 1.0
    variable: str | ScheduleInputs = "sp"
    co_min: float = 0.0
    co_max: float = 100.0
    sp_start: float = 0.0
    reply_s: float = 0.5
    silent_s: float = 6.0
    connect_s: float = 20.0
    feed_s: float = 1e9
    look_s: float = 60.0
    closed: str = ""
    bench_node: int | None = None
    after_s: float | None = None
    note_id: int = NOTES

    def __post_init__(self) -> None:
        for name in TIMES:
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"device: {name} = {getattr(self, name)}; give a positive number of seconds")


# ---- At which sample a value belongs, for devices that send no sample counter

FOLLOW = 0.05
"""Share of an arrival's distance from its place by which the origin moves: jitter of one arrival does little."""
EARLY = 0.5  # samples by which an arrival may be early and still be the next one
ROUNDING = 1e-9
LOOKED_AT = 16  # Samples that were due over which it is looked whether half of them are lost
PAUSE = 8  # more samples lost at once than this are a silence, and say nothing of the pace


class SampleGrid:
    """See the head of this file.

    sample_time_s : in s. asked : the host's clock is the pace. after_s : samples come behind this time.
    """

    def __init__(self, sample_time_s: float, *, asked: bool = False, after_s: float | None = None) -> None:
        self._sample_time_s, self._asked = sample_time_s, asked
        self._origin_s: float | None = None
        self._last = 0 if after_s is None else math.floor(after_s / sample_time_s)
        self._due = self._taken = 0
        self._told = self._seen = False

    def due(self, now_s: float) -> bool:
        """Whether the next sample is to be taken, or asked for."""
        if self._origin_s is None:
            return True
        early = 0.0 if self._asked else EARLY
        return now_s >= self._origin_s + (self._last + 1 - early) * self._sample_time_s - ROUNDING

    def place(self, now_s: float) -> tuple[float, int] | None:
        """The time of the sample that arrives now, and how many before it never came; None when none is due."""
        if self._origin_s is None:
            self._origin_s = now_s - (self._last + 1) * self._sample_time_s
        if not self.due(now_s):
            return None
        places = (now_s - self._origin_s) / self._sample_time_s
        number = max(round(places) if not self._asked else math.floor(places + ROUNDING), self._last + 1)
        if not self._asked:
            self._origin_s += FOLLOW * (places - number) * self._sample_time_s
        lost = number - self._last - 1
        self._last = number
        # Count what was due and what came since the sample with which the count began
        if self._due >= LOOKED_AT or lost > PAUSE:
            self._due = self._taken = 0
        if lost <= PAUSE and self._seen:
            self._due += 1 + lost
            self._taken += 1
        self._seen = True
        return number * self._sample_time_s, lost

    def half_lost(self) -> str:
        """Why half of all samples are lost, told once until three of four come; "" for fewer, or not known yet."""
        self._told &= self._due < LOOKED_AT or 4 * self._taken < 3 * self._due
        if self._told or self._due < LOOKED_AT or 2 * self._taken > self._due:
            return ""
        self._told = True
        every_s = self._sample_time_s * self._due / self._taken
        asked = "they are asked for one by one: let the device send them by itself (CANopen: in a PDO), or "
        here = f"sample_time_s is {self._sample_time_s:g} s; {asked if self._asked else ''}set it to that"
        return f"half of all samples are lost: one comes every {every_s:.3g} s, {here}, or lower --speed on a bench"


Numbers = Mapping[str, float]
ChooseWay = Callable[[Numbers, Numbers, bool], tuple[int, ...]]
"""Old and new numbers, and whether it is the way back: the messages in their order; WriteRefusedError when none is."""
SEQUENCES = 1 << 16
AT_LIMIT = 1e-6  # Share of the output's range within which it counts as standing at the limit
AGAIN = 0.75  # samples after which a question that nothing has answered is put again
TOGETHER = 0.5  # samples within which values of one sample come

AGREED = 3  # whole sets that are read without a second answer before anything is believed again
ANSWERS_A_POLL = 16  # questions and answers in one poll, where the answer comes at once


def any_way(old: Numbers, new: Numbers, back: bool) -> tuple[int, ...]:
    """Nobody proves anything here: only what is one message, or the way back, may be written."""
    del old, new
    if back:
        return ()
    raise WriteRefusedError("the set takes several messages, and the sets in between are not proved")


class Value(NamedTuple):
    """A number, and when it came."""

    value: float
    at_s: float


class ForeignDevice:
    """See the head of this file; device.Device says what its methods promise.

    link : open bus. access : the controller's numbers. settings : see there.
    """

    def __init__(self, link: FramePort, access: Access, settings: ForeignSettings) -> None:
        self.link, self.settings = link, settings
        self.choose_way: ChooseWay = any_way
        self.fits: Callable[[PidGains], bool] = lambda _: True  # whatever runs at first is as it should be
        self.running: RunningSet | None = None
        self._access = access
        self._grid = SampleGrid(settings.sample_time_s, asked="pv" in access.on_request, after_s=settings.after_s)
        inputs = ScheduleInputs.of(settings.variable)
        self._inputs, self._tap = inputs, SignalTap(inputs.signals)
        self._contact = Contact(settings.silent_s, settings.connect_s)
        self._course = GainCourse(
            acknowledges=access.acknowledges, reads_back=access.reads_back, reply_s=settings.reply_s
        )
        self._numbers: Numbers | None = None  # what runs, in the controller's units
        self._read: dict[str, float] = {}  # read since the last question
        self._fresh: dict[str, Value] = {}  # heard since the last sample
        self._latest: dict[str, float] = {}
        self._setpoint: float | None = None
        self._asked_setpoint = False
        self._stopped: dict[str, str] = {}  # reasons by what tells them
        self._up = self._there = False
        self._ask_s = self._feed_s = self._again_s = -math.inf
        self._seq = 0
        self._agreed = AGREED  # sets read since two answers differed
        self._boots = 0
        self._now_s = -math.inf
        self._events: list[Event] = []

    @property
    def connected(self) -> bool:
        """Whether the device is heard and its running set known (or believed, where it cannot be read)."""
        return self._up and self.running is not None

    @property
    def writing(self) -> bool:
        """Whether a write is under way or its result unknown."""
        return self._course.busy

    def poll(self, now_s: float) -> list[Event]:
        """Take what has arrived, send what is due, tell what happened: see device.Device."""
        self._now_s = now_s
        for _ in range(ANSWERS_A_POLL):
            for message in self.link.receive_all():
                self._tap.take(message)
                for one in self._access.take(message):
                    self._there = True
                    self._take(one, now_s)
            self._notice_silence(now_s)
            self._connect(now_s)
            self._write_on(now_s)
            self._ask(now_s)
            # Send the setpoint again, for a watchdog
            if self._setpoint is not None and now_s >= self._feed_s:
                self._feed_s = now_s + self.settings.feed_s
                self._access.put({"setpoint": self._setpoint})
            if not self._send_due(now_s):
                break
        events, self._events = self._events, []
        return events

    def _take(self, told: Told, now_s: float) -> None:
        match told:
            case Heard():
                self._hear(told.name, told.value, now_s)
            case Stopped():
                if not self._stopped:  # told once, until it controls again
                    self._events.append(DeviceStopped(told.reason))
                self._stopped[told.source] = told.reason
            case NoFault():
                self._stopped.pop(told.source, None)
            case Started():
                self._course.on_restart()  # what it runs is to be read again, or sent again
                self._boots += 1
                if self.running is not None:
                    self.running = None
                    self._read.clear()
                    self._ask_s = -math.inf
            case Doubted():
                self._agreed = 0
                self._read.clear()
                if self._up:
                    self._lose(
                        LinkState.SILENT,
                        f"two answers about {told.name} differ (a second node of this number? another master?); "
                        "nothing is believed or written until they agree",
                    )
            case Acknowledged(name="setpoint"):
                self._events += [CommandDone("setpoint")] * self._asked_setpoint
                self._asked_setpoint = False
            case Acknowledged():
                self._course.on_acknowledged(told.name)
            case Denied(name="setpoint"):
                self._events += [CommandFailed("setpoint", told.reason)] * self._asked_setpoint
                self._asked_setpoint = False
            case Denied():
                self._course.on_refused(told.name, told.reason)
            case _:
                pass

    def _hear(self, name: str, value: float, now_s: float) -> None:
        """A number: of a gain that is being read, or of the loop."""
        if name in self._access.units.names:
            self._read[name] = value
            if len(self._read) == len(self._access.units.names):
                read, self._read = self._read, {}
                self._on_gains(read)
            return
        first = name == "pv" and self._grid.due(now_s)
        self._latest[name] = value
        if name == "pv":
            self._contact.heard_s = now_s
        if name in {"pv", "co"}:
            self._fresh[name] = Value(value, now_s)
        if first and "pv" not in self._access.on_request:
            self._access.ask(self._access.on_request)
        # The sample, once pv and co of about the same time are here and one is due
        if not self.connected or self.running is None or self._fresh.keys() < {"pv", "co"}:
            return
        pv, co = self._fresh["pv"], self._fresh["co"]
        if abs(pv.at_s - co.at_s) > TOGETHER * self.settings.sample_time_s:
            self._fresh.pop("pv" if pv.at_s < co.at_s else "co")
            return
        placed = self._grid.place(max(pv.at_s, co.at_s))
        if placed is None:
            return
        self._fresh.clear()
        self._again_s = -math.inf
        t_s, lost = placed
        self._events += [SamplesLost(lost, t_s, self._grid.half_lost())] if lost else []
        changes = self._tap.news()
        sample = self._tap.fill(self._as_sample(t_s, pv.value, co.value, self.running.seq))
        self.link.note(note_of(sample, self.settings.note_id))
        self._events += [*changes, sample]

    def _as_sample(self, t_s: float, pv: float, co: float, seq: int) -> LoopSample:
        """The sample, without what comes from other signals on the bus."""
        s = self.settings
        sp = self._latest.get("sp", self._setpoint if self._setpoint is not None else s.sp_start)
        auto = self._latest.get("mode", 1.0) and not self._stopped
        near = AT_LIMIT * (s.co_max - s.co_min)
        limited = (co >= s.co_max - near) - (co <= s.co_min + near)
        known = {"sp": sp, "pv": pv, "co": co, CAN: math.nan, "": 0.0}
        x, x2 = known[self._inputs.variable], known[self._inputs.variable2]
        return LoopSample(t_s, sp, pv, co, LoopMode.AUTO if auto else LoopMode.MANUAL, limited, x, seq, x2)

    def _on_gains(self, numbers: Numbers) -> None:
        self._agreed += 1
        if self._agreed <= AGREED:
            return
        busy = self._course.busy
        self._course.on_read(numbers)
        if busy:
            self._conclude()
            return
        if self.running is not None and self._numbers == numbers:
            return
        known = self.running is not None
        self._believe(numbers)
        if known and self.running is not None:
            self._events.append(RunningChanged(self.running))

    def _believe(self, numbers: Numbers) -> None:
        try:
            gains = self._access.units.of(numbers)
        except ValueError as error:
            if not self._contact.made:
                told = ", ".join(f"{name} = {value:g}" for name, value in numbers.items())
                raise DeviceMismatchError(f"{self.settings.where}: it runs {told}: {error}") from None
            self._lose(LinkState.SILENT, f"what it runs is no controller: {error}")
            return
        self._seq = (self._seq + 1) % SEQUENCES
        self._numbers = dict(numbers)
        packed = ",".join(f"{name}={value!r}" for name, value in sorted(numbers.items()))
        self.running = RunningSet(self._seq, gains, zlib.crc32(packed.encode()))

    def _connect(self, now_s: float) -> None:
        """The first connection, or another one: heard, and the gains known."""
        if not self._hears(now_s):
            return
        if self.running is None and not self._access.reads_back:
            try:
                self._believe(self._numbers or self._access.units.numbers(self.settings.gains))
            except ValueError as error:
                raise DeviceMismatchError(f"{self.settings.where}: the configured gains: {error}") from None
            if not self.settings.closed and self._numbers is not None:
                self._access.put(self._numbers)  # nobody can say what runs: what is sent does
        if self.running is None:
            return
        unproved = not (self._access.units.atomic or self.settings.closed or self.fits(self.running.gains))
        if unproved and not self._contact.made:
            gains = self.running.gains
            shown = f"kp = {gains.kp:.6g}, ki = {gains.ki:.6g}, kd = {gains.kd:.6g}"
            raise DeviceMismatchError(
                f"{self.settings.where}: it runs {shown} (parallel), which no region has; gains of several messages "
                "are not written over unknown ones; give the region the gains that it runs (retuner export --into "
                'writes tuned ones there), or [device] accept = ["unproved_order"]'
            )
        if self._boots and self._contact.made:
            self._events.append(DeviceRestarted(self._boots, self.running))
        self._boots = 0
        if not self._up:
            self._up = self._contact.made = True
            known = "active gains read back" if self._access.reads_back else "gains assumed, cannot be read back"
            self._events.append(LinkChanged(LinkState.UP, f"controller found, {known}"))

    def _hears(self, now_s: float) -> bool:
        """Whether the controller is heard just now, its gains known or not."""
        return now_s - self._contact.heard_s <= self.settings.silent_s and self.link.state is not LinkState.DOWN

    def _notice_silence(self, now_s: float) -> None:
        """Notice that nothing was heard for too long, or that there is no bus."""
        reason = self._contact.lost(now_s, self.link.state)
        if not self._up:
            if self._contact.in_vain(now_s):
                what = "no frame of it"
                if self._there:
                    heard = self._contact.heard_s > -math.inf
                    what = "it is there, but its gains could not be read" if heard else "it is there, but no pv came"
                raise DeviceSilentError(
                    f"{self.settings.where}: {what} within {self.settings.connect_s:g} s of the loop's time; "
                    "is the device running there, and is this its description?"
                )
            return
        if reason:
            self._lose(LinkState.DOWN if self.link.state is LinkState.DOWN else LinkState.SILENT, reason)

    def _lose(self, state: LinkState, reason: str) -> None:
        self._up, self.running = False, None
        self._fresh.clear()
        self._read.clear()
        self._latest.pop("mode", None)
        self._stopped.clear()
        self._access.forget()
        self._course.leave(reason)
        self._ask_s = -math.inf
        self._events.append(LinkChanged(state, reason))

    def _ask(self, now_s: float) -> None:
        """Ask for the gains: at first, and now and then; and for the loop's numbers that come on request only."""
        access, fresh = self._access, self._fresh
        asks = "pv" in access.on_request and now_s >= self._again_s
        if (
            asks
            and self._grid.due(now_s)
            and all(now_s - v.at_s >= self.settings.sample_time_s for v in fresh.values())
        ):
            # no half of a sample is there that its other half may still come to; an older one (of before the gains were
            # known, or whose other half was lost) is given up, or nothing would ever be asked for again
            fresh.clear()
            self._again_s = now_s + AGAIN * self.settings.sample_time_s
            access.ask(access.on_request)
        if not access.reads_back or self._course.busy or now_s < self._ask_s:
            return
        self._ask_s = now_s + (self.settings.look_s if self.running is not None else self.settings.reply_s)
        self._read.clear()
        access.ask(access.units.names)

    def _write_on(self, now_s: float) -> None:
        """What the write under way wants to send; after a silence it asks what runs, and only then is it connected."""
        sending = self._course.due(now_s) if self._up or (self._access.reads_back and self._hears(now_s)) else None
        if sending is not None:
            if sending.write:
                self._access.put(sending.write)
            if sending.read:
                self._read.clear()
                self._access.ask(self._access.units.names)
        unknown = self._course.unknown()
        if unknown:
            self._events.append(WriteUnknown(self._seq, unknown))
        self._conclude()

    def _conclude(self) -> None:
        outcome, self._course.outcome = self._course.outcome, None
        if outcome is None:
            return
        self._believe(outcome.numbers)
        if self.running is None:
            return
        if not self._up:  # first that it is there again, then what became of the write
            self._connect(self._now_s)
        done = WriteDone(self._seq, self.running.gains, self.running)
        self._events.append(done if outcome.done else WriteFailed(self._seq, outcome.reason, self.running))

    def _send_due(self, now_s: float) -> bool:
        """Put on the bus what is due; whether there was anything, which may be answered at once."""
        frames = self._access.due(now_s)
        for frame in frames:
            self.link.send(frame)
        return bool(frames)

    def begin_write(self, gains: PidGains, now_s: float, *, back: bool = False) -> int:
        """Start to write a set, message by message: see device.Device."""
        if self.settings.closed:
            raise WriteRefusedError(f"{self.settings.where}: {self.settings.closed}")
        if not self.connected or self._numbers is None:
            raise WriteRefusedError(f"{self.settings.where}: not connected, what runs is unknown; wait")
        if self._course.busy:
            raise WriteRefusedError(f"{self.settings.where}: a write is under way")
        units, old = self._access.units, self._numbers
        try:
            new = units.numbers(gains)
            order: Iterable[int] = () if units.atomic else self.choose_way(old, new, back)
        except (ValueError, WriteRefusedError) as error:
            raise WriteRefusedError(f"{self.settings.where}: {error}") from None
        changed = {gain.message for gain in units.gains if old[gain.quantity] != new[gain.quantity]}
        self._course.begin([units.of_message(message, new) for message in order or sorted(changed)], old, new)
        self._write_on(now_s)
        self._send_due(now_s)
        return self._seq

    def send_setpoint(self, sp: float, now_s: float) -> None:
        """Set the target in pv units: see device.Device. What it stands at anyhow needs no place to be written to."""
        if sp == self.settings.sp_start and not self._access.takes_setpoint:
            self._events.append(CommandDone("setpoint"))
            return
        numbers = {"setpoint": sp}
        if not all(map(math.isfinite, numbers.values())):
            raise WriteRefusedError(f"{self.settings.where}: {numbers} are not finite numbers")
        try:
            self._access.put(numbers)
        except ValueError as error:
            raise WriteRefusedError(f"{self.settings.where}: {error}") from None
        self._send_due(now_s)
        self._setpoint, self._feed_s = sp, now_s + self.settings.feed_s
        if self._access.acknowledges:
            self._asked_setpoint = True
        else:
            self._events.append(CommandDone("setpoint"))

    def send_mode(self, *, auto: bool, co: float, now_s: float) -> None:
        """Refused: a foreign controller's modes are its own, and switching them may start a motor."""
        del auto, co, now_s
        raise WriteRefusedError(f"{self.settings.where}: retuner cannot switch its mode; switch it at the device")

    def send_load(self, load: float, now_s: float) -> None:
        """Disturb a simulated plant, percent of co: see device.Device."""
        del now_s
        node = self.settings.bench_node
        if node is None or not math.isfinite(load):
            raise WriteRefusedError(f"{self.settings.where}: load = {load:g}: only a virtual device takes one")
        self.link.send(load_frame(node, load))
        self._events.append(CommandDone("load"))

    def store(self, now_s: float) -> None:
        """Refused: when and where a foreign controller stores is its own business."""
        del now_s
        raise WriteRefusedError(f"{self.settings.where}: retuner cannot store its gains; store them at the device")

    def confirm(self, now_s: float) -> bool:
        """Do nothing: no set waits for a confirmation here."""
        del now_s
        return True

    def release(self, now_s: float) -> None:
        """Nobody had reserved the controller."""
        del now_s
