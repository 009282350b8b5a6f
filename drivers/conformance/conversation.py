"""Speaking to a device frame by frame, as an examiner does: everything that may be said, and all that comes back."""

import secrets
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple, Protocol, TypeVar

import can

from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import Clock
from retuner.drivers.protocol import frames as wire
from retuner.drivers.protocol.authentication import code_frames, commit_code
from retuner.drivers.protocol.checksum import commit_crc, lease_stamp, page_crc, sample_crc, set_crc
from retuner.drivers.protocol.codec import COMMAND_BITS, Codec, Refusal, Refused
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

SEQUENCES, COUNTERS = 1 << 16, 1 << 8
LEASE_SAMPLES = 2000
PASSING = 400  # frames kept of what comes by itself: a hundred samples of two halves, with their life signs
UNKNOWN = PidGains(1.0, 0.0)  # before the device has said what it runs
NO_FLAGS = wire.Flags(0)
Answer = TypeVar("Answer", bound=wire.DeviceFrame)


class Counterpart(Protocol):
    """Where the device is: in the same thread, or on a bus."""

    def send(self, message: can.Message) -> None:
        """Put a frame on the bus."""

    def heard(self) -> list[can.Message]:
        """What has come since the last call, the answers to what was sent among it."""

    def sample(self) -> list[can.Message]:
        """One more controller sample passes; what has come."""

    def restart(self) -> bool:
        """Switch the device off and on; False when nobody can."""


class NoAnswerError(Exception):
    """The device does not say what an examination needs to go on; the message tells what was asked."""


class PageSeen(NamedTuple):
    """A page as it came: its gains by item, and its end."""

    items: dict[int, wire.PageItem]
    end: wire.PageEnd

    @property
    def values(self) -> tuple[float, ...]:
        """The gains that are there, in the order of their items."""
        return tuple(self.items[item].value for item in sorted(self.items))


@dataclass
class KnownOfDevice:
    """What the examiner knows of the device: its boot epoch, sample counter, and running set."""

    epoch: int = 0
    sample: int = 0
    seq: int = 0
    gains: PidGains = UNKNOWN
    latest: int = 0
    flags: wire.Flags = NO_FLAGS
    refused: int = 0
    owner: int = 0


