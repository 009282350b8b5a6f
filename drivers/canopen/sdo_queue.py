"""Questions and answers by SDO, one after the other, without waiting: CiA 301, expedited (up to 4 bytes) and segmented.

The package `canopen` waits for each answer in the thread that asks; here nothing may wait, so the few bytes are put
together here, and everything that they mean is the package's.
"""

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import can
from canopen.sdo.exceptions import SdoAbortedError

from retuner.drivers.canopen.eds_file import Variable

DOWNLOAD, DOWNLOADED, UPLOAD, UPLOADED, ABORT = 0x20, 0x60, 0x40, 0x40, 0x80
COMMAND = 0xE0
EXPEDITED, SIZED = 0x02, 0x01
SEGMENT_DOWN, SEGMENT_TAKEN, SEGMENT_UP, SEGMENT_GIVEN = 0x00, 0x20, 0x60, 0x00
TOGGLE, LAST = 0x10, 0x01
IN_ONE, IN_A_SEGMENT = 4, 7  # Bytes of an expedited transfer and of a segment
TOO_LONG, WRONG_TOGGLE = 0x06070010, 0x05030000
"""Abort codes: a length that does not fit; a toggle bit that was not alternated."""


class Transfer(NamedTuple):
    """One question: read (data is None) or write."""

    name: str
    variable: Variable
    data: bytes | None


class SdoAnswer(NamedTuple):
    """How it ended. data : what was read, None for a write. refused : why not, "" when it was done."""

    transfer: Transfer
    data: bytes | None
    refused: str


