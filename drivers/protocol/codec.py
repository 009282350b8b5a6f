"""Frames to bytes and back as drivers/retuner.dbc lays them out, with our own checks on both ways.

Checks: cantools encodes NaN, decodes NaN, infinity and values outside the declared range, and accepts frames that are
too long, all without complaint. So every number is held to the DBC's range here, which NaN fails as well, and every
checksum and length is compared. decode() gives a frame or a Refused for any bytes, and raises nothing.

Layout: cantools reads the DBC once. This file does the same arithmetic on the same bits (tests compare them bit for
bit) from what was prepared then; benchmarks/costs.py has the ratio. Signals that a C struct can hold
(unscaled, 8, 16 or 32 bits, float32, on byte boundaries) are read and written by one, the others bit by bit. It takes
what retuner.dbc needs: little-endian signals, whole numbers with a linear scale, float32.
"""

import logging
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import lru_cache
from importlib.resources import files
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import can
import cantools.database
from cantools.database.can.database import Database
from cantools.database.can.message import Message as Layout
from cantools.database.can.signal import Signal
from cantools.errors import Error as CantoolsError

from retuner.drivers.device import DeviceError
from retuner.drivers.protocol.checksum import frame_crc
from retuner.drivers.protocol.frames import HIGHEST_NODE, NAMES, Frame
from retuner.schedule.late_dataclass import dataclass, fields