class Conversation:
    """One examiner with one device.

    far : where the device is. node : its number. key : the secret for commits; None for none.

    passing : the last samples and life signs that came by themselves.
    spoilt : what was wrong in itself with frames that came, at whatever time.
    """

    def __init__(self, far: Counterpart, node: int, key: bytes | None = None) -> None:
        self.far, self.node, self.key = far, node, key
        self.codec = Codec(node)
        self.known = KnownOfDevice()
        self.owner = wire.OWNER_TAG * secrets.randbelow(1000) + 9
        self._counter = secrets.randbelow(COUNTERS)
        self._token = secrets.randbelow(wire.TOKENS)
        self.passing: deque[wire.Frame] = deque(maxlen=PASSING)
        self.spoilt: list[str] = []

    # what is said

    def decoded(self, messages: Sequence[can.Message]) -> list[wire.Frame]:
        """The device's frames among these; its heartbeats keep what is known up to date, and every CRC is looked at."""
        frames: list[wire.Frame] = []
        for message in messages:
            frame = self.codec.decode(message)
            if not isinstance(frame, Refused):
                frames.append(frame)
            elif frame.refusal is not Refusal.FOREIGN and not message.is_extended_id:
                self.spoilt.append(f"a frame of command 0x{message.arbitration_id & 31:02X}: {frame.refusal}")
        asked = any(isinstance(frame, wire.Identity) for frame in frames)  # a life sign is part of that answer
        for frame in frames:
            if isinstance(frame, wire.TelemetryPv | wire.TelemetrySp) or (
                isinstance(frame, wire.Heartbeat) and not asked
            ):
                self.passing.append(frame)
            if isinstance(frame, wire.Heartbeat):
                self.known.epoch, self.known.sample = frame.epoch, frame.sample
                self.known.flags = wire.Flags(frame.flags)
            elif isinstance(frame, wire.Status):
                self.known.latest, self.known.refused, self.known.owner = frame.latest, frame.refused, frame.owner
            elif isinstance(frame, wire.TelemetrySp):
                pv = next(self._halves(), None)
                right = pv is None or pv.counter != frame.counter or frame.crc == sample_crc(self.node, pv, frame)
                self.spoilt += [] if right else [f"the CRC-16 of sample {frame.counter}"]
        return frames

    def _halves(self) -> Iterator[wire.TelemetryPv]:
        """First halves of samples, the newest first."""
        return (frame for frame in reversed(self.passing) if isinstance(frame, wire.TelemetryPv))

    def last_before(self, counter: int) -> wire.TelemetryPv | None:
        """The first half of the sample before this one, if it has come."""
        return next((half for half in self._halves() if half.counter == (counter - 1) % COUNTERS), None)

    def newest(self) -> tuple[float, float]:
        """sp and co as they were told last; waits for a sample where none has come. NoAnswerError: none comes."""
        if not any(isinstance(frame, wire.TelemetrySp) for frame in self.passing):
            self.samples()
        sp = next((frame.sp for frame in reversed(self.passing) if isinstance(frame, wire.TelemetrySp)), None)
        pv = next(self._halves(), None)
        if sp is None or pv is None:
            raise NoAnswerError("no sample of two halves")
        return sp, pv.co

    def raw(self, message: can.Message) -> list[wire.Frame]:
        """Send bytes; what comes back."""
        self.far.send(message)
        return self.decoded(self.far.heard())

    def say(self, *frames: wire.Frame) -> list[wire.Frame]:
        """Send frames; what comes back."""
        for frame in frames:
            self.far.send(self.codec.encode(frame))
        return self.decoded(self.far.heard())

    def samples(self, count: int = 1) -> list[wire.Frame]:
        """Let so many controller samples pass; what comes meanwhile."""
        frames: list[wire.Frame] = []
        for _ in range(count):
            half = next(self._halves(), None)
            came = self.decoded(self.far.sample())
            if half is not None and not any(isinstance(frame, wire.TelemetryPv) for frame in came):
                came += self.decoded(self.far.sample())  # the second half of a sample that was there
            frames += came
            self.known.sample += 1
        return frames

    def ack(self, *frames: wire.Frame) -> wire.Ack | None:
        """The first acknowledge of the last frame's kind that comes back."""
        return first_ack(self.say(*frames), wire.Kind[type(frames[-1]).__name__.upper()])

    def reason(self, *frames: wire.Frame) -> wire.Reason | None:
        """What it says; None for nothing."""
        return reason_of(self.ack(*frames))

    # what is asked

    def one(self, wanted: type[Answer], page: int) -> Answer:
        """The answer to a question. Raises NoAnswerError: there is none."""
        found = [frame for frame in self.say(wire.Read(page, self.token())) if isinstance(frame, wanted)]
        if not found:
            raise NoAnswerError(f"no {wanted.__name__} after READ of page {wire.Page(page).name.lower()}")
        return found[-1]

    def look(self) -> None:
        """Ask who is there and what runs; NoAnswerError when it is not told."""
        self.one(wire.Identity, wire.Page.IDENTITY)
        page = self.page(wire.Page.RUNNING)
        try:
            self.known.seq, self.known.gains = page.end.seq, PidGains(*page.values)
        except (TypeError, ValueError):
            raise NoAnswerError("READ of the running page gives no complete set") from None

    def page(self, page: wire.Page, token: int | None = None) -> PageSeen:
        """A page; NoAnswerError without its end."""
        asked = self.token() if token is None else token
        frames = self.say(wire.Read(page, asked))
        ends = [frame for frame in frames if isinstance(frame, wire.PageEnd)]
        if not ends:
            raise NoAnswerError(f"no PAGE after READ of page {page.name.lower()}")
        seen = PageSeen({frame.item: frame for frame in frames if isinstance(frame, wire.PageItem)}, ends[-1])
        # the CRC of a complete set that runs or is staged must be that of its gains
        complete = seen.end.complete and len(seen.items) == len(wire.Item)
        if page in {wire.Page.RUNNING, wire.Page.STAGED} and complete:
            gains = None
            with suppress(ValueError):  # what no PID runs is shown as it is
                gains = PidGains(*seen.values)
            crc = None if gains is None else set_crc(self.node, self.known.epoch, seen.end.seq, gains)
            if crc is not None and seen.end.crc != page_crc(crc, asked):
                self.spoilt.append(f"the CRC of the {page.name.lower()} page")
        return seen

    def token(self) -> int:
        """A new one."""
        self._token = (self._token + 1) % wire.TOKENS
        return self._token

    def counter(self, ahead: int = 1) -> int:
        """The next counter of a command."""
        self._counter = (self._counter + ahead) % COUNTERS
        return self._counter

    # sets and leases

    def lease(self, samples: int = LEASE_SAMPLES, owner: int | None = None) -> wire.Lease:
        """A request for the lease with a right stamp and a new counter."""
        stamp = lease_stamp(self.known.epoch, self.known.sample)
        return wire.Lease(owner or self.owner, stamp, samples, self.counter())

    def own(self) -> None:
        """Take the lease, whatever counters were used before; NoAnswerError when it is not given."""
        for _ in range(3):
            self.one(wire.Identity, wire.Page.IDENTITY)
            if self.reason(self.lease()) is wire.Reason.OK:
                return
            self.counter(100)
        raise NoAnswerError("the device does not grant the lease; is another host connected?")

    def fresh_seq(self) -> int:
        """A number newer than all that the device has seen."""
        self.one(wire.Identity, wire.Page.IDENTITY)
        return (self.known.latest + 1) % SEQUENCES

    def stage(self, seq: int, gains: PidGains) -> list[wire.Frame]:
        """The frames that stage a set."""
        values = zip(wire.Item, (gains.kp, gains.ki, gains.kd), strict=True)
        return [wire.Stage(item, self.owner % wire.OWNER_TAG, value, seq) for item, value in values]

    def commit(self, seq: int, gains: PidGains, *, base: int | None = None, **wrong: int) -> wire.Commit:
        """The commit of a set; base and what the CRC covers (epoch, node, owner) may be made wrong."""
        on = self.known.seq if base is None else base
        node, epoch = wrong.get("node", self.node), wrong.get("epoch", self.known.epoch)
        return wire.Commit(seq, on, commit_crc(set_crc(node, epoch, seq, gains), on, wrong.get("owner", self.owner)))

    def codes(self, seq: int, gains: PidGains, key: bytes | None = None) -> list[wire.Frame]:
        """The code of a commit, over the device's present challenge; nothing without a key."""
        if self.key is None:
            return []
        nonce, known = self.one(wire.Challenge, wire.Page.CHALLENGE).nonce, self.known
        code = commit_code(key or self.key, self.node, known.epoch, nonce, self.owner, seq, known.seq, gains)
        return [*code_frames(code, seq)]

    def write(self, gains: PidGains) -> tuple[int, list[wire.Frame]]:
        """Stage and commit a set, and let a sample pass; its number, and what came."""
        seq = self.fresh_seq()
        frames = self.say(*self.stage(seq, gains), *self.codes(seq, gains), self.commit(seq, gains))
        frames += self.samples()
        self.look()
        return seq, frames


