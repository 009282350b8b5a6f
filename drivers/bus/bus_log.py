"""The log of bus traffic: every frame both ways under our clock. A log that fails ends; the loop goes on.

A log with a limit has two parts: bus.blf grows to half of the limit and becomes bus-1.blf, which the next full part,
bus-2.blf, replaces. So the number of the older part says how much of the beginning is gone: all parts below it.
"""

import re
import struct
from pathlib import Path
from typing import NamedTuple

import can
from can.io.generic import SizedMessageWriter

from retuner.drivers.bus.bus_opening import open_log
from retuner.drivers.clock import Clock
from retuner.drivers.device import BusError

WRITING_ERRORS = (OSError, ValueError, OverflowError, struct.error)
"""What python-can's writers raise: the system's refusals, and numbers that their format has no room for."""
LOOK_EVERY = 1000
"""Frames between two looks at the size of the file; compressed they are some 20 kB."""


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

    Parameters
    ----------
    path : file. clock : for the time stamps. most_bytes : of both parts together, infinite for one part without limit.
        The frames between two looks may come on top.

    Raises
    ------
    BusError
        The file cannot be made, or no format has this suffix.
    """

    def __init__(self, path: Path, clock: Clock, most_bytes: float = float("inf")) -> None:
        self._path = path
        self._clock = clock
        self._part_bytes = most_bytes / 2
        self._full_parts = self._frames = 0
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
            if self._frames % LOOK_EVERY == 0 and self._size(self._writer) >= self._part_bytes:
                self._begin_part()
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

    def _size(self, writer: can.io.generic.MessageWriter) -> int:
        """Size of the newest part in bytes, as its writer knows it: with what is not in the file yet."""
        return writer.file_size() if isinstance(writer, SizedMessageWriter) else self._path.stat().st_size

    def _begin_part(self) -> None:
        """Put the full part aside, and the one before it away; killed in between, both are there and both are read."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.stop()
        before = self._part(self._full_parts)
        self._full_parts += 1
        self._path.replace(self._part(self._full_parts))
        before.unlink(missing_ok=True)
        self._writer = open_log(self._path)

    def _part(self, number: int) -> Path:
        """The file of a full part, counted from 1."""
        return self._path.with_name(f"{self._path.stem}-{number}{self._path.suffix}")