# ---- A frame's bytes to numbers and back, prepared once from the DBC

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

    layout : of the frame, from cantools.
    order : names of the signals; those that are not named are packed as zero and not unpacked.

    Raises ValueError: a signal is of a kind that this does not take, has no range, or its range does not fit its bits.
    """

    def __init__(self, layout: Layout, order: Sequence[str]) -> None:
        signals = [layout.get_signal_by_name(name) for name in order]
        self.ranges = tuple(_range(layout.name, signal) for signal in signals)
        # where every number that the bits can say is in range, reading needs no check
        checked = [i for i, s in enumerate(signals) if s.is_float or (s.minimum, s.maximum) != _reach(s)]
        self._bounds = tuple((i, *self.ranges[i]) for i in checked)
        place = {name: i for i, name in enumerate(order)}
        # the frame's bytes in their order: signals that a struct holds, and groups of others that share bytes
        pieces: list[_Piece] = []
        for signal in sorted(signals, key=lambda signal: signal.start):
            first, last = signal.start // 8, (signal.start + signal.length - 1) // 8
            before = pieces[-1] if pieces else None
            if before is not None and first < before.start + before.length:
                pieces[-1] = _Piece(before.start, last + 1 - before.start, (*before.signals, signal), True)
            else:
                unscaled = (signal.scale, signal.offset) == (1, 0)
                is_plain = signal.is_float or (unscaled and signal.start % 8 == 0 and signal.length in CODES)
                pieces.append(_Piece(first, last + 1 - first, (signal,), not is_plain))
        code, at = "", 0
        for piece in pieces:
            signal = piece.signals[0]
            letter = CODES.get(8 * piece.length, f"{piece.length}s")
            if not piece.is_group or (piece.is_alone and len(letter) == 1):
                letter = "f" if signal.is_float else letter.lower() if signal.is_signed else letter
            code += "x" * (piece.start - at) + letter
            at = piece.start + piece.length
        self._struct = struct.Struct("<" + (code + "x" * (layout.length - at)))
        self.length = self._struct.size
        self._plain = tuple((i, place[p.signals[0].name]) for i, p in enumerate(pieces) if not p.is_group)
        groups = [(i, p) for i, p in enumerate(pieces) if p.is_group and not p.is_alone]
        self._wide = tuple((i, p.length) for i, p in groups if 8 * p.length not in CODES)
        self._odd = tuple(
            _Odd(
                i, s.start - 8 * p.start, (1 << s.length) - 1, 1 << s.length - 1 if s.is_signed else 0,
                s.scale, s.offset, place[s.name],
            )
            for i, p in groups for s in p.signals
        )  # fmt: skip
        alone = [(i, p.length, p.signals[0]) for i, p in enumerate(pieces) if p.is_alone]
        self._alone = tuple(
            _Alone(i, 8 * length not in CODES, length, s.is_signed, s.scale, s.offset, place[s.name])
            for i, length, s in alone
        )
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
    """A function that gives the values at these places; all of them when they are in their order."""
    if places == list(range(len(places))):
        return tuple
    pick: Callable[[Sequence[float]], Any] = itemgetter(*places)
    return pick if len(places) > 1 else lambda values: (pick(values),)


def _range(frame: str, signal: Signal) -> tuple[float, float]:
    """Range of a signal that can be laid out. Raises ValueError: it cannot."""
    where = f"{frame}.{signal.name}"
    low, high = signal.minimum, signal.maximum
    if low is None or high is None:
        raise ValueError(f"{where} has no range; give it one")
    if signal.byte_order != "little_endian" or signal.is_multiplexer or signal.multiplexer_ids:
        raise ValueError(f"{where}: only plain little-endian signals are laid out")
    if signal.is_float:
        if signal.length != FLOAT_BITS or signal.start % 8 or (signal.scale, signal.offset) != (1, 0):
            raise ValueError(f"{where}: only unscaled float32 on byte boundaries is laid out")
        near_low, near_high = struct.unpack("<2f", struct.pack("<2f", low, high))  # 0.0001 s comes back a little less
        low, high = min(low, near_low), max(high, near_high)
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


# A DBC text to a database, every way to fail told in one line.
#
# cantools takes a lot: of damaged DBC files one in eight is read without complaint, with other names, places or scales.
# So what is read is held to the frames that this release knows, and what still differs has another layout hash, which
# both ends compare before anything is written.


# cantools warns about doubled frames on stderr; what matters is in the DbcError.
logging.getLogger("cantools").addHandler(logging.NullHandler())

PARSING_ERRORS = (CantoolsError, ValueError, LookupError, TypeError, ArithmeticError, AttributeError, RecursionError)
"""What cantools raises on damaged texts."""


class DbcError(DeviceError):
    """A DBC that cannot be used; one line: file, what is wrong."""


def read_dbc(text: str, source: str) -> Database:
    """Read a DBC text.

    text : content of the file. source : its name, for messages.

    Raises DbcError: it is no DBC, or signals of a frame overlap or leave it.
    """
    try:
        database = cantools.database.load_string(text, database_format="dbc", strict=True)
    except PARSING_ERRORS as error:
        raise DbcError(f"{source}: cannot be used as a DBC: {' '.join(str(error).split())[:200]}") from None
    if not isinstance(database, Database):
        raise DbcError(f"{source}: is not a CAN database")
    return database


DBC = "retuner.dbc"
COMMAND_BITS = 5
CHECKSUM = "CHECKSUM"


class Refusal(StrEnum):
    """Why bytes are no frame of ours."""

    FOREIGN = "another node or no node of this protocol"
    NOT_DATA = "a remote, error, extended or FD frame"
    UNKNOWN = "no such command"
    LENGTH = "wrong length"
    CHECKSUM = "wrong checksum"
    RANGE = "a value outside its range or not finite"


@dataclass(frozen=True, slots=True)
class Refused:
    """Bytes that were no frame of ours, and why."""

    refusal: Refusal


class FrameError(ValueError):
    """A frame value that must not be sent; the message names signal, value and range."""


@dataclass(frozen=True, slots=True)
class _Plan:
    """What is known of one frame: its layout, class, how to take a frame's values in the class's order, the signals'
    names in the DBC in that order, whether a checksum ends it.
    """

    layout: Layout
    bits: BitLayout
    make: Callable[..., Frame]
    values: Callable[[Frame], Sequence[float]]
    names: tuple[str, ...]
    checked: bool


@lru_cache(maxsize=1)
def _plans() -> dict[int, _Plan]:
    return plans_of(_database(), DBC)


def plans_of(database: Database, source: str) -> dict[int, _Plan]:
    """Command number to plan.

    Raises DbcError: the database lacks a frame or signal of this protocol, has one too many, or one that cannot be laid
    out.
    """
    names = sorted(layout.name for layout in database.messages)
    if names != sorted(NAMES):
        odd = ", ".join(sorted(set(names) ^ set(NAMES))) or "twice the same"
        raise DbcError(f"{source}: lacks the frames of this protocol: {odd}")
    plans = {}
    for layout in database.messages:
        node, command = divmod(layout.frame_id, 1 << COMMAND_BITS)
        if node != 1 or layout.is_extended_frame or command in plans:
            raise DbcError(f"{source}: {layout.name}: id {layout.frame_id} is not the id of a frame of node 1")
        make = NAMES[layout.name]
        by_field = {signal.name.lower(): signal for signal in layout.signals}
        names = [field.name for field in fields(make)]
        if set(by_field) - {CHECKSUM.lower()} != set(names) or len(by_field) != len(layout.signals):
            odd = ", ".join(sorted(set(by_field) ^ set(names)))
            raise DbcError(f"{source}: {layout.name} lacks the signals of this protocol: {odd}")
        signals = tuple(by_field[name].name for name in names)
        try:
            bits = BitLayout(layout, signals)
        except (ValueError, OverflowError) as error:  # the second: a limit with hundreds of digits
            raise DbcError(f"{source}: {layout.name}: {error}") from None
        plans[command] = _Plan(layout, bits, make, _values(names), signals, CHECKSUM.lower() in by_field)
    return plans


def _values(names: list[str]) -> Callable[[Frame], Sequence[float]]:
    get: Callable[[Frame], Any] = attrgetter(*names)
    return get if len(names) > 1 else lambda frame: (get(frame),)


@lru_cache(maxsize=1)
def _database() -> Database:
    return read_dbc(files("retuner.drivers").joinpath(DBC).read_text(encoding="ascii"), DBC)


@lru_cache(maxsize=1)
def schema() -> int:
    """Layout of all frames as 16 bits of a CRC-32: equal on both ends or nothing is written. Comments do not count."""
    return zlib.crc32(schema_text(_plans()).encode()) & 0xFFFF


def schema_lines() -> list[str]:
    """The lines whose CRC-32 the layout hash is."""
    return schema_text(_plans()).split("\n")


def schema_text(plans: Mapping[int, _Plan]) -> str:
    """What the layout hash is made of: a line a frame, by command, and one a signal, in the order of the DBC."""
    parts = []
    for command, plan in sorted(plans.items()):
        parts.append(f"{command} {plan.layout.name} {plan.layout.length}")
        parts += [
            f"{s.name} {s.start} {s.length} {s.byte_order} {s.is_signed} {s.is_float} {s.scale} {s.offset}"
            for s in plan.layout.signals
        ]
    return "\n".join(parts)


class _Encoded(can.Message):
    """A message of this protocol; python-can's virtual bus makes a deep copy of each for every listener."""

    __slots__ = ()

    def __deepcopy__(self, _memo: dict[int, Any] | None) -> can.Message:
        """A copy without the way through copy.deepcopy for eight bytes and a name: a quarter of the time."""
        return can.Message(
            self.timestamp,
            self.arbitration_id,
            self.is_extended_id,
            self.is_remote_frame,
            self.is_error_frame,
            self.channel,
            self.dlc,
            bytearray(self.data),
            self.is_fd,
            self.is_rx,
            self.bitrate_switch,
            self.error_state_indicator,
        )