def first_ack(frames: Sequence[wire.Frame], kind: wire.Kind) -> wire.Ack | None:
    """The first acknowledge of a kind."""
    return next((frame for frame in frames if isinstance(frame, wire.Ack) and frame.kind == kind), None)


def reason_of(ack: wire.Ack | None) -> wire.Reason | None:
    """What an acknowledge says; None for none."""
    return None if ack is None else wire.Reason(ack.reason)


# ---- Where the examined device is: an object in this thread, or a node on a bus in real time

READ, TELEMETRY_SP = 0x02, 0x13
LOOK_S = 0.03  # longest sleep
LEAST_S = 0.3  # longest wait for an answer, at least: an operating system lets a process wait that long
SAMPLES = 1.5  # and in samples: a device answers within one


class OnBus:
    """A node on a bus.

    It answers within one controller sample, in the order in which it was asked. So behind every question goes one that
    is always answered, by CHALLENGE: when that has come, nothing more is to be waited for.

    link : open bus of its own. clock : the machine's, in real seconds. node : the device's.
    sample_s : real seconds of a controller sample.
    restart : lets somebody switch the device off and on; whether that was done.
    """

    def __init__(
        self, link: CanLink, clock: Clock, node: int, sample_s: float, restart: Callable[[], bool] = lambda: False
    ) -> None:
        self._link, self._clock, self._node, self._sample_s = link, clock, node, sample_s
        self._codec, self._ask = Codec(node), restart
        self._tokens: set[int] = set()

    def send(self, message: can.Message) -> None:
        """Put it on the bus."""
        if message.arbitration_id & 31 == READ and len(message.data) > 1:
            self._tokens.add(message.data[1] % wire.CHALLENGE_TAG)
        self._link.send(message)

    def heard(self) -> list[can.Message]:
        """What comes until all that was sent is answered."""
        token = next(token for token in range(wire.CHALLENGE_TAG) if token not in self._tokens)
        self._tokens.clear()
        self._link.send(self._codec.encode(wire.Read(wire.Page.CHALLENGE, token)))
        messages = self._listen(max(SAMPLES * self._sample_s, LEAST_S), lambda m: self._is_last(m, token))
        return [message for message in messages if not self._is_last(message, token)]

    def _is_last(self, message: can.Message, token: int) -> bool:
        frame = self._codec.decode(message)
        return not isinstance(frame, Refused) and isinstance(frame, wire.Challenge) and frame.token == token

    def sample(self) -> list[can.Message]:
        """What comes until a whole sample has come."""
        return self._listen(4 * self._sample_s + 1.0, lambda m: m.arbitration_id & 31 == TELEMETRY_SP)

    def restart(self) -> bool:
        """Ask for it; what was heard of the time before is forgotten."""
        done = self._ask()
        self._link.receive_all()
        return done

    def _listen(self, for_s: float, last: Callable[[can.Message], bool]) -> list[can.Message]:
        """The node's frames until one is the last, or the time is over."""
        until_s, found, ended = self._clock.now_s() + for_s, list[can.Message](), False
        while not ended and self._clock.now_s() < until_s:
            self._link.wait_until(min(until_s, self._clock.now_s() + LOOK_S))
            for message in self._link.receive_all():
                if message.arbitration_id >> COMMAND_BITS == self._node and not message.is_extended_id:
                    found.append(message)
                    ended = ended or last(message)
        return found
