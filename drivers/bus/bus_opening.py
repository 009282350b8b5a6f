"""Opening a bus or its log, with every way to fail told in one line: what, where, and what to do."""

import errno
import logging
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import can
from can.interfaces.virtual import VirtualBus
from can.io.generic import SizedMessageWriter

from retuner.drivers.clock import Clock
from retuner.drivers.device import BusError

BUS_ERRORS = (can.CanError, OSError, ValueError, TypeError, NotImplementedError, ImportError)
SOCKETCAN, UDP_MULTICAST, VIRTUAL = "socketcan", "udp_multicast", "virtual"

# python-can warns about half-opened buses on stderr; what matters is in the BusError.
logging.getLogger("can").addHandler(logging.NullHandler())


def open_bus(interface: str, channel: str, hop_limit: int, options: Mapping[str, Any]) -> can.BusABC:
    """Open a python-can bus. Raises BusError: it cannot be opened; the line says why and what to do."""
    try:
        if interface == UDP_MULTICAST:
            return open_group(channel, hop_limit=hop_limit, **options)
        if interface == VIRTUAL:
            return InProcessBus(channel, **options)
        return can.Bus(interface=interface, channel=channel, **options)
    except BUS_ERRORS as error:
        raise BusError(
            f"bus {interface} {channel}: cannot open it: {error}; {_advice(interface, channel, error)}"
        ) from error


class InProcessBus(VirtualBus):
    """python-can's virtual bus, whose frames are taken without a lock: a tenth of a simulated run."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """See can.BusABC."""
        if timeout != 0.0 or self.queue.maxsize or self._filters or not self._open:
            return super().recv(timeout)
        try:
            frame: can.Message = self.queue.queue.popleft()
        except IndexError:
            return None
        return frame


def open_group(channel: str, **options: Any) -> can.BusABC:
    """A multicast group as a bus of this machine."""
    from retuner.drivers.bus.multicast import GroupBus  # noqa: PLC0415  only who uses it needs its package

    return GroupBus(channel, **options)


def known_interfaces() -> list[str]:
    """Names of python-can's interfaces, in alphabetical order."""
    return sorted(can.VALID_INTERFACES)


def _advice(interface: str, channel: str, error: BaseException) -> str:
    if interface not in can.VALID_INTERFACES:
        return f"interfaces of python-can: {', '.join(known_interfaces())}"
    if "msgpack" in str(error):
        return 'install it with: pip install "retuner[udp]"'
    if interface == UDP_MULTICAST:
        return f"give a multicast group such as 239.74.163.2 and have a route to it (ip route add {channel} dev lo)"
    number = error.errno if isinstance(error, OSError) else None
    if number == errno.EAFNOSUPPORT:
        return "this kernel has no CAN; use --interface udp_multicast, or virtual within one process"
    if number == errno.ENODEV:
        return f"make it with: ip link add dev {channel} type vcan && ip link set {channel} up"
    return "see python-can's documentation of this interface for what it needs"


def open_log(path: Path) -> can.io.generic.MessageWriter:
    """Open a log of bus traffic; the suffix chooses the format.

    Raises BusError: the file cannot be made, or no format has this suffix.
    """
    try:
        return can.Logger(path)
    except BUS_ERRORS as error:
        raise BusError(
            f"{path}: cannot log frames here: {error}; name a .blf or .asc file in a folder that exists"
        ) from error


# ---- The log of bus traffic: every frame both ways under our clock. A log that fails ends; the loop goes on.
#
# A log with a limit has two parts: bus.blf grows to half of the limit and becomes bus-1.blf, which the next full part,
# bus-2.blf, replaces. So the number of the older part says how much of the beginning is gone: all parts below it.

WRITING_ERRORS = (OSError, ValueError, OverflowError, struct.error)
"""What python-can's writers raise: the system's refusals, and numbers that their format has no room for."""
LOOK_EVERY = 1000  # frames between two looks at the size of the file; compressed they are some 20 kB


class LogParts(NamedTuple):
    """The files of one log, oldest first, and how many before them are gone."""

    paths: tuple[Path, ...]
    gone: int


def log_parts(path: Path) -> LogParts:
    """The parts that are there of a log that was begun at path; path itself is always the last."""
    pattern = re.compile(re.escape(path.stem) + r"-([1-9][0-9]*)" + re.escape(path.suffix))
    there = path.parent.iterdir() if path.parent.is_dir() else ()
    found = {int(match[1]): one for one in there if (match := pattern.fullmatch(one.name))}
    numbers = sorted(found)
    return LogParts((*(found[number] for number in numbers), path), numbers[0] - 1 if numbers else 0)


class BusLog:
    """A log file; python-can chooses the format by its suffix.

    path : file. clock : for the time stamps. most_bytes : of both parts together, infinite for one part without limit.
        The frames between two looks may come on top.

    Raises BusError: the file cannot be made, or no format has this suffix.
    """

    def __init__(self, path: Path, clock: Clock, most_bytes: float = float("inf")) -> None:
        self._path = path
        self._clock = clock
        self._part_bytes = most_bytes / 2
        self._full_parts = self._frames = 0
        self.keep = False  # with the next frame all that was written goes to the disk
        self._writer: can.io.generic.MessageWriter | None = open_log(path)

    def write(self, message: can.Message, *, received: bool) -> bool:
        """Write a frame; False when the log has failed with this one and is closed. After that it takes nothing."""
        if self._writer is None:
            return True
        message.timestamp = self._clock.stamp_s()
        message.channel = None  # a log is of one link; its channel's name must not make equal runs differ
        message.is_rx = received
        try:
            self._writer.on_message_received(message)
            self._frames += 1
            if self.keep and isinstance(self._writer, can.BLFWriter):  # which holds 128 kB of frames back
                self.keep = False
                self._writer.stop()
                self._writer = can.BLFWriter(self._path, append=True)
            if self._frames % LOOK_EVERY:
                return True
            # the newest part as its writer knows it: with what is not in the file yet
            writer = self._writer
            size = writer.file_size() if isinstance(writer, SizedMessageWriter) else self._path.stat().st_size
            if size >= self._part_bytes:
                self._writer = None
                writer.stop()
                before = self._part(self._full_parts)
                self._full_parts += 1
                self._path.replace(self._part(self._full_parts))
                before.unlink(missing_ok=True)
                self._writer = open_log(self._path)
        except (*WRITING_ERRORS, BusError):
            self.stop()
            return False
        return True

    def stop(self) -> bool:
        """End the log; False when its last frames could not be written. Its file is closed all the same."""
        writer, self._writer = self._writer, None
        if writer is None:
            return True
        try:
            writer.stop()
        except WRITING_ERRORS:
            return False
        return True

    def _part(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.stem}-{number}{self._path.suffix}")
