"""What one life of a host sends and tells, held to docs/developers/protocol.md layer by layer.

The invariants of truth.py say what must never come of host and device together: a device that refuses keeps a careless
host from doing harm. Here the host is asked by itself whether it had every reason for what it did.
"""

import hmac
import struct
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import can

from bus_simulation.layers.answers import SENT, VERSION
from bus_simulation.layers.wire import (
    ABORT,
    ACK,
    COMMIT,
    CONFIRM,
    ITEM,
    KEYED,
    LEASE,
    STAGE,
    STAMP_SAMPLES,
    STORE,
    TELEMETRY_PV,
    TELEMETRY_SP,
    UNCHECKED,
    Ack,
    broken,
    crc8,
    float32,
    is_foreign,
    newer,
    sample_crc,
    set_crc,
    stamp,
    u16,
)
from retuner import LoopSample, PidGains
from retuner.drivers.device import DeviceRestarted, Reverted, RunningChanged, RunningSet, WriteDone, WriteFailed
from retuner.drivers.host.can_settings import CanDeviceSettings

# ---- What has reached one life of a host, frame by frame: pages that are proved, answers, samples, life signs.
#
# Everything is numbered in the order in which it came or was sent, so that a judge can ask what was before what.

Three = tuple[float, float, float]
HALVES_KEPT = 200  # of samples: longer than the bus delays any


class Proof(NamedTuple):
    """A page that was read back: whole, in answer to the newest question, its CRC right for an epoch that was heard."""

    asked: int
    epoch: int
    seq: int
    gains: Three


class Heard(NamedTuple):
    """An answer, and when it came."""

    place: int
    ack: Ack


class Overheard:
    """See the head of this file.

    node : of the device. sample_time_s : that it should have.
    """

    def __init__(self, node: int, sample_time_s: float) -> None:
        self._node, self._sample_time = node, struct.pack("<f", sample_time_s)
        self.place = 0  # of the newest frame, in or out
        self.beats: dict[int, int] = {}  # epochs, and when each was heard first
        self.identity = -1  # when the right device said last who it is
        self.acks: deque[Heard] = deque(maxlen=HALVES_KEPT)
        self.epochs: set[int] = set()  # that a page has proved
        self.proved: dict[int, Proof] = {}
        self.challenge: tuple[int, bool] | None = None  # in answer to the newest question for it
        self.newest_sample = 0
        self._asked: dict[int, tuple[int, int]] = {}  # token and place of the newest question for a page
        self._items: dict[int, dict[int, tuple[int, bytes]]] = {}
        self._ends: dict[int, bytes] = {}
        self._halves: dict[int, deque[bytes]] = {
            command: deque(maxlen=HALVES_KEPT) for command in (TELEMETRY_PV, TELEMETRY_SP)
        }

    def asks(self, data: bytes) -> None:
        """The host sends READ: answers to older questions about this page prove nothing from now on."""
        page, token = data[0], u16(data[1:])
        self._asked[page] = token, self.place
        self._items[page] = {}
        self._ends.pop(page, None)

    def comes(self, message: can.Message) -> int:
        """A frame has reached the host; its command when it is whole and of this device, else 0."""
        self.place += 1
        command, data = message.arbitration_id & 31, bytes(message.data)
        odd = message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd
        if odd or is_foreign(message, self._node) or SENT.get(command) != len(data):
            return 0
        if command not in UNCHECKED and data[-1] != crc8(message.arbitration_id, data[:-1]):
            return 0
        match command:
            case 16:
                self.beats.setdefault(u16(data[4:]), self.place)
                self.newest_sample = max(self.newest_sample, int.from_bytes(data[:4], "little"))
            case 20 if data[0] == VERSION and data[3:7] == self._sample_time:
                self.identity = self.place
            case 21 | 22:
                self._page(command, data)
            case 23:
                self.acks.append(Heard(self.place, Ack(data)))
            case 24 if 4 in self._asked and data[0] & 127 == self._asked[4][0] & 127:
                self.challenge = int.from_bytes(data[1:7], "little"), bool(data[0] & 128)
            case 18 | 19:
                self._halves[command].append(data)
            case _:
                pass
        return command

    def _page(self, command: int, data: bytes) -> None:
        """A part of a page; the page is proved when all parts belong to the question and its CRC says so."""
        page = data[0] & 3
        if page not in self._asked or data[0] >> 4 != self._asked[page][0] & 15:
            return
        if command == ITEM:
            self._items[page][data[0] >> 2 & 3] = u16(data[5:]), data[1:5]
        else:
            self._ends[page] = data
        end, items = self._ends.get(page), self._items[page]
        if end is None or not end[0] & 4 or set(items) != {0, 1, 2}:
            return
        seq, (token, asked) = u16(end[1:]), self._asked[page]
        gains = (float32(items[0][1]), float32(items[1][1]), float32(items[2][1]))
        if any(number != seq for number, _ in items.values()):
            return
        for epoch in self.beats:
            if set_crc(self._node, epoch, seq, gains, struct.pack("<H", token)) == int.from_bytes(end[3:7], "little"):
                self.proved[page] = Proof(asked, epoch, seq, gains)
                self.epochs.add(epoch)

    def was_sampled(self, sp: float, pv: float, mode: int) -> bool:
        """Whether both halves of such a sample have come, with one counter and the CRC over both."""
        want = struct.pack("<f", sp), struct.pack("<f", pv)
        for one in self._halves[TELEMETRY_PV]:
            if one[1:5] != want[1]:
                continue
            for other in self._halves[TELEMETRY_SP]:
                same = other[0] == one[0] and other[1:5] == want[0] and other[5] & 1 == mode
                if same and u16(other[6:]) == sample_crc(self._node, one, other):
                    return True
        return False


