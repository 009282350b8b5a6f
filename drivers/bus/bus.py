"""A CAN link that survives: python-can underneath, liveness by the age of the last frame, re-opening with back-off.

Why not python-can's Notifier: its thread dies on the first bus error; after `ip link del/add` the old socket receives
nothing for ever without any error; a garbage datagram on udp_multicast raises in the reader. Hence no thread, and
silence of a link that was heard before is answered by opening the bus anew as well. What goes wrong is named in
link_faults.py, counted, and told by news().
"""

import contextlib
import select
from collections import deque
from pathlib import Path
from types import TracebackType

import can

from retuner.drivers.bus.bus_log import BusLog
from retuner.drivers.bus.bus_opening import BUS_ERRORS, SOCKETCAN, UDP_MULTICAST, open_bus
from retuner.drivers.bus.link_faults import (
    FaultBook,
    FaultNews,
    LinkFault,
    fault_of_error,
    fault_of_frame,
    is_full,
    is_garbage,
    is_well_formed,
)
from retuner.drivers.bus.link_settings import LinkCounters, LinkSettings
from retuner.drivers.bus.socket_probe import SocketProbe
from retuner.drivers.clock import Clock
from retuner.drivers.device import BusError, LinkState

__all__ = ["CanLink", "LinkCounters", "LinkSettings"]

SEND_TIMEOUT_S = 0.05  # longest wait for room in the transmit queue
ECHOES_KEPT = 256  # own frames on udp_multicast whose echo is still awaited; a lost echo falls out at the end


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
        if self._log is not None:
            self._write_log(message, received=False)
        return True

    def note(self, message: can.Message) -> None:
        """Put a frame into the log, if there is one, and on no bus. Never raises."""
        if self._log is not None:
            self._write_log(message, received=False)

    def receive_all(self, limit: int = 10_000) -> list[can.Message]:
        """All frames that have arrived, oldest first, at most limit; own echoes and error frames left out."""
        messages = self._receive(limit)
        self.counters.received += len(messages)
        if self._log is not None:
            for message in messages:
                self._write_log(message, received=True)
        if messages:
            self._heard = True
            self._last_frame_s = self._clock.now_s()
            if self._bus is not None:
                self._pause_s = self.settings.reopen_first_s
        elif self._heard and not self._silence_is_normal and self.state is LinkState.SILENT:
            self._fail(LinkFault.DEAF)
        # Count what the kernel has dropped; now and then see whether the interface has gone without an error
        lost = self._probe.drops()
        if lost:
            self.counters.overflows += lost
            self.faults.note(LinkFault.OVERFLOW, lost)
        now_s = self._clock.now_s()
        if now_s >= self._probe_s:
            self._probe_s = now_s + self.settings.reopen_first_s
            if self._probe.is_unbound():
                self._fail(LinkFault.INTERFACE_GONE)
        return messages

    def _receive(self, limit: int) -> list[can.Message]:
        """Other nodes' frames; this loop is the cost of a frame, so it looks nothing up twice."""
        messages: list[can.Message] = []
        garbage = 0
        bus = self._opened()
        while bus is not None and len(messages) < limit:
            try:
                message = bus.recv(timeout=0.0)
            except BUS_ERRORS as error:
                garbage += 1
                bus = self._after(error, garbage)
                continue
            if message is None:
                break
            if self._datagrams and not is_well_formed(message):
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
        """Faults that have happened since the last call and are to be told: see link_faults.py."""
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

    def __enter__(self) -> "CanLink":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _opened(self) -> can.BusABC | None:
        """The bus, opened anew if it is down and the pause is over."""
        if self._bus is None and self._clock.now_s() >= self._next_open_s:
            try:
                self._open()
            except BusError:
                self.faults.note(LinkFault.OPEN)
                self._back_off()
        return self._bus

    def _open(self) -> None:
        """Open the bus; BusError when it does not."""
        settings = self.settings
        self._bus = open_bus(settings.interface, settings.channel, settings.hop_limit, settings.options)
        self._probe = SocketProbe(self._fileno(), settings.channel if settings.interface == SOCKETCAN else "")
        self.counters.opened += 1
        self._heard = self._full = False

    def _fail(self, fault: LinkFault) -> None:
        """Close the bus and wait with the next attempt."""
        self.counters.failures += 1
        self.faults.note(fault)
        self._shut()
        self._back_off()

    def _back_off(self) -> None:
        """Put the next attempt to open off, twice as long each time, up to the limit."""
        self._next_open_s = self._clock.now_s() + self._pause_s
        self._pause_s = min(2 * self._pause_s, self.settings.reopen_max_s)

    def _shut(self) -> None:
        """Close the bus whatever state it is in."""
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

    def _after(self, error: BaseException, garbage: int) -> can.BusABC | None:
        """The bus to go on with after a receive failed: the same one after so little garbage, else none for now."""
        if is_garbage(error):
            return self._after_garbage(garbage)
        self._fail(fault_of_error(error, LinkFault.RECEIVE))
        return self._bus

    def _after_garbage(self, garbage: int) -> can.BusABC | None:
        """The same when what came is no frame."""
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
        """Write a frame to the log, if there is one."""
        if self._log is not None and not self._log.write(message, received=received):
            self._log_failed()

    def _stop_log(self) -> None:
        """End the log; what cannot be written any more is lost."""
        if self._log is not None and not self._log.stop():
            self._log_failed()

    def _log_failed(self) -> None:
        self.counters.log_failures += 1
        self.faults.note(LinkFault.LOG)
