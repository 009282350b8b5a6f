"""The log of bus traffic: every frame both ways under our clock. A log that fails ends; the loop goes on."""

import struct
from pathlib import Path

import can

from retuner.drivers.bus_opening import open_log
from retuner.drivers.clock import Clock

WRITING_ERRORS = (OSError, ValueError, OverflowError, struct.error)
"""What python-can's writers raise: the system's refusals, and numbers that their format has no room for."""


class BusLog:
    """A log file; python-can chooses the format by its suffix.

    Parameters
    ----------
    path : file. clock : for the time stamps.

    Raises
    ------
    BusError
        The file cannot be made, or no format has this suffix.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._clock = clock
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
        except WRITING_ERRORS:
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