# ---- What one life of a host sends and tells, held to docs/developers/protocol.md layer by layer.
#
# The invariants of truth.py say what must never come of host and device together: a device that refuses keeps a
# careless host from doing harm. Here the host is asked by itself whether it had every reason for what it did.

RUNNING, STAGED, CHALLENGED = 0, 1, 4
OK, STALE, NOT_OWNER = 0, 1, 13
AHEAD = 40  # blocks of STAMP_SAMPLES by which a host may know the device's time better than the heartbeats say
NO_TIME = 100_000  # a device that says it is as old is a forged one


class HostSide:
    """See the head of this file.

    settings : of the host. rows : its ledger.
    """

    def __init__(self, settings: CanDeviceSettings, rows: Sequence[tuple[str, object]]) -> None:
        self._settings, self._rows = settings, rows
        self.heard = Overheard(settings.node, settings.sample_time_s)
        self._length_s = settings.lease_length * settings.sample_time_s
        self._lease_sent_s = self._granted_s = float("-inf")
        self._granted = False
        self._counter: int | None = None
        self._staged: dict[int, tuple[int, float]] = {}  # what was staged last: by item the number and value
        self._said = -1  # when this host last said something about gains
        self._commits: set[bytes] = set()
        self._aborted: set[tuple[int, int]] = set()
        self._used_up: deque[tuple[int, int]] = deque(maxlen=32)
        self._auth: list[bytes] = []
        self._done: set[int] = set()
        self._on_probation: int | None = None
        self._heard_s = float("-inf")

    # What comes

    def comes(self, message: can.Message, now_s: float) -> None:
        """A frame has reached the host."""
        command = self.heard.comes(message)
        if not command:
            return
        self._heard_s = now_s
        if command == ACK:
            ack = self.heard.acks[-1].ack
            if ack.epoch == self._epoch % 8192:
                if ack.kind == LEASE and ack.seq == self._settings.owner and ack.reason == STALE:
                    self._counter = None  # it goes on elsewhere on the circle
                elif ack.kind == LEASE and ack.seq == self._settings.owner:
                    self._granted, self._granted_s = ack.reason == OK, self._lease_sent_s
                elif ack.reason == STALE and ack.kind in {ABORT, STAGE, COMMIT}:
                    self._aborted.clear()  # the device's word on the newest number goes before what was seen
                    if ack.kind == STAGE and ack.seq in {number for number, _ in self._staged.values()}:
                        self._used_up.append((ack.epoch, ack.seq))
                elif ack.reason == NOT_OWNER and ack.kind != LEASE:
                    self._granted = False
                elif ack.kind == CONFIRM and ack.reason == OK:
                    self._on_probation = None
        running = self.heard.proved.get(RUNNING)
        if running is not None and running.seq != self._on_probation:
            self._on_probation = None

    # What it sends

    def sends(self, message: can.Message, now_s: float) -> None:
        """The host puts a frame on the bus."""
        self.heard.place += 1
        command, data = message.arbitration_id & 31, bytes(message.data)
        match command:
            case 1:
                self._lease(data, now_s)
            case 2:
                self.heard.asks(data)
            case 3:
                self._aborted.add((self._epoch, u16(data)))
                self._said = self.heard.place
            case 4:
                item, value, seq = data[0] & 3, float32(data[1:5]), u16(data[5:])
                proof = self.heard.proved.get(RUNNING)
                if proof is None or self.heard.identity < 0:
                    raise broken("nothing_is_written_unread", f"STAGE {data.hex()} with {proof}")
                intent = next((body for kind, body in reversed(self._rows) if kind == "intent"), None)
                if not isinstance(intent, PidGains) or _three(intent)[item] != value:
                    raise broken("recorded_before_it_is_written", f"STAGE {data.hex()}, the ledger has {intent}")
                if now_s - self._lease_sent_s >= self._length_s:
                    raise broken(
                        "the_lease_comes_first", f"STAGE {data.hex()}, LEASE was sent at {self._lease_sent_s} s"
                    )
                used_up = (proof.epoch % 8192, seq) in self._used_up
                if used_up or (proof.epoch, seq) in self._aborted or seq == proof.seq:
                    raise broken("used_numbers_stay_used", f"STAGE {data.hex()}, set {proof.seq} runs")
                self._staged[item] = seq, value
                self._said = self.heard.place
            case 5:
                self._commit(data, now_s)
            case 6 | 7:
                # CONFIRM and STORE: of the set that was read back; what this host has written is confirmed before
                seq = u16(data)
                running = self.heard.proved.get(RUNNING)
                if command == CONFIRM and seq not in self._done:
                    raise broken("what_is_kept_has_been_read_back", f"CONFIRM of {seq}, done were {sorted(self._done)}")
                if command == STORE and (running is None or seq == self._on_probation):
                    raise broken("what_is_kept_has_been_read_back", f"STORE of {seq} with {running}")
            case 11:
                self._auth = [*self._auth[-1:], data[:7]]

    @property
    def _epoch(self) -> int:
        """The epoch that a read-back has proved; -1 for none."""
        proof = self.heard.proved.get(RUNNING)
        return -1 if proof is None else proof.epoch

    def _lease(self, data: bytes, now_s: float) -> None:
        """LEASE: this host's number, a counter that goes on, the device's time."""
        counter, newest = data[6], self.heard.newest_sample
        if u16(data) != self._settings.owner or (self._counter is not None and not newer(counter, self._counter, 8)):
            raise broken("leases_are_asked_for_rightly", f"LEASE {data.hex()} after counter {self._counter}")
        blocks = range(newest // STAMP_SAMPLES + AHEAD if newest < NO_TIME else 0)
        right = {stamp(epoch, block * STAMP_SAMPLES) for epoch in self.heard.epochs for block in blocks}
        if blocks and u16(data[2:]) not in right:
            raise broken("leases_are_asked_for_rightly", f"LEASE {data.hex()} is no time of {self.heard.epochs}")
        self._counter, self._lease_sent_s = counter, now_s

    def _commit(self, data: bytes, now_s: float) -> None:
        """COMMIT: once, under a lease that is granted and not over, of what was read back as it was staged."""
        seq, base, crc = u16(data), u16(data[2:]), int.from_bytes(data[4:], "little")
        running, staged = self.heard.proved.get(RUNNING), self.heard.proved.get(STAGED)
        if data in self._commits:
            raise broken("a_commit_is_sent_once", data.hex())
        self._commits.add(data)
        if not self._granted or now_s - self._granted_s >= self._length_s:
            raise broken("the_lease_comes_first", f"COMMIT {data.hex()}, granted {self._granted} at {self._granted_s}")
        # What was staged under this number, if all of it was
        values = [value for number, value in map(self._staged.get, range(3), [(-1, 0.0)] * 3) if number == seq]
        gains = (values[0], values[1], values[2]) if len(values) == 3 else None
        if staged is None or staged.asked < self._said or (staged.seq, staged.gains) != (seq, gains):
            raise broken("what_is_staged_is_read_back", f"COMMIT {data.hex()} with {staged}, staged were {gains}")
        said = struct.pack("<HH", base, self._settings.owner)
        if running is None or crc != set_crc(self._settings.node, staged.epoch, seq, staged.gains, said):
            raise broken("a_commit_says_what_it_means", f"COMMIT {data.hex()} of {staged} on {running}")
        key, settings, challenge = self._settings.key, self._settings, self.heard.challenge
        if key is not None:
            nonce, demanded = challenge or (0, False)
            said = struct.pack(
                "<BHQHHH3f", settings.node, staged.epoch, nonce, settings.owner, staged.seq, base, *staged.gains
            )
            code = hmac.digest(key, KEYED + said, "sha256")[:12]
            heads = [bytes([part | (staged.seq & 15) << 4]) for part in (0, 1)]
            if not demanded or self._auth != [heads[0] + code[:6], heads[1] + code[6:]]:
                raise broken(
                    "codes_are_over_the_newest_challenge", f"{[half.hex() for half in self._auth]}, {challenge}"
                )
        self._said = self.heard.place

    # What it tells

    def tells(self, event: object) -> None:
        """The client tells its user something."""
        match event:
            case WriteDone() | WriteFailed():
                proof = self._read_back(event.running, type(event).__name__)
                if proof.asked < self._said:
                    raise broken("what_is_told_was_read_back", f"{event}: asked at {proof.asked}, said at {self._said}")
                tag = proof.epoch % 8192
                earlier = (a for place, a in self.heard.acks if place < proof.asked)
                answers = {(a.kind, a.reason == OK) for a in earlier if (a.epoch, a.seq) == (tag, event.seq)}
                fenced = {(ABORT, True), (ABORT, False)} & answers
                if not fenced and (COMMIT, True) not in answers:
                    raise broken("a_write_ends_fenced_or_acknowledged", f"{event}, answered were {answers} in {proof}")
                if isinstance(event, WriteDone):
                    self._done.add(event.seq)
                    self._on_probation = event.seq
            case DeviceRestarted():
                self._read_back(event.running, "restart")
                first = self.heard.beats.get(event.epoch)
                if first is None or self.heard.identity < first:
                    raise broken("a_device_that_booted_is_asked_who_it_is", f"{event}, heard first at {first}")
                self._granted = False
            case RunningChanged() | Reverted():
                self._read_back(event.running, "change")
            case LoopSample() if not self.heard.was_sampled(event.sp, event.pv, int(event.mode)):
                raise broken("samples_are_whole_at_the_host", f"{event} has come in no frames")

    def _read_back(self, running: RunningSet, what: str) -> Proof:
        """What is told to run is what the newest read-back has proved."""
        proof = self.heard.proved.get(RUNNING)
        if proof is None or (proof.seq, proof.gains) != (running.seq, _three(running.gains)):
            raise broken("what_is_told_was_read_back", f"{what}: {running}, proved is {proof}")
        return proof

    def polled(self, now_s: float, *, connected: bool) -> None:
        """The host has taken its turn."""
        if connected and now_s - self._heard_s > self._settings.silent_s:
            raise broken("silence_is_noticed", f"connected at {now_s} s, heard last at {self._heard_s} s")


def _three(gains: PidGains) -> Three:
    """As they stand on the wire."""
    return gains.kp, gains.ki, gains.kd
