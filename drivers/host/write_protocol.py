"""The two-phase write of a gain set, host side, as a state machine without bus or clock.

    STAGE    three frames: kp, ki or kd as float32, each with the set's number and this host's tag    WriteOrder.stage
    COMMIT   one frame: makes that set run; its number, that of the set before, a CRC-32 over both    WriteOrder.commit

    IDLE -> CLAIMING -> STAGING -> COMMITTING -> READING -> IDLE      the good way
    any trouble -> FENCING -> READING -> IDLE                         every other way

CLAIMING ends as soon as this host holds the lease. Where it does not, it asks for it once, ahead of the gains. A host
that was busy for long has lost the lease without knowing: it takes it again, and stages anew under another number.
STAGING sends the gains and reads them back as they stand in the device; it may be repeated, for nothing runs yet.
COMMITTING sends one commit and never repeats it. A refusal, a lost acknowledge, a restart: all lead to FENCING, which
burns the sequence number in the device, so that no late copy of the commit can take effect afterwards. READING then
asks what runs, and only that answer decides between done and failed. While the device is silent, FENCING and READING go
on asking and the result is unknown, and said to be.
"""

from enum import Enum

from retuner.drivers.device import RunningSet, WriteDone, WriteFailed, WriteUnknown
from retuner.drivers.host.page_reader import PageReader, ReadBack
from retuner.drivers.protocol import frames as wire
from retuner.drivers.protocol.authentication import code_frames, commit_code
from retuner.drivers.protocol.checksum import commit_crc, set_crc
from retuner.drivers.state_machine import StateMachine
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace


class WritePhase(Enum):
    """Where a write stands."""

    IDLE = "idle"
    CLAIMING = "claiming"
    STAGING = "staging"
    COMMITTING = "committing"
    FENCING = "fencing"
    READING = "reading"


class WriteInput(Enum):
    """What can happen to it."""

    BEGIN = "begin"
    OWNED = "this host holds the lease"
    LAPSED = "the lease ran out, and with it what was staged"
    STAGED_RIGHT = "staged page read back right"
    STAGED_WRONG = "staged page read back wrong"
    ACCEPTED = "commit acknowledged"
    REFUSED = "refused by the device"
    TIMEOUT = "no answer, another try is left"
    EXHAUSTED = "no answer, no try is left"
    RESTARTED = "device restarted"
    FENCED = "abort acknowledged"
    RUNNING_READ = "active gains read back"


P, W = WritePhase, WriteInput
TRANSITIONS: dict[tuple[WritePhase, WriteInput], WritePhase] = {
    (P.IDLE, W.BEGIN): P.CLAIMING,
    (P.CLAIMING, W.OWNED): P.STAGING,
    (P.CLAIMING, W.REFUSED): P.FENCING,
    (P.CLAIMING, W.TIMEOUT): P.CLAIMING,
    (P.CLAIMING, W.EXHAUSTED): P.FENCING,
    (P.CLAIMING, W.RESTARTED): P.FENCING,
    (P.STAGING, W.LAPSED): P.CLAIMING,
    (P.STAGING, W.STAGED_RIGHT): P.COMMITTING,
    (P.STAGING, W.STAGED_WRONG): P.STAGING,
    (P.STAGING, W.TIMEOUT): P.STAGING,
    (P.STAGING, W.EXHAUSTED): P.FENCING,
    (P.STAGING, W.REFUSED): P.FENCING,
    (P.STAGING, W.RESTARTED): P.FENCING,
    (P.COMMITTING, W.LAPSED): P.CLAIMING,
    (P.COMMITTING, W.ACCEPTED): P.READING,
    (P.COMMITTING, W.REFUSED): P.FENCING,
    (P.COMMITTING, W.EXHAUSTED): P.FENCING,
    (P.COMMITTING, W.RESTARTED): P.FENCING,
    (P.FENCING, W.FENCED): P.READING,
    (P.FENCING, W.TIMEOUT): P.FENCING,
    (P.FENCING, W.RESTARTED): P.FENCING,
    (P.READING, W.TIMEOUT): P.READING,
    (P.READING, W.RESTARTED): P.FENCING,
    (P.READING, W.RUNNING_READ): P.IDLE,
}
"""Everything that is not here leaves the phase as it is: a late or foreign answer."""

