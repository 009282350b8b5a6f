"""A CAN link that survives: python-can underneath, liveness by the age of the last frame, re-opening with back-off.

Why not python-can's Notifier: its thread dies on the first bus error; after `ip link del/add` the old socket receives
nothing for ever without any error; a garbage datagram on udp_multicast raises in the reader. Hence no thread, and
silence of a link that was heard before is answered by opening the bus anew as well. What goes wrong is
named below, counted, and told by news().

What a bus's socket knows and python-can does not tell: frames lost in its queue, and whether it is still bound.

The kernel counts what it drops because the receive queue is full, and says nothing: 278 classic frames fill the usual
queue, 62 ms of a full 500 kbit/s bus. SO_MEMINFO reads the same counter that SO_RXQ_OVFL would attach to frames, for
CAN and UDP alike. A SocketCAN socket whose interface was removed is bound to nothing and hears nothing for ever, also
when an interface of the same name is made anew; the name that it is bound to tells.
"""

import contextlib
import errno
import os
import select
import socket
import struct
import sys
from collections import Counter, deque
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import can

from retuner.drivers.bus.bus_opening import BUS_ERRORS, SOCKETCAN, UDP_MULTICAST, BusLog, open_bus
from retuner.drivers.bus.link_settings import LinkCounters, LinkSettings
from retuner.drivers.clock import Clock
from retuner.drivers.closing import Closes
from retuner.drivers.device import BusError, LinkState
from retuner.schedule.late_dataclass import dataclass, field

# ---- What a bus's socket knows and python-can does not tell

SO_RCVBUFFORCE = 33  # linux/asm-generic/socket.h; beyond rmem_max, for who may
SO_MEMINFO = 55  # linux, since 4.12
DROPS = 8  # SK_MEMINFO_DROPS, place of the count among the 32-bit numbers
QUEUE_BYTES = 1 << 23
"""Receive queue that is asked for: about 10,000 frames, over a second of a full 1 Mbit/s bus. Unprivileged processes
get what net.core.rmem_max allows."""
WRAP = 1 << 32


class SocketProbe:
    """A second handle on a bus's socket; where there is no socket, or the system lacks the counter, it knows nothing.

    fileno : of the socket, -1 without one.
    bound_to : interface that the socket must stay bound to, empty when that has no meaning.
    """

    def __init__(self, fileno: int, bound_to: str = "") -> None:
        self._bound_to = bound_to
        self._socket: socket.socket | None = None
        self._counted = 0
        if fileno < 0 or sys.platform != "linux":
            return
        with contextlib.suppress(OSError):
            self._socket = socket.socket(fileno=os.dup(fileno))
            assert self._socket is not None
            try:
                self._socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, QUEUE_BYTES)
            except OSError:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE_BYTES)
            self.drops()  # those of before do not count

    def drops(self) -> int:
        """Frames that the kernel has dropped since the last call; none where it does not count them."""
        if self._socket is None:
            return 0
        try:
            raw = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 4 * (DROPS + 1))
        except OSError:
            return 0
        if len(raw) < 4 * (DROPS + 1):
            return 0
        before, self._counted = self._counted, int(struct.unpack_from("=I", raw, 4 * DROPS)[0])
        return (self._counted - before) % WRAP

    def is_unbound(self) -> bool:
        """Whether the interface went away under the socket."""
        if self._socket is None or not self._bound_to:
            return False
        try:
            name: str | tuple[str, ...] = self._socket.getsockname()
        except OSError:
            return True
        return self._bound_to not in (name, name[0])

    def close(self) -> None:
        """Let go of the socket; more than once does no harm."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


# ---- What can go wrong with a link: named, counted, told.
#
# Every fault is counted at once. Telling is rationed: a fault is told when it first happens and then at most every
# TELL_EVERY_S, with how often it has happened since; a cable that chatters must not fill the ledger.
#
# Error frames are those of SocketCAN (linux/can/error.h): the class of the error in the identifier, the state of the
# controller in the second byte.

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

CONTROLLER_STATES = (
    (0x03, LinkFault.OVERFLOW), (0x30, LinkFault.ERROR_PASSIVE), (0x0C, LinkFault.ERROR_WARNING),
)  # fmt: skip
"""Bits of the controller's state, the worst first: queue overflown, error counters over 127, over 96."""
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
    told = (fault for bits, fault in CONTROLLER_STATES if kind & CONTROLLER_CLASS and state & bits)
    return next(told, LinkFault.ERROR_FRAME)


