"""A frame's bytes to numbers and back, prepared once from the DBC.

cantools reads the DBC and stays the reference; this does the same arithmetic on the same bits (the tests compare them
bit for bit) without asking each time what is known beforehand; benchmarks/bus_throughput.py has the ratios. It takes
what retuner.dbc needs: little-endian signals, whole numbers with a linear scale, float32 on byte borders.
"""

import struct
from collections.abc import Iterable
from typing import NamedTuple

from cantools.database.can.message import Message as Layout
from cantools.database.can.signal import Signal

FLOAT_BITS = 32
_FLOAT32 = struct.Struct("<f")


class _Field(NamedTuple):
    """One signal: is_float; start in bytes (float) or bits; mask and sign bit of the raw number; scale; range."""

    is_float: bool
    start: int
    mask: int
    sign: int
    scale: float
    offset: float
    low: float
    high: float


class BitLayout:
    """The signals of one frame in a given order.

    Parameters
    ----------
    layout : of the frame, from cantools.
    order : names of the signals; those that are not named are packed as zero and not unpacked.

    Raises
    ------
    ValueError
        A signal is of a kind that this does not take, has no range, or its range does not fit its bits.
    """

    def __init__(self, layout: Layout, order: Iterable[str]) -> None:
        self._length = layout.length
        self._fields = tuple(_field(layout.name, layout.get_signal_by_name(name)) for name in order)

    def range_of(self, place: int) -> tuple[float, float]:
        """Least and greatest value of the signal at this place of the order."""
        return self._fields[place].low, self._fields[place].high

    def unpack(self, data: bytes | bytearray) -> list[float] | None:
        """The numbers in data, which must have the frame's length; None when one is not finite or out of range."""
        whole = int.from_bytes(data, "little")
        values: list[float] = []
        for is_float, start, mask, sign, scale, offset, low, high in self._fields:
            value: float
            if is_float:
                value = _FLOAT32.unpack_from(data, start)[0]
            else:
                raw = whole >> start & mask
                if raw & sign:
                    raw -= mask + 1
                value = raw if scale == 1 and not offset else raw * scale + offset
            if not low <= value <= high:
                return None
            values.append(value)
        return values

    def pack(self, values: Iterable[float]) -> bytearray:
        """The frame's bytes; every number must be within its range."""
        whole = 0
        for value, (is_float, start, mask, _, scale, offset, _, _) in zip(values, self._fields, strict=True):
            if is_float:
                whole |= int.from_bytes(_FLOAT32.pack(value), "little") << 8 * start
            else:
                raw = round(value if scale == 1 and not offset else (value - offset) / scale)
                whole |= (raw & mask) << start
        return bytearray(whole.to_bytes(self._length, "little"))


def _field(frame: str, signal: Signal) -> _Field:
    """What is known of a signal beforehand."""
    where = f"{frame}.{signal.name}"
    low, high = signal.minimum, signal.maximum
    if low is None or high is None:
        raise ValueError(f"{where} has no range; give it one")
    if signal.byte_order != "little_endian" or signal.is_multiplexer or signal.multiplexer_ids:
        raise ValueError(f"{where}: only plain little-endian signals are laid out")
    if signal.is_float:
        if signal.length != FLOAT_BITS or signal.start % 8 or (signal.scale, signal.offset) != (1, 0):
            raise ValueError(f"{where}: only unscaled float32 on byte borders is laid out")
        return _Field(True, signal.start // 8, 0, 0, 1, 0, float(low), float(high))
    mask = (1 << signal.length) - 1
    sign = 1 << signal.length - 1 if signal.is_signed else 0
    ends = [raw * signal.scale + signal.offset for raw in (-sign, mask - sign)]
    if not min(ends) <= low <= high <= max(ends):
        raise ValueError(f"{where}: range {low}..{high} does not fit its {signal.length} bits")
    return _Field(False, signal.start, mask, sign, signal.scale, signal.offset, float(low), float(high))
