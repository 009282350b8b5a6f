"""Questions and answers by SDO, one after the other, without waiting: CiA 301, expedited transfers of up to 4 bytes.

The package `canopen` waits for each answer in the thread that asks; here nothing may wait, so the few bytes are put
together here, and everything that they mean is the package's.
"""

from collections import deque
from typing import NamedTuple

import can
from canopen.sdo.exceptions import SdoAbortedError

from retuner.drivers.canopen.eds_file import Variable

DOWNLOAD, DOWNLOADED, UPLOAD, UPLOADED, ABORT = 0x20, 0x60, 0x40, 0x40, 0x80
COMMAND = 0xE0
EXPEDITED, SIZED = 0x02, 0x01
NO_SEGMENTS = 0x05040001
"""Abort code: command not known."""


class Transfer(NamedTuple):
    """One question: read (data is None) or write."""

    name: str
    variable: Variable
    data: bytes | None


class Answer(NamedTuple):
    """How it ended. data : what was read, None for a write. refused : why not, "" when it was done."""

    transfer: Transfer
    data: bytes | None
    refused: str


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
        self._open = self._deadline_s = None

    def due(self, now_s: float) -> list[can.Message]:
        """The next question, when none is open."""
        if self._open is not None:
            if self._deadline_s is None:
                self._deadline_s = now_s + self._reply_s
            if now_s < self._deadline_s:
                return []
        self._open = self._waiting.popleft() if self._waiting else None
        self._deadline_s = now_s + self._reply_s
        return [] if self._open is None else [self._frame(self._open)]

    def _frame(self, transfer: Transfer) -> can.Message:
        """A question as a frame."""
        data, variable = transfer.data, transfer.variable
        command = UPLOAD if data is None else DOWNLOAD | (4 - len(data)) << 2 | EXPEDITED | SIZED
        place = bytes([command]) + variable.index.to_bytes(2, "little") + bytes([variable.subindex])
        return can.Message(
            arbitration_id=0x600 + self._node, is_extended_id=False, data=place + (data or b"").ljust(4, b"\0")
        )

    def take(self, message: can.Message) -> Answer | None:
        """An answer to the open question; None for anything else."""
        data, transfer = bytes(message.data), self._open
        if message.arbitration_id != 0x580 + self._node or len(data) != 8:
            return None
        if transfer is None or not _is_about(transfer, data):
            self._compare(data)
            return None
        if data[0] == ABORT:
            return self._ended(Answer(transfer, None, abort_text(int.from_bytes(data[4:8], "little"))), data)
        command = data[0] & COMMAND
        if transfer.data is not None:
            return self._ended(Answer(transfer, None, ""), data) if command == DOWNLOADED else None
        if command != UPLOADED:
            return None
        if not data[0] & EXPEDITED:
            return self._ended(Answer(transfer, None, abort_text(NO_SEGMENTS)), data)
        size = 4 - (data[0] >> 2 & 3) if data[0] & SIZED else len(transfer.variable) // 8
        return self._ended(Answer(transfer, data[4 : 4 + size], ""), data)

    def _ended(self, answer: Answer, data: bytes) -> Answer:
        """The open question has its answer."""
        self._last = answer.transfer, data
        self._open = self._deadline_s = None
        return answer

    def _compare(self, data: bytes) -> None:
        """A second answer to the question before: one node gives one."""
        if self._last is not None and _is_about(self._last[0], data) and self._last[1] != data:
            self.doubled = self._last[0].name


def _is_about(transfer: Transfer, data: bytes) -> bool:
    """Whether an answer names the object of this question."""
    variable = transfer.variable
    return int.from_bytes(data[1:3], "little") == variable.index and data[3] == variable.subindex


def abort_text(code: int) -> str:
    """An abort in words."""
    return f"abort {code:#010x}" + (f", {SdoAbortedError.CODES[code].lower()}" if code in SdoAbortedError.CODES else "")