class Codec:
    """Frames of one node.

    node : 1..63.

    Raises ValueError: no such node.
    """

    def __init__(self, node: int) -> None:
        if not 1 <= node <= HIGHEST_NODE:
            raise ValueError(f"node = {node}; give a node from 1 to {HIGHEST_NODE}")
        self.node = node
        self._by_id = {node << COMMAND_BITS | command: plan for command, plan in _plans().items()}
        self._by_type: dict[object, tuple[int, _Plan]] = {plan.make: (id_, plan) for id_, plan in self._by_id.items()}

    def encode(self, frame: Frame) -> can.Message:
        """The frame as a classic CAN message.

        Raises FrameError: a value is not finite or outside the range that the DBC gives.
        """
        id_, plan = self._by_type[type(frame)]
        values = plan.values(frame)
        bad = plan.bits.outside(values)
        if bad is not None:
            low, high = plan.bits.ranges[bad]
            where = f"{plan.layout.name}.{plan.names[bad]}"
            raise FrameError(f"{where} = {values[bad]}; give a number from {low:g} to {high:g}")
        data = plan.bits.pack(values)
        if plan.checked:
            data[-1] = frame_crc(id_, data[:-1])
        return _Encoded(arbitration_id=id_, is_extended_id=False, data=data)

    def decode(self, message: can.Message) -> Frame | Refused:
        """The frame in a message, or why there is none."""
        id_, data = message.arbitration_id, message.data
        plan = self._by_id.get(id_)
        if plan is None:
            return Refused(Refusal.UNKNOWN if id_ >> COMMAND_BITS == self.node else Refusal.FOREIGN)
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd:
            return Refused(Refusal.NOT_DATA)
        if len(data) != plan.bits.length:
            return Refused(Refusal.LENGTH)
        if plan.checked and data[-1] != frame_crc(id_, data[:-1]):
            return Refused(Refusal.CHECKSUM)
        values = plan.bits.unpack(data)
        return Refused(Refusal.RANGE) if values is None else plan.make(*values)