SEQUENCES = 1 << 16
TRIES = {P.CLAIMING: 12, P.STAGING: 4, P.COMMITTING: 1}  # the others try for ever: they establish what runs
"""A claim is made for as long as a lease lasts: nothing is staged yet, and a host that is late itself gets it then."""
CLAIMS = 4  # times that one write may begin anew because its lease has run out
NEEDS_ANEW = (wire.Reason.NOT_OWNER, wire.Reason.STALE)
"""Refusals of staging after a lease that ran out: nobody's now, or its number has been used up by what was dropped."""
UNKNOWN_AFTER = 3  # tries of FENCING or READING without an answer after which the result is said to be unknown


@dataclass(frozen=True, slots=True)
class WriteOrder:
    """What is to be written: the gains as float32, built on set base, in this boot epoch of the node, by this owner."""

    node: int
    epoch: int
    seq: int
    base: int
    gains: PidGains
    owner: int = 1
    key: bytes | None = field(default=None, repr=False)

    def commit(self, nonce: int | None = None) -> list[wire.Frame]:
        """The commit of this order, with its code in front when there is a key; nonce is the device's challenge."""
        commit = wire.Commit(self.seq, self.base, commit_crc(self.set_crc, self.base, self.owner))
        if self.key is None or nonce is None:
            return [commit]
        code = commit_code(self.key, self.node, self.epoch, nonce, self.owner, self.seq, self.base, self.gains)
        return [*code_frames(code, self.seq), commit]

    @property
    def set_crc(self) -> int:
        """CRC-32 of the set."""
        return set_crc(self.node, self.epoch, self.seq, self.gains)

    def stage(self) -> list[wire.Frame]:
        """The frames that stage it."""
        values = zip(wire.Item, (self.gains.kp, self.gains.ki, self.gains.kd), strict=True)
        return [wire.Stage(item, self.owner % wire.OWNER_TAG, value, self.seq) for item, value in values]


class SequenceNumbers:
    """The newest sequence number that this host has used or the device has told of."""

    def __init__(self) -> None:
        self._newest: int | None = None

    def note(self, number: int) -> None:
        """Remember a number if it is the newest."""
        if self._newest is None or wire.newer(number, self._newest):
            self._newest = number

    def correct(self, ack: wire.Ack, own: int | None) -> None:
        """The device's answer to a set: what it says about a stale number goes before all that was seen.

        For what was seen may have been forged: a STATUS half the circle ahead would make every write stale. Only in
        answer to this host's own number: a late one to somebody else's would lead back to numbers that are used up.
        """
        if ack.reason == wire.Reason.STALE and ack.seq == own:
            self._newest = ack.latest
        else:
            self.note(ack.latest)

    def after(self, running: int, *, use: bool = False) -> int:
        """The number for the next write: newer than the running set's and than any other seen. use : it is used now."""
        self.note(running)
        number = ((running if self._newest is None else self._newest) + 1) % SEQUENCES
        if use:
            self.note(number)
        return number


