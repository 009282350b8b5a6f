"""A CAN link that survives: python-can underneath, liveness by the age of the last frame, re-opening with back-off.

Why not python-can's Notifier: its thread dies on the first bus error; after `ip link del/add` the old socket receives
nothing for ever without any error; a garbage datagram on udp_multicast raises in the reader. Hence no thread, and
silence of a link that was heard before is answered by opening the bus anew as well.
"""

import contextlib
import errno
import select
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import TracebackType
from typing import Any

import can

from retuner.drivers.bus_opening import BUS_ERRORS, UDP_MULTICAST, open_bus, open_log
from retuner.drivers.clock import Clock
from retuner.drivers.device import BusError, LinkState

SEND_TIMEOUT_S = 0.05  # longest wait for room in the transmit queue
ECHOES_KEPT = 256  # own frames on udp_multicast whose echo is still awaited; a lost echo falls out at the end
TRANSMIT_QUEUE_FULL = (errno.ENOBUFS, errno.EAGAIN)


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """How to open a bus and when to doubt it.

    Parameters
    ----------
    interface, channel : as python-can spells them.
    hop_limit : routers that a udp_multicast frame may pass; 0 keeps it on this machine.
    options : further keyword arguments of python-can's Bus (bitrate, fd, ...).
    silent_after_s : age of the last frame after which the link counts as silent, s.
    reopen_first_s, reopen_max_s : first and longest pause between attempts to open the bus anew, s.
    garbage_limit : undecodable datagrams in one go after which the bus is opened anew.

    Raises
    ------
    ValueError
        A time is not positive, or hop_limit is outside 0..255.
    """

    interface: str = "virtual"
    channel: str = "retuner"
    hop_limit: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    silent_after_s: float = 10.0
    reopen_first_s: float = 0.2
    reopen_max_s: float = 5.0
    garbage_limit: int = 1000

    def __post_init__(self) -> None:
        for name in ("silent_after_s", "reopen_first_s", "reopen_max_s"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"bus: {name} = {getattr(self, name)}; give a positive number of seconds")
        if not 0 <= self.hop_limit <= 255:
            raise ValueError(f"bus: hop_limit = {self.hop_limit}; give 0 (this machine only) to 255")


