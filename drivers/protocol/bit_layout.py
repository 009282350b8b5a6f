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


class _Piece(NamedTuple):
    """Whole bytes of the frame that the struct reads as one: a signal that it can hold, or a group of others."""

    start: int
    length: int
    signals: tuple[Signal, ...]
    is_group: bool

    @property
    def is_alone(self) -> bool:
        """Whether one signal fills it that the struct holds as bytes only, or that has a scale."""
        return self.is_group and len(self.signals) == 1 and self.signals[0].length == 8 * self.length


class _Alone(NamedTuple):
    """A signal that fills its bytes: slot, whether the struct gives bytes, their number, sign, scale, place."""

    slot: int
    is_bytes: bool
    length: int
    signed: bool
    scale: float
    offset: float
    place: int


class _Odd(NamedTuple):
    """A signal in a group: slot of the group among the pieces; first bit in it, mask and sign bit of the raw number,
    scale and offset; place of its value in the order.
    """

    slot: int
    shift: int
    mask: int
    sign: int
    scale: float
    offset: float
    place: int


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
        self._bounds = tuple((i, *self.ranges[i]) for i, signal in enumerate(signals) if not _is_full(signal))
        place = {name: i for i, name in enumerate(order)}
        pieces = _pieces(signals)
        self._struct = struct.Struct("<" + _codes(pieces, layout.length))
        self._plain = tuple((i, place[p.signals[0].name]) for i, p in enumerate(pieces) if not p.is_group)
        groups = [(i, p) for i, p in enumerate(pieces) if p.is_group and not p.is_alone]
        self._wide = tuple((i, p.length) for i, p in groups if 8 * p.length not in CODES)
        self._odd = tuple(_odd(i, p.start, s, place[s.name]) for i, p in groups for s in p.signals)
        self._alone = tuple(_alone(i, p, place[p.signals[0].name]) for i, p in enumerate(pieces) if p.is_alone)
        self._is_direct = not self._odd and not self._alone
        self._blank = [0] * len(pieces)
        source = {at: slot for slot, at in self._plain} | {field.place: field.slot for field in self._alone}
        source |= {field.place: len(pieces) + i for i, field in enumerate(self._odd)}
        self._to_order = _picker([source[i] for i in range(len(signals))])

    def outside(self, values: Sequence[float]) -> int | None:
        """Place in the order of the first number that is not finite or out of range; None when all are well."""
        for place, (low, high) in enumerate(self.ranges):
            if not low <= values[place] <= high:
                return place
        return None

    def unpack(self, data: bytes | bytearray) -> Sequence[float] | None:
        """The numbers in data, which must have the frame's length; None when one is not finite or out of range."""
        raw: Any = self._struct.unpack(data)
        if not self._is_direct:
            raw = [*raw]
            for slot, is_bytes, _, signed, scale, offset, _ in self._alone:
                number = int.from_bytes(raw[slot], "little", signed=signed) if is_bytes else raw[slot]
                raw[slot] = number if scale == 1 and not offset else number * scale + offset
            for slot, _ in self._wide:
                raw[slot] = int.from_bytes(raw[slot], "little")
            for slot, shift, mask, sign, scale, offset, _ in self._odd:
                number = raw[slot] >> shift & mask
                if number & sign:
                    number -= mask + 1
                raw.append(number if scale == 1 and not offset else number * scale + offset)
        values = self._to_order(raw)
        for place, low, high in self._bounds:
            if not low <= values[place] <= high:
                return None
        return values

    def pack(self, values: Sequence[float]) -> bytearray:
        """The frame's bytes; every number must be within its range, which outside() tells."""
        raw: list[Any] = self._blank.copy()
        for slot, place in self._plain:
            raw[slot] = values[place]
        for slot, is_bytes, length, signed, scale, offset, place in self._alone:
            value = values[place]
            number = round(value if scale == 1 and not offset else (value - offset) / scale)
            raw[slot] = number.to_bytes(length, "little", signed=signed) if is_bytes else number
        for slot, shift, mask, _, scale, offset, place in self._odd:
            value = values[place]
            raw[slot] |= (round(value if scale == 1 and not offset else (value - offset) / scale) & mask) << shift
        for slot, length in self._wide:
            raw[slot] = raw[slot].to_bytes(length, "little")
        return bytearray(self._struct.pack(*raw))


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
            raise ValueError(f"{where}: only unscaled float32 on byte boundaries is laid out")
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
    unscaled = (signal.scale, signal.offset) == (1, 0)
    return signal.is_float or (unscaled and signal.start % 8 == 0 and signal.length in CODES)


def _pieces(signals: Iterable[Signal]) -> list[_Piece]:
    """The frame's bytes in their order: signals that a struct holds, and groups of others that share bytes."""
    pieces: list[_Piece] = []
    for signal in sorted(signals, key=lambda signal: signal.start):
        first, last = signal.start // 8, (signal.start + signal.length - 1) // 8
        before = pieces[-1] if pieces else None
        if before is not None and first < before.start + before.length:
            pieces[-1] = _Piece(before.start, last + 1 - before.start, (*before.signals, signal), True)
        else:
            pieces.append(_Piece(first, last + 1 - first, (signal,), not _is_plain(signal)))
    return pieces


def _codes(pieces: Iterable[_Piece], length: int) -> str:
    """What the struct module calls them; what lies between them is padding."""
    code, at = "", 0
    for piece in pieces:
        signal = piece.signals[0]
        letter = CODES.get(8 * piece.length, f"{piece.length}s")
        if not piece.is_group or (piece.is_alone and len(letter) == 1):
            letter = "f" if signal.is_float else letter.lower() if signal.is_signed else letter
        code += "x" * (piece.start - at) + letter
        at = piece.start + piece.length
    return code + "x" * (length - at)


def _alone(slot: int, piece: _Piece, place: int) -> _Alone:
    """What is known beforehand of a signal that fills its bytes."""
    signal = piece.signals[0]
    is_bytes = 8 * piece.length not in CODES
    return _Alone(slot, is_bytes, piece.length, signal.is_signed, signal.scale, signal.offset, place)


def _odd(slot: int, start: int, signal: Signal, place: int) -> _Odd:
    """What is known beforehand of a signal in the group that begins with byte `start`."""
    sign = 1 << signal.length - 1 if signal.is_signed else 0
    mask = (1 << signal.length) - 1
    return _Odd(slot, signal.start - 8 * start, mask, sign, signal.scale, signal.offset, place)