class _Segments:
    """A number of more than 4 bytes on its way, segment by segment."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at, self.toggle = data, 0, 0

    def down(self) -> bytes:
        """The next segment to write."""
        part = self.data[self.at : self.at + IN_A_SEGMENT]
        self.at += len(part)
        head = SEGMENT_DOWN | self.toggle | (IN_A_SEGMENT - len(part)) << 1 | (LAST if self.at >= len(self.data) else 0)
        return bytes([head]) + part.ljust(IN_A_SEGMENT, b"\0")

    def up(self) -> bytes:
        """The question for the next segment to read."""
        return bytes([SEGMENT_UP | self.toggle]).ljust(8, b"\0")


class SdoQueue:
    """One node's SDO server, asked by one host.

    node : its number. reply_s : how long an answer is awaited; after that the question is dropped, and whoever asked
    asks again. doubled : the name of a question that was answered twice, and differently, since it was last cleared.
    """

    def __init__(self, node: int, reply_s: float) -> None:
        self._node, self._reply_s = node, reply_s
        self._waiting: deque[Transfer] = deque()
        self._open: Transfer | None = None
        self._deadline_s: float | None = None
        self._last: tuple[Transfer, bytes] | None = None
        self._segments: _Segments | None = None
        self._next: bytes | None = None  # a segment to send
        self.doubled = ""

    def ask(self, name: str, variable: Variable, data: bytes | None = None) -> None:
        """Queue a question; one that waits already is not asked twice."""
        transfer = Transfer(name, variable, data)
        if transfer in self._waiting or (data is None and transfer == self._open):
            return
        if data is not None:  # an older value of the same object is not worth writing any more
            self._waiting = deque(t for t in self._waiting if t.name != name or t.data is None)
        self._waiting.append(transfer)

    def forget(self) -> None:
        """Drop everything."""
        self._waiting.clear()
        self._open = self._deadline_s = self._segments = self._next = None

    def due(self, now_s: float) -> list[can.Message]:
        """The next question, when none is open."""
        if self._open is not None:
            if self._deadline_s is None:
                self._deadline_s = now_s + self._reply_s
            if now_s < self._deadline_s:
                segment, self._next = self._next, None
                return [] if segment is None else [self._message(segment)]
        self._segments = self._next = None
        self._open = self._waiting.popleft() if self._waiting else None
        self._deadline_s = now_s + self._reply_s
        if self._open is None:
            return []
        data, variable = self._open.data, self._open.variable
        if data is not None and len(data) > IN_ONE:
            self._segments = _Segments(data)
            command, data = DOWNLOAD | SIZED, len(data).to_bytes(4, "little")
        else:
            command = UPLOAD if data is None else DOWNLOAD | (IN_ONE - len(data)) << 2 | EXPEDITED | SIZED
        place = bytes([command]) + variable.index.to_bytes(2, "little") + bytes([variable.subindex])
        return [self._message(place + (data or b"").ljust(4, b"\0"))]

    def _message(self, data: bytes) -> can.Message:
        return can.Message(arbitration_id=0x600 + self._node, is_extended_id=False, data=data)

    def take(self, message: can.Message) -> SdoAnswer | None:
        """An answer to the open question; None for anything else."""
        data, transfer = bytes(message.data), self._open
        if message.arbitration_id != 0x580 + self._node or len(data) != 8:
            return None
        segments = self._segments
        if transfer is not None and segments is not None and data[0] != ABORT:
            begins = transfer.data is not None and not segments.at and data[0] == DOWNLOADED  # before the first segment
            if not begins:
                return self._segment(transfer, segments, data)
        if transfer is None or not _is_about(transfer, data):
            if self._last is not None and _is_about(self._last[0], data) and self._last[1] != data:
                self.doubled = self._last[0].name
            return None
        if data[0] == ABORT:
            return self._ended(SdoAnswer(transfer, None, abort_text(int.from_bytes(data[4:8], "little"))), data)
        command = data[0] & COMMAND
        if transfer.data is not None:
            if command == DOWNLOADED and segments is not None:
                self._go_on(segments.down())
                return None
            return self._ended(SdoAnswer(transfer, None, ""), data) if command == DOWNLOADED else None
        if command != UPLOADED:
            return None
        if not data[0] & EXPEDITED:
            self._segments = _Segments(b"")
            self._go_on(self._segments.up())
            return None
        size = 4 - (data[0] >> 2 & 3) if data[0] & SIZED else len(transfer.variable) // 8
        return self._ended(SdoAnswer(transfer, data[4 : 4 + size], ""), data)

    def _segment(self, transfer: Transfer, segments: _Segments, data: bytes) -> SdoAnswer | None:
        writes = transfer.data is not None
        if data[0] & COMMAND != (SEGMENT_TAKEN if writes else SEGMENT_GIVEN):
            return None
        if data[0] & TOGGLE != segments.toggle:
            return self._ended(SdoAnswer(transfer, None, abort_text(WRONG_TOGGLE)), data)
        segments.toggle ^= TOGGLE
        if writes:
            if segments.at >= len(segments.data):
                return self._ended(SdoAnswer(transfer, None, ""), data)
            self._go_on(segments.down())
            return None
        segments.data += data[1 : 8 - (data[0] >> 1 & 7)]
        if len(segments.data) > len(transfer.variable) // 8:
            return self._ended(SdoAnswer(transfer, None, abort_text(TOO_LONG)), data)
        if data[0] & LAST:
            return self._ended(SdoAnswer(transfer, segments.data, ""), data)
        self._go_on(segments.up())
        return None

    def _go_on(self, segment: bytes) -> None:
        """Send this next; the node has its time for each answer anew."""
        self._next, self._deadline_s = segment, None

    def _ended(self, answer: SdoAnswer, data: bytes) -> SdoAnswer:
        self._last = answer.transfer, data
        self._open = self._deadline_s = self._segments = self._next = None
        return answer


FRAME_BITS = 135
"""Bits of a standard frame of 8 bytes with the most stuff bits (K. Tindell et al., Control Eng. Practice 3, 1995)."""
BIT_RATE = 500e3  # bits a second that times are told for: the middle of CiA 301's rates
ANSWER_S = 5e-3  # how long a node may think before it answers: CiA 301 gives no limit, microcontrollers take 1 to 10 ms


def pace_s(variables: Iterable[Variable]) -> tuple[float, float]:
    """How long reading these one after the other takes, s: on the wire alone, and with what a node takes to answer."""
    bits = [max(len(variable), 8) // 8 for variable in variables]
    exchanges = [1 if size <= IN_ONE else 1 + math.ceil(size / IN_A_SEGMENT) for size in bits]
    wire_s = sum(exchanges) * 2 * FRAME_BITS / BIT_RATE
    return wire_s, wire_s + sum(exchanges) * ANSWER_S


def _is_about(transfer: Transfer, data: bytes) -> bool:
    """Whether an answer names the object of this question."""
    variable = transfer.variable
    return int.from_bytes(data[1:3], "little") == variable.index and data[3] == variable.subindex


def abort_text(code: int) -> str:
    """An abort in words."""
    return f"abort {code:#010x}" + (f", {SdoAbortedError.CODES[code].lower()}" if code in SdoAbortedError.CODES else "")