@dataclass(slots=True)
class LinkCounters:
    """What the link has seen since it was made."""

    sent: int = 0
    send_failures: int = 0
    received: int = 0
    echoes: int = 0
    error_frames: int = 0
    garbage: int = 0
    failures: int = 0
    opened: int = 0
    log_failures: int = 0

    def to_dict(self) -> dict[str, int]:
        """Counter name to count."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


class CanLink:
    """A bus that never raises once it has been opened.

    Parameters
    ----------
    settings : interface, channel and patience.
    clock : for ages, back-off and the time stamps of the log.
    log : file for all frames both ways; its suffix chooses python-can's format (.blf, .asc, ...).

    Raises
    ------
    BusError
        The bus or the log cannot be opened.
    """

    def __init__(self, settings: LinkSettings, clock: Clock, log: Path | None = None) -> None:
        self.settings = settings
        self.counters = LinkCounters()
        self._clock = clock
        self._own: deque[tuple[int, bytes]] = deque(maxlen=ECHOES_KEPT)
        self._writer: can.io.generic.MessageWriter | None = None
        self._bus: can.BusABC | None = None
        self._last_frame_s: float | None = None
        self._heard = self._silence_is_normal = False
        self._pause_s = settings.reopen_first_s
        self._next_open_s = clock.now_s()
        if log is not None:
            self._writer = open_log(log)
        try:
            self._bus = open_bus(settings.interface, settings.channel, settings.hop_limit, settings.options)
        except BusError:
            self._stop_log()
            raise
        self.counters.opened += 1

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
        bus = self._opened()
        if bus is None:
            return False
        try:
            bus.send(message, timeout=SEND_TIMEOUT_S)
        except BUS_ERRORS as error:
            self.counters.send_failures += 1
            if not _is_full(error):
                self._fail()
            return False
        self.counters.sent += 1
        if self.settings.interface == UDP_MULTICAST:
            self._own.append((message.arbitration_id, bytes(message.data)))
        self._log(message, received=False)
        return True

    def receive_all(self, limit: int = 10_000) -> list[can.Message]:
        """All frames that have arrived, oldest first, at most limit; own echoes and error frames left out."""
        messages: list[can.Message] = []
        garbage = 0
        while len(messages) < limit and (bus := self._opened()) is not None:
            try:
                message = bus.recv(timeout=0.0)
            except BUS_ERRORS as error:
                garbage += 1
                if not _is_garbage(error) or garbage > self.settings.garbage_limit:
                    self._fail()
                    break
                self.counters.garbage += 1
                continue
            if message is None:
                break
            if self._is_ours(message):
                continue
            messages.append(message)
        if messages:
            self._heard = True
            self._last_frame_s = self._clock.now_s()
            if self._bus is not None:
                self._pause_s = self.settings.reopen_first_s
        elif self._heard and not self._silence_is_normal and self.state is LinkState.SILENT:
            self._fail()  # a socket whose interface was made anew is deaf without any error
        return messages

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
        except (OSError, ValueError):
            self._fail()

    def close(self) -> None:
        """Close bus and log; a second time does nothing."""
        self._shut()
        self._next_open_s = float("inf")
        self._stop_log()

    def __enter__(self) -> "CanLink":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _opened(self) -> can.BusABC | None:
        """The bus, opened anew if it is down and the pause is over."""
        now_s = self._clock.now_s()
        if self._bus is None and now_s >= self._next_open_s:
            settings = self.settings
            try:
                self._bus = open_bus(settings.interface, settings.channel, settings.hop_limit, settings.options)
            except BusError:
                self._back_off()
            else:
                self.counters.opened += 1
                self._heard = False
        return self._bus

    def _fail(self) -> None:
        """Close the bus and wait with the next attempt."""
        self.counters.failures += 1
        self._shut()
        self._back_off()

    def _back_off(self) -> None:
        """Put the next attempt to open off, twice as long each time, up to the limit."""
        self._next_open_s = self._clock.now_s() + self._pause_s
        self._pause_s = min(2 * self._pause_s, self.settings.reopen_max_s)

    def _shut(self) -> None:
        """Close the bus whatever state it is in."""
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(*BUS_ERRORS):
                bus.shutdown()

    def _fileno(self) -> int:
        """File to wait on, -1 without one."""
        try:
            return self._bus.fileno() if self._bus is not None else -1
        except BUS_ERRORS:
            return -1

    def _is_ours(self, message: can.Message) -> bool:
        """Count a frame; whether it is an echo of ours or an error frame."""
        if message.is_error_frame:
            self.counters.error_frames += 1
            return True
        if self._own and self._take_echo(message):
            self.counters.echoes += 1
            return True
        self.counters.received += 1
        self._log(message, received=True)
        return False

    def _take_echo(self, message: can.Message) -> bool:
        """Whether this is a frame that we sent on udp_multicast, which hands each frame to its sender as well."""
        frame = (message.arbitration_id, bytes(message.data))
        if frame not in self._own:
            return False
        self._own.remove(frame)
        return True

    def _log(self, message: can.Message, *, received: bool) -> None:
        """Write a frame to the log under our clock; a log that fails ends, the loop goes on."""
        if self._writer is None:
            return
        message.timestamp = self._clock.stamp_s()
        message.channel = None  # a log is of one link; its channel's name must not make equal runs differ
        message.is_rx = received
        try:
            self._writer.on_message_received(message)
        except OSError:
            self.counters.log_failures += 1
            self._stop_log()

    def _stop_log(self) -> None:
        """End the log; what cannot be written any more is lost, its file is closed all the same."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.stop()
            except OSError:
                self.counters.log_failures += 1


def _is_garbage(error: BaseException) -> bool:
    """Whether a receive failed on what came (a datagram that is no frame) and not on the socket."""
    return isinstance(error.__cause__, Exception) and not isinstance(error.__cause__, OSError)


def _is_full(error: BaseException) -> bool:
    """Whether a send failed because there was no room, which passes by itself."""
    return isinstance(error, can.CanTimeoutError) or getattr(error, "error_code", None) in TRANSMIT_QUEUE_FULL