def fault_of_error(error: BaseException, otherwise: LinkFault) -> LinkFault:
    """What an exception of python-can or the system says; otherwise : when it does not say."""
    if is_full(error):
        return LinkFault.TRANSMIT_FULL
    number = error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
    return BY_ERRNO.get(number, otherwise) if number is not None else otherwise


def is_garbage(error: BaseException) -> bool:
    """Whether a receive failed on what came (a datagram that is no frame) and not on the socket."""
    return isinstance(error.__cause__, Exception) and not isinstance(error.__cause__, OSError)


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


# ---- A CAN link that survives

__all__ = ["CanLink", "LinkCounters", "LinkSettings"]

SEND_TIMEOUT_S = 0.05  # longest wait for room in the transmit queue
ECHOES_KEPT = 256  # own frames on udp_multicast whose echo is still awaited; a lost echo falls out at the end


class CanLink(Closes):
    """A bus that never raises once it has been opened.

    settings : interface, channel and patience.
    clock : for ages, back-off and the time stamps of the log.
    log : file for all frames both ways; its suffix chooses python-can's format (.blf, .asc, ...).

    Raises BusError: the bus or the log cannot be opened.
    """

    def __init__(self, settings: LinkSettings, clock: Clock, log: Path | None = None) -> None:
        self.settings = settings
        self.counters = LinkCounters()
        self.faults = FaultBook()
        self._clock = clock
        self._own: deque[tuple[int, bytes]] = deque(maxlen=ECHOES_KEPT)
        self._bus: can.BusABC | None = None
        self._probe = SocketProbe(-1)
        self._probe_s = clock.now_s()
        self._full = False
        self._last_frame_s: float | None = None
        self._heard = self._silence_is_normal = False
        self._datagrams = settings.interface == UDP_MULTICAST
        self._pause_s = settings.reopen_first_s
        self._next_open_s = clock.now_s()
        self._log = BusLog(log, clock, settings.log_bytes_max) if log is not None else None
        try:
            self._open()
        except BusError:
            self._stop_log()
            raise

    @property
    def state(self) -> LinkState:
        """DOWN: the bus is not open; UP: a frame came within silent_after_s; SILENT: it did not."""
        if self._bus is None:
            return LinkState.DOWN
        last = self._last_frame_s
        heard = last is not None and self._clock.now_s() - last <= self.settings.silent_after_s
        return LinkState.UP if heard else LinkState.SILENT

    def send(self, message: can.Message) -> bool:
        """Send a frame; False when the bus is down or did not take it (the protocol above repeats what matters)."""
        bus = self._bus or self._opened()
        if bus is None:
            return False
        try:
            bus.send(message, timeout=0.0 if self._full else SEND_TIMEOUT_S)
        except BUS_ERRORS as error:
            self.counters.send_failures += 1
            self._full = is_full(error)  # the next ones do not wait as well: the loop has other things to do
            if self._full:
                self.faults.note(LinkFault.TRANSMIT_FULL)
            else:
                self._fail(fault_of_error(error, LinkFault.SEND))
            return False
        self._full = False
        self.counters.sent += 1
        if self._datagrams:
            self._own.append((message.arbitration_id, bytes(message.data)))
        self._write_log(message, received=False)
        return True

    def note(self, message: can.Message) -> None:
        """Put a frame into the log, if there is one, and on no bus. Never raises."""
        self._write_log(message, received=False)

    def receive_all(self, limit: int = 10_000) -> list[can.Message]:
        """All frames that have arrived, oldest first, at most limit; own echoes and error frames left out."""
        messages = self._receive(limit)
        self.counters.received += len(messages)
        if self._log is not None:
            for message in messages:
                self._write_log(message, received=True)
        now_s = self._clock.now_s()
        if messages:
            self._heard = True
            self._last_frame_s = now_s
            if self._bus is not None:
                self._pause_s = self.settings.reopen_first_s
        elif self._heard and not self._silence_is_normal and self.state is LinkState.SILENT:
            self._fail(LinkFault.DEAF)
        # Count what the kernel has dropped; now and then see whether the interface has gone without an error
        lost = self._probe.drops()
        if lost:
            self.counters.overflows += lost
            self.faults.note(LinkFault.OVERFLOW, lost)
        if now_s >= self._probe_s:
            self._probe_s = now_s + self.settings.reopen_first_s
            if self._probe.is_unbound():
                self._fail(LinkFault.INTERFACE_GONE)
        return messages

    def _receive(self, limit: int) -> list[can.Message]:
        """Other nodes' frames; this loop is the cost of a frame, so it looks nothing up twice."""
        messages: list[can.Message] = []
        garbage = 0
        bus = self._bus or self._opened()
        while bus is not None and len(messages) < limit:
            try:
                message = bus.recv(timeout=0.0)
            except BUS_ERRORS as error:
                garbage += 1
                # The bus to go on with after a receive failed: the same one after so little garbage, else none for now
                if is_garbage(error):
                    bus = self._after_garbage(garbage)
                else:
                    self._fail(fault_of_error(error, LinkFault.RECEIVE))
                    bus = self._bus
                continue
            if message is None:
                break
            # python-can takes a datagram with an identifier of 0.5, or true
            if self._datagrams and not (type(message.arbitration_id) is int and message.arbitration_id >= 0):
                garbage += 1
                bus = self._after_garbage(garbage)
            elif message.is_error_frame:
                self.counters.error_frames += 1
                fault = fault_of_frame(message)
                if fault is LinkFault.BUS_OFF:
                    self._fail(fault)
                else:
                    self.faults.note(fault)
                bus = self._bus
            elif not self._own or not self._take_echo(message):
                messages.append(message)
        return messages

    def news(self) -> list[FaultNews]:
        """Faults that have happened since the last call and are to be told: see LinkFault."""
        return self.faults.news(self._clock.now_s())

    def expect_silence(self) -> None:
        """Do not open the bus anew when nothing comes: this end hears only who has something to say to it."""
        self._silence_is_normal = True

    def wait_until(self, t_s: float) -> None:
        """Return when a frame may be there or the clock has reached t_s (only the latter on buses without a file)."""
        left_s = self._clock.left_s(t_s)
        fileno = self._fileno() if left_s > 0 else -1
        if fileno < 0:
            self._clock.wait_until(t_s)
            return
        try:
            select.select([fileno], [], [], left_s)
        except (OSError, ValueError) as error:
            self._fail(fault_of_error(error, LinkFault.RECEIVE))

    def close(self) -> None:
        """Close bus and log; a second time does nothing."""
        self._shut()
        self._next_open_s = float("inf")
        self._stop_log()

    def _opened(self) -> can.BusABC | None:
        if self._bus is None and self._clock.now_s() >= self._next_open_s:
            try:
                self._open()
            except BusError:
                self._fail(LinkFault.OPEN)
        return self._bus

    def _open(self) -> None:
        settings = self.settings
        self._bus = open_bus(settings.interface, settings.channel, settings.hop_limit, settings.options)
        self._probe = SocketProbe(self._fileno(), settings.channel if settings.interface == SOCKETCAN else "")
        self.counters.opened += 1
        self._heard = self._full = False

    def _fail(self, fault: LinkFault) -> None:
        """Close the bus, and put the next attempt to open it off, twice as long each time, up to the limit."""
        self.faults.note(fault)
        self._shut()
        self._next_open_s = self._clock.now_s() + self._pause_s
        self._pause_s = min(2 * self._pause_s, self.settings.reopen_max_s)

    def _shut(self) -> None:
        bus, self._bus = self._bus, None
        self._probe.close()
        if bus is not None:
            with contextlib.suppress(*BUS_ERRORS):
                bus.shutdown()

    def _fileno(self) -> int:
        """File to wait on, -1 without one."""
        try:
            return self._bus.fileno() if self._bus is not None else -1
        except BUS_ERRORS:
            return -1

    def _after_garbage(self, garbage: int) -> can.BusABC | None:
        """The next frame when what came is none."""
        self.counters.garbage += 1
        self.faults.note(LinkFault.GARBAGE)
        if garbage > self.settings.garbage_limit:
            self._fail(LinkFault.RECEIVE)
        return self._bus

    def _take_echo(self, message: can.Message) -> bool:
        """Whether this is a frame that we sent on udp_multicast, which hands each frame to its sender as well."""
        frame = (message.arbitration_id, bytes(message.data))
        if frame not in self._own:
            return False
        self._own.remove(frame)
        self.counters.echoes += 1
        return True

    def _write_log(self, message: can.Message, *, received: bool) -> None:
        if self._log is not None and not self._log.write(message, received=received):
            self.faults.note(LinkFault.LOG)

    def keep_log(self) -> None:
        """Have on disk, from the next frame on, what the log holds: any thread may ask."""
        if self._log is not None:
            self._log.keep = True

    def _stop_log(self) -> None:
        """End the log; what cannot be written any more is lost."""
        if self._log is not None and not self._log.stop():
            self.faults.note(LinkFault.LOG)
