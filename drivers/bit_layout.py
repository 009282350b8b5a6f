"""A frame's bytes to numbers and back, prepared once from the DBC.

cantools reads the DBC and stays the reference; this does the same arithmetic on the same bits (the tests compare them
bit for bit) without asking each time what is known beforehand; benchmarks/bus_throughput.py has the ratios. Signals
that a C struct can hold (unscaled, 8, 16 or 32 bits, float32, on byte borders) are read and written by one; the others
bit by bit. It takes what retuner.dbc needs: little-endian signals, whole numbers with a linear scale, float32.
"""

import struct
from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

from cantools.database.can.message import Message as Layout
from cantools.database.can.signal import Signal

FLOAT_BITS = 32
CODES = {8: "B", 16: "H", 32: "I"}  # of the struct module, unsigned; lower case is signed


class _Odd(NamedTuple):
    """A signal that no C struct holds: first bit, mask and sign bit of the raw number, scale."""

    start: int
    mask: int
    sign: int
    scale: float
    offset: float


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

    def __init__(self, layout: Layout, order: Sequence[str]) -> None:
        signals = [layout.get_signal_by_name(name) for name in order]
        self.ranges = tuple(_range(layout.name, signal) for signal in signals)
        plain = sorted((s for s in signals if _is_plain(s)), key=lambda signal: signal.start)
        odd = [signal for signal in signals if signal not in plain]
        self._length = layout.length
        self._struct = _struct(plain, layout.length)
        self._odd = tuple(_odd(signal) for signal in odd)
        stored = [signal.name for signal in (*plain, *odd)]
        self._to_order = _picker([stored.index(name) for name in order])
        self._from_order = _picker([list(order).index(name) for name in stored])
        self._plain = len(plain)
        self._bounds = tuple((i, *self.ranges[i]) for i, signal in enumerate(signals) if not _is_full(signal))

    def outside(self, values: Sequence[float]) -> int | None:
        """Place in the order of the first number that is not finite or out of range; None when all are well."""
        for place, (low, high) in enumerate(self.ranges):
            if not low <= values[place] <= high:
                return place
        return None

    def unpack(self, data: bytes | bytearray) -> Sequence[float] | None:
        """The numbers in data, which must have the frame's length; None when one is not finite or out of range."""
        values: Sequence[float] = self._struct.unpack(data)
        if self._odd:
            whole = int.from_bytes(data, "little")
            more = [*values]
            for start, mask, sign, scale, offset in self._odd:
                raw = whole >> start & mask
                if raw & sign:
                    raw -= mask + 1
                more.append(raw if scale == 1 and not offset else raw * scale + offset)
            values = more
        values = self._to_order(values)
        for place, low, high in self._bounds:
            if not low <= values[place] <= high:
                return None
        return values

    def pack(self, values: Sequence[float]) -> bytearray:
        """The frame's bytes; every number must be within its range, which outside() tells."""
        values = self._from_order(values)
        plain = bytearray(self._struct.pack(*values[: self._plain]))
        if not self._odd:
            return plain
        whole = int.from_bytes(plain, "little")
        for value, (start, mask, _, scale, offset) in zip(values[self._plain :], self._odd, strict=True):
            raw = round(value if scale == 1 and not offset else (value - offset) / scale)
            whole |= (raw & mask) << start
        return bytearray(whole.to_bytes(self._length, "little"))


def _picker(places: list[int]) -> Callable[[Sequence[float]], Sequence[float]]:
    """A function that gives the values at these places; itself when they are all in their order."""
    if places == list(range(len(places))):
        return lambda values: values
    pick: Callable[[Sequence[float]], Any] = itemgetter(*places)
    return pick if len(places) > 1 else lambda values: (pick(values),)


def _range(frame: str, signal: Signal) -> tuple[float, float]:
    """Range of a signal that can be laid out.

    Raises
    ------
    ValueError
        It cannot.
    """
    where = f"{frame}.{signal.name}"
    low, high = signal.minimum, signal.maximum
    if low is None or high is None:
        raise ValueError(f"{where} has no range; give it one")
    if signal.byte_order != "little_endian" or signal.is_multiplexer or signal.multiplexer_ids:
        raise ValueError(f"{where}: only plain little-endian signals are laid out")
    if signal.is_float:
        if signal.length != FLOAT_BITS or signal.start % 8 or (signal.scale, signal.offset) != (1, 0):
            raise ValueError(f"{where}: only unscaled float32 on byte borders is laid out")
    else:
        least, greatest = _reach(signal)
        if not least <= low <= high <= greatest:
            raise ValueError(f"{where}: range {low}..{high} does not fit its {signal.length} bits")
    return float(low), float(high)


def _reach(signal: Signal) -> tuple[float, float]:
    """Least and greatest number that the bits of a whole-number signal can say."""
    sign = 1 << signal.length - 1 if signal.is_signed else 0
    ends = [raw * signal.scale + signal.offset for raw in (-sign, (1 << signal.length) - 1 - sign)]
    return min(ends), max(ends)


def _is_full(signal: Signal) -> bool:
    """Whether every number that the bits can say is in range, so that reading needs no check."""
    return not signal.is_float and (signal.minimum, signal.maximum) == _reach(signal)


def _is_plain(signal: Signal) -> bool:
    """Whether a C struct holds it."""
    unscaled = (signal.scale, signal.offset) == (1, 0)
    return signal.is_float or (unscaled and signal.start % 8 == 0 and signal.length in CODES)


def _struct(plain: Iterable[Signal], length: int) -> struct.Struct:
    """The struct of signals in the order of their places; what lies between them is padding."""
    code, at = "<", 0
    for signal in plain:
        letter = "f" if signal.is_float else CODES[signal.length]
        code += "x" * (signal.start // 8 - at) + (letter.lower() if signal.is_signed else letter)
        at = (signal.start + signal.length) // 8
    return struct.Struct(code + "x" * (length - at))


def _odd(signal: Signal) -> _Odd:
    """What is known beforehand of a signal that is read bit by bit."""
    sign = 1 << signal.length - 1 if signal.is_signed else 0
    return _Odd(signal.start, (1 << signal.length) - 1, sign, signal.scale, signal.offset)