class WriteProtocol:
    """One write after another over one device.

    reader : asks for pages; shared with whoever else reads pages of this device.
    timeout_s : how long to wait for an answer, s.
    """

    def __init__(self, reader: PageReader, timeout_s: float) -> None:
        self._reader, self._timeout_s = reader, timeout_s
        self._order: WriteOrder | None = None
        self._why = ""
        self._tries = 0
        self._told_unknown = False
        self._nonce: int | None = None
        self._staged_right = False
        self._held: PidGains | None = None  # what the device has staged, by its newest answer
        self._deadline_s: float | None = None
        self._claims = 0
        self.used_up = False  # the device has dropped what was staged, and takes its number no more: see renumber
        self.machine = StateMachine(TRANSITIONS, WritePhase.IDLE)

    @property
    def phase(self) -> WritePhase:
        """Where the write stands."""
        return self.machine.phase

    @property
    def busy(self) -> bool:
        """Whether a write is under way."""
        return self.machine.phase is not WritePhase.IDLE

    def begin(self, order: WriteOrder) -> None:
        """Start a write; only when not busy."""
        self._order, self._why = order, "no answer to the commit"
        self._told_unknown = self._staged_right = False
        self._nonce = self._held = None
        self._claims = 0
        self.used_up = False
        self._move(WriteInput.BEGIN)

    @property
    def needs_number(self) -> bool:
        """Whether the write goes on under another number: not one that is being fenced off or read back already."""
        return self.used_up and self.phase is WritePhase.CLAIMING

    def renumber(self, seq: int) -> None:
        """Go on under another number: no commit of the one that is used up has been sent."""
        if self.needs_number and self._order is not None:
            self._order, self.used_up = replace(self._order, seq=seq), False

    @property
    def seq(self) -> int | None:
        """Number of the set that is being written."""
        return self._order.seq if self._order is not None and self.busy else None

    @property
    def base(self) -> int | None:
        """Number of the set that it is built on; None when nothing is being written."""
        return self._order.base if self._order is not None and self.busy else None

    def due(self, now_s: float, *, owned: bool, asked: bool = False) -> list[wire.Frame]:
        """Frames to send now: those of a phase just entered, or again after its time-out.

        owned : whether this host holds the lease at now_s; no commit is sent without it. asked : a request for it is
        ahead of these frames, so gains may be staged on the strength of it, once.
        """
        if self._order is None or not self.busy:
            return []
        if self.phase is WritePhase.CLAIMING and (owned or (asked and self._claims == 0)):
            self._move(WriteInput.OWNED)
        elif not owned and self._unsent(now_s):
            if self._may_begin_anew:
                self._move(WriteInput.LAPSED)
            elif self.phase is WritePhase.COMMITTING:
                self._why = "the lease ran out again and again"
                self._move(WriteInput.EXHAUSTED)
        if self._deadline_s is not None:
            if now_s < self._deadline_s:
                return []
            self._time_out()
        self._deadline_s = now_s + self._timeout_s
        self._tries += 1
        match self.phase:
            case WritePhase.STAGING:
                self._staged_right = False  # what is sent again is read back again
                challenge = [self._reader.ask(wire.Page.CHALLENGE)] if self._order.key is not None else []
                return [*self._order.stage(), self._reader.ask(wire.Page.STAGED), *challenge]
            case WritePhase.COMMITTING:
                return self._order.commit(self._nonce)
            case WritePhase.FENCING:
                return [wire.Abort(self._order.seq)]
            case WritePhase.READING:
                return [self._reader.ask(wire.Page.RUNNING)]
            case _:
                return []

    def _unsent(self, now_s: float) -> bool:
        """Whether a commit is to be sent now, or gains again: not without the lease."""
        if self.phase is WritePhase.COMMITTING:
            return self._tries == 0
        return self.phase is WritePhase.STAGING and self._deadline_s is not None and now_s >= self._deadline_s

    @property
    def _may_begin_anew(self) -> bool:
        """Whether nothing has been sent yet that could make the set run, and this has not happened too often."""
        unsent = self.phase is WritePhase.COMMITTING and self._tries == 0
        return self._claims < CLAIMS and (unsent or self.phase in {WritePhase.STAGING, WritePhase.CLAIMING})

    def _time_out(self) -> None:
        if self._tries < TRIES.get(self.phase, self._tries + 1):
            self._move(WriteInput.TIMEOUT)
            return
        if self.phase is WritePhase.CLAIMING:
            self._why = "the device did not give the lease"
        elif self.phase is WritePhase.STAGING:
            self._why = "the staged gains could not be read back"
            if self._held is not None and self._order is not None and self._held != self._order.gains:
                self._why = _held_text(self._held, self._order.gains)
        self._move(WriteInput.EXHAUSTED)

    def unknown(self) -> WriteUnknown | None:
        """The event that the result is unknown, once, when the device has not answered several times."""
        if self._order is None or self._told_unknown or self._tries < UNKNOWN_AFTER:
            return None
        if self.phase not in {WritePhase.FENCING, WritePhase.READING}:
            return None
        self._told_unknown = True
        return WriteUnknown(self._order.seq, f"{self._why}; the device does not say what it runs; asking on")

    def on_ack(self, ack: wire.Ack) -> None:
        """An acknowledge has come."""
        if self._order is None or ack.seq != self._order.seq:
            return
        if ack.kind == wire.Kind.ABORT:
            self._move(WriteInput.FENCED)
        elif ack.kind == wire.Kind.COMMIT and ack.reason == wire.Reason.OK:
            self._why = "it ran, but gave way before it could be read back"
            self._move(WriteInput.ACCEPTED)
        elif ack.kind == wire.Kind.STAGE and ack.reason in NEEDS_ANEW and self._may_begin_anew:
            self._move(WriteInput.LAPSED)
        elif ack.kind in {wire.Kind.COMMIT, wire.Kind.STAGE}:
            if self.phase in {WritePhase.STAGING, WritePhase.COMMITTING}:
                self._why = f"the device refused it: {wire.reason_text(ack)}"
            self._move(WriteInput.REFUSED)

    def on_other_owner(self, owner: int) -> None:
        """The lease is another host's."""
        if self.phase is WritePhase.CLAIMING:
            self._why = f"host {owner} holds the lease"
            self._move(WriteInput.REFUSED)

    def on_staged(self, page: ReadBack) -> None:
        """The staged page has been read back."""
        order = self._order
        if order is None:
            return
        self._staged_right = page.seq == order.seq and page.gains == order.gains and page.fits(order.set_crc)
        self._held = page.gains if page.seq == order.seq else None
        if not self._staged_right:
            self._move(WriteInput.STAGED_WRONG)
        elif order.key is None or self._nonce is not None:
            self._move(WriteInput.STAGED_RIGHT)

    def on_challenge(self, challenge: wire.Challenge) -> None:
        """The device's challenge has come. One that demands no code from a host with a key is not the right device."""
        if self._order is None or self._order.key is None or self.phase is not WritePhase.STAGING:
            return
        if not challenge.demanded:
            self._why = "this host has a key, but the device demands no code for a commit"
            self._move(WriteInput.REFUSED)
            return
        self._nonce = challenge.nonce
        if self._staged_right:
            self._move(WriteInput.STAGED_RIGHT)

    def on_restart(self) -> None:
        """The device has booted."""
        if self.busy:
            self._why = "the device restarted"
        self._move(WriteInput.RESTARTED)

    def on_running(self, running: RunningSet) -> WriteDone | WriteFailed | None:
        """The running page has been read back and its CRC is right; the outcome if that was the last step."""
        order = self._order
        asked = self.phase is WritePhase.READING and self._tries > 0  # an answer to an older question proves nothing
        if order is None or not asked:
            return None
        self._move(WriteInput.RUNNING_READ)
        if running.seq == order.seq and running.gains == order.gains:
            return WriteDone(order.seq, running.gains, running)
        held = running.seq == order.seq
        return WriteFailed(order.seq, _held_text(running.gains, order.gains) if held else self._why, running)

    def _move(self, event: WriteInput) -> None:
        if not self.machine.take(event) or event is WriteInput.TIMEOUT:
            return
        if event is WriteInput.LAPSED:
            self._claims += 1
            self.used_up = True
            self._staged_right, self._nonce = False, None
        if event is not WriteInput.STAGED_WRONG:
            self._tries = 0
            self._deadline_s = None


def _held_text(held: PidGains, sent: PidGains) -> str:
    return f"the controller holds {held} where {sent} was sent: it rounds or limits gains"
