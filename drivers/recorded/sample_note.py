"""Samples of a foreign controller as frames in the log of its session.

Such a controller counts nothing, so which frames made a sample, and which number it got, hangs on when the host looked:
no log has that. The host therefore notes each sample that it has made, as a frame that never was on the bus: CAN FD, 64
bytes, 29-bit identifier. A replay takes these notes and decides again, to the last digit, what was decided then.

    bytes 0 to 47    t_s, sp, pv, co, x, x2 as float64, little-endian
    bytes 48 to 51   revision (16 bits), mode, limited (signed)
    the rest         zero
"""

import struct
import zlib

import can

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.telemetry.sample_assembly import AssembledSample

NOTES = 0x1F000000
"""Identifiers of notes begin here; J1939 and all 11-bit protocols leave them alone, and they are on no bus anyway."""
LOOPS = 1 << 24
NUMBERS = struct.Struct("<6dHBb")
LENGTH = 64


def note_id(loop: str) -> int:
    """The identifier of a loop's notes: loops may share a log."""
    return NOTES + zlib.crc32(loop.encode()) % LOOPS


def note_of(sample: LoopSample, identifier: int) -> can.Message:
    """The frame that stands for a sample."""
    numbers = sample.t_s, sample.sp, sample.pv, sample.co, sample.x, sample.x2
    data = NUMBERS.pack(*numbers, sample.revision, sample.mode, sample.limited)
    return can.Message(arbitration_id=identifier, is_extended_id=True, is_fd=True, data=data.ljust(LENGTH, b"\0"))


def sample_of(message: can.Message, identifier: int) -> LoopSample | None:
    """The sample for which a logged frame stands; None for what was on the bus."""
    if message.arbitration_id != identifier or not (message.is_extended_id and message.is_fd) or message.is_rx:
        return None
    if len(message.data) != LENGTH:
        return None
    t_s, sp, pv, co, x, x2, revision, mode, limited = NUMBERS.unpack_from(message.data)
    return LoopSample(t_s, sp, pv, co, mode, limited, x, revision, x2)


class Notes:
    """The samples of one loop out of a log: the same use as Overhearing."""

    def __init__(self, loop: str) -> None:
        self._identifier = note_id(loop)

    def take(self, message: can.Message) -> AssembledSample | None:
        """The sample that a logged frame stands for. How many were lost before it the ledger says."""
        sample = sample_of(message, self._identifier)
        return None if sample is None else AssembledSample(sample, 0)

    def contact_lost(self) -> None:
        """Do nothing: nothing is carried over from sample to sample here."""
