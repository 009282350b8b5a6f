"""Counter and checksum of one message: put into what is sent, demanded of what comes."""

from collections.abc import Callable, Mapping
from functools import reduce
from operator import xor

import can
from cantools.database.can.message import Message as Layout
from cantools.database.can.signal import Signal

from retuner.drivers.dbc.dbc_file import bits_of
from retuner.drivers.profiles.controller_access import ProfileError
from retuner.drivers.profiles.mapping import Protection
from retuner.drivers.protocol.checksum import crc
from retuner.schedule.late_dataclass import dataclass

ID_BYTES = 2


@dataclass(slots=True)
class FrameGuard:
    """One message at work. Counts up from 0; a frame whose counter has not moved is old, and refused.

    counter : its signal, None for none. place, width : first byte and bytes of the checksum. big : byte order.
    """

    counter: Signal | None
    place: int
    width: int
    big: bool
    algorithm: Callable[[bytes], int] | None
    data_id: bytes
    _next: int = 0
    _seen: int | None = None

    def count(self, values: dict[str, float]) -> None:
        """Put the next count into the values of a frame."""
        if self.counter is not None:
            values[self.counter.name] = float(self._next * float(self.counter.scale) + float(self.counter.offset))
            self._next = (self._next + 1) % (1 << self.counter.length)

    def sealed(self, data: bytes) -> bytes:
        """The frame with its checksum."""
        if self.algorithm is None:
            return data
        covered = data[: self.place] + data[self.place + self.width :] + self.data_id
        sum_ = self.algorithm(covered).to_bytes(self.width, "big" if self.big else "little")
        return data[: self.place] + sum_ + data[self.place + self.width :]

    def accepts(self, data: bytes) -> bool:
        """Whether a frame is whole and newer than the last one."""
        if self.algorithm is not None and (len(data) < self.place + self.width or self.sealed(data) != data):
            return False
        if self.counter is None:
            return True
        places = bits_of(self.counter)
        if max(places) // 8 >= len(data):
            return False
        count = sum((data[at // 8] >> at % 8 & 1) << i for i, at in enumerate(places))
        new, self._seen = count != self._seen, count
        return new


def guard_of(layout: Layout, protection: Protection, source: str, key: tuple[str | int, ...]) -> FrameGuard:
    """The guard of a message.

    Raises ProfileError: no such signal or algorithm, or a checksum that is no whole byte of its width.
    """
    counter = _signal(layout, protection.counter, source, (*key, "counter"))
    checksum = _signal(layout, protection.checksum, source, (*key, "checksum"))
    data_id = b"" if protection.data_id is None else protection.data_id.to_bytes(ID_BYTES, "little")
    if checksum is None:
        return FrameGuard(counter, 0, 0, big=False, algorithm=None, data_id=data_id)
    algorithm = ALGORITHMS.get(protection.algorithm)
    if algorithm is None:
        known = ", ".join(ALGORITHMS)
        raise ProfileError(
            f"{source}: {layout.name}: no algorithm {protection.algorithm!r}; there is {known}", (*key, "algorithm")
        )
    bits, big = checksum.length, checksum.byte_order == "big_endian"
    first = checksum.start - 7 if big else checksum.start
    wanted = 16 if "16" in protection.algorithm else 8
    if bits != wanted or first % 8:
        raise ProfileError(
            f"{source}: {layout.name}.{checksum.name} has {bits} bits from bit {checksum.start}; "
            f"{protection.algorithm} needs {wanted} that begin with a byte",
            (*key, "checksum"),
        )
    return FrameGuard(counter, first // 8, bits // 8, big, algorithm, data_id)


def _signal(layout: Layout, name: str, source: str, key: tuple[str | int, ...]) -> Signal | None:
    if not name:
        return None
    found = [signal for signal in layout.signals if signal.name == name]
    if not found:
        names = ", ".join(signal.name for signal in layout.signals)
        raise ProfileError(f"{source}: message {layout.name!r} has no signal {name!r}; there is {names}", key)
    return found[0]


def data_frame(
    layout: Layout, frame_id: int, values: Mapping[str, float], guard: FrameGuard | None = None
) -> can.Message:
    """The frame of a message with these values of its signals, counted and sealed; errors as cantools' encode."""
    values = dict(values)
    if guard is not None:
        guard.count(values)
    data = layout.encode(values, scaling=True, padding=False, strict=False)
    sealed = data if guard is None else guard.sealed(data)
    extended = layout.is_extended_frame
    return can.Message(arbitration_id=frame_id, is_extended_id=extended, is_fd=layout.is_fd, data=sealed)


# Checksums and counters in foreign messages, by the name of the algorithm.
#
# The sum is over all bytes of the message but its own, in their order; with a data identifier this comes after them,
# low byte first, as in AUTOSAR E2E. The check values (over the ASCII digits 1 to 9) are those of Greg Cook's
# catalogue of parametrised CRC algorithms.

BYTE, WORD = 0xFF, 0xFFFF


ALGORITHMS: dict[str, Callable[[bytes], int]] = {
    "sum8": lambda data: sum(data) & BYTE,
    "sum8_inverted": lambda data: ~sum(data) & BYTE,
    "sum8_negated": lambda data: -sum(data) & BYTE,
    "xor8": lambda data: reduce(xor, data, 0),
    "crc8": lambda data: crc(data, 8, 0x07, 0x00, 0x00),
    "crc8_sae_j1850": lambda data: crc(data, 8, 0x1D, BYTE, BYTE),
    "crc8_autosar": lambda data: crc(data, 8, 0x2F, BYTE, BYTE),
    "crc16_ccitt": lambda data: crc(data, 16, 0x1021, WORD, 0),
    "crc16_xmodem": lambda data: crc(data, 16, 0x1021, 0, 0),
}
"""Every algorithm by its name."""
