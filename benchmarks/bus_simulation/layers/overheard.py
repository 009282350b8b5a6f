"""What has reached one life of a host, frame by frame: pages that are proved, answers, samples, life signs.

Everything is numbered in the order in which it came or was sent, so that a judge can ask what was before what.
"""

import struct
from collections import deque
from typing import NamedTuple

import can

from bus_simulation.layers.answers import SENT, VERSION
from bus_simulation.layers.wire import (
    ITEM,
    TELEMETRY_PV,
    TELEMETRY_SP,
    UNCHECKED,
    Ack,
    crc8,
    float32,
    is_foreign,
    sample_crc,
    set_crc,
    u16,
)

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

    Parameters
    ----------
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
