"""What can go wrong with a link: named, counted, told.

Every fault is counted at once. Telling is rationed: a fault is told when it first happens and then at most every
TELL_EVERY_S, with how often it has happened since; a cable that chatters must not fill the ledger.

Error frames are those of SocketCAN (linux/can/error.h): the class of the error in the identifier, the state of the
controller in the second byte.
"""

import errno
from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import can

TELL_EVERY_S = 10.0


class LinkFault(StrEnum):
    """What went wrong, in the words that people see."""

    INTERFACE_DOWN = "interface down"
    INTERFACE_GONE = "interface gone or made anew"
    DEAF = "nothing received any more"
    RECEIVE = "receiving failed"
    SEND = "sending failed"
    OPEN = "the bus does not open"
    BUS_OFF = "bus-off"
    ERROR_PASSIVE = "error-passive"
    ERROR_WARNING = "error counters high"
    NO_ACKNOWLEDGE = "no node acknowledges"
    ERROR_FRAME = "error frame"
    TRANSMIT_FULL = "transmit queue full"
    OVERFLOW = "frames lost in the receive queue"
    GARBAGE = "a datagram that is no frame"
    LOG = "the bus log cannot be written"


HOLDING = frozenset(LinkFault) - {LinkFault.LOG, LinkFault.GARBAGE, LinkFault.ERROR_FRAME}
"""Faults after which frames may be missing or stale, so nothing is learned or changed for a while. A stray datagram or
one error on the wire costs no frame of ours: CAN repeats it, and a gap in the samples would be seen by itself."""

OVERFLOWN, WARNED, PASSIVE = 0x03, 0x0C, 0x30  # states of the controller: queue overflown, counters over 96, over 127
CONTROLLER_CLASS, NO_ACK_CLASS, BUS_OFF_CLASS = 0x04, 0x20, 0x40
TRANSMIT_QUEUE_FULL = (errno.ENOBUFS, errno.EAGAIN)
BY_ERRNO = {
    errno.ENETDOWN: LinkFault.INTERFACE_DOWN,
    errno.ENODEV: LinkFault.INTERFACE_GONE,
    errno.ENXIO: LinkFault.INTERFACE_GONE,
    errno.ENOBUFS: LinkFault.TRANSMIT_FULL,
    errno.EAGAIN: LinkFault.TRANSMIT_FULL,
}


class FaultNews(NamedTuple):
    """A fault, and how often it has happened since it was last told."""

    fault: LinkFault
    times: int


@dataclass(slots=True)
class FaultBook:
    """Faults of one link since it was made.

    counts : how often each has happened.
    """

    counts: Counter[LinkFault] = field(default_factory=Counter)
    _untold: Counter[LinkFault] = field(default_factory=Counter)
    _told_s: dict[LinkFault, float] = field(default_factory=dict)

    def note(self, fault: LinkFault, count: int = 1) -> None:
        """It has happened count times more."""
        self.counts[fault] += count
        self._untold[fault] += count

    def news(self, now_s: float) -> list[FaultNews]:
        """What is to be told now; now_s is in the machine's seconds or faster, see the head of this file."""
        if not self._untold:
            return []
        due = [fault for fault in self._untold if now_s - self._told_s.get(fault, float("-inf")) >= TELL_EVERY_S]
        for fault in due:
            self._told_s[fault] = now_s
        return [FaultNews(fault, self._untold.pop(fault)) for fault in due]


def fault_of_frame(message: can.Message) -> LinkFault:
    """What an error frame says."""
    kind, state = message.arbitration_id, message.data[1] if len(message.data) > 1 else 0
    if kind & BUS_OFF_CLASS:
        return LinkFault.BUS_OFF
    if kind & NO_ACK_CLASS:
        return LinkFault.NO_ACKNOWLEDGE
    if kind & CONTROLLER_CLASS:
        for bits, fault in ((OVERFLOWN, LinkFault.OVERFLOW), (PASSIVE, LinkFault.ERROR_PASSIVE)):
            if state & bits:
                return fault
        return LinkFault.ERROR_WARNING if state & WARNED else LinkFault.ERROR_FRAME
    return LinkFault.ERROR_FRAME


def fault_of_error(error: BaseException, otherwise: LinkFault) -> LinkFault:
    """What an exception of python-can or the system says; otherwise : when it does not say."""
    if is_full(error):
        return LinkFault.TRANSMIT_FULL
    number = error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
    return BY_ERRNO.get(number, otherwise) if number is not None else otherwise


def is_garbage(error: BaseException) -> bool:
    """Whether a receive failed on what came (a datagram that is no frame) and not on the socket."""
    return isinstance(error.__cause__, Exception) and not isinstance(error.__cause__, OSError)


def is_well_formed(message: can.Message) -> bool:
    """Whether a message that came as a datagram is one at all: python-can takes an identifier of 0.5, or true."""
    return type(message.arbitration_id) is int and message.arbitration_id >= 0


def is_full(error: BaseException) -> bool:
    """Whether a send failed because there was no room, which passes by itself.

    python-can says so by a time-out, by the system's error, or by an error without a number and without a cause.
    """
    if not isinstance(error, can.CanError):
        return False
    number = error.error_code
    return (
        isinstance(error, can.CanTimeoutError)
        or number in TRANSMIT_QUEUE_FULL
        or (isinstance(error, can.CanOperationError) and number is None and error.__cause__ is None)
    )
