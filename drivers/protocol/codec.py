"""Frames to bytes and back as drivers/retuner.dbc lays them out, with our own checks on both ways.

cantools encodes NaN without complaint, decodes NaN, infinity and values outside the declared range without complaint
and accepts frames that are too long; so every number is held to the DBC's range here, which NaN fails as well, and
every checksum and length is compared. decode() gives a frame or a Refused, whatever bytes it is shown, and raises
nothing.
"""

import logging
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import lru_cache
from importlib.resources import files
from operator import attrgetter
from typing import Any

import can
import cantools.database
from cantools.database.can.database import Database
from cantools.database.can.message import Message as Layout
from cantools.errors import Error as CantoolsError

from retuner.drivers.device import DeviceError
from retuner.drivers.protocol.bit_layout import BitLayout
from retuner.drivers.protocol.checksum import frame_crc
from retuner.drivers.protocol.frames import HIGHEST_NODE, NAMES, Frame

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

    Parameters
    ----------
    text : content of the file. source : its name, for messages.

    Raises
    ------
    DbcError
        It is no DBC, or signals of a frame overlap or leave it.
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
    type: type[Frame]
    make: Callable[..., Frame]
    values: Callable[[Frame], Sequence[float]]
    names: tuple[str, ...]
    checked: bool


@lru_cache(maxsize=1)
def _plans() -> dict[int, _Plan]:
    """Command number to plan, from the shipped DBC."""
    return plans_of(_database(), DBC)


def plans_of(database: Database, source: str) -> dict[int, _Plan]:
    """Command number to plan.

    Raises
    ------
    DbcError
        The database lacks a frame or signal of this protocol, has one too many, or one that cannot be laid out.
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
        plans[command] = _plan(layout, source)
    return plans


def _plan(layout: Layout, source: str) -> _Plan:
    """The plan of one frame; DbcError when its signals are not its class's fields."""
    make = NAMES[layout.name]
    by_field = {signal.name.lower(): signal for signal in layout.signals}
    names = [field.name for field in fields(make)]
    if set(by_field) - {CHECKSUM.lower()} != set(names) or len(by_field) != len(layout.signals):
        odd = ", ".join(sorted(set(by_field) ^ set(names)))
        raise DbcError(f"{source}: {layout.name} lacks the signals of this protocol: {odd}")
    try:
        bits = BitLayout(layout, [by_field[name].name for name in names])
    except (ValueError, OverflowError) as error:  # the second: a limit with hundreds of digits
        raise DbcError(f"{source}: {layout.name}: {error}") from None
    return _Plan(
        layout, bits, make, make, _values(names), tuple(by_field[n].name for n in names), CHECKSUM.lower() in by_field
    )


def _values(names: list[str]) -> Callable[[Frame], Sequence[float]]:
    """What takes the fields of these names out of a frame."""
    get: Callable[[Frame], Any] = attrgetter(*names)
    return get if len(names) > 1 else lambda frame: (get(frame),)


@lru_cache(maxsize=1)
def _database() -> Database:
    return read_dbc(files("retuner.drivers").joinpath(DBC).read_text(encoding="ascii"), DBC)


@lru_cache(maxsize=1)
def schema() -> int:
    """Layout of all frames as 16 bits of a CRC-32: equal on both ends or nothing is written. Comments do not count."""
    return schema_of(_plans())


def schema_lines() -> list[str]:
    """The lines whose CRC-32 the layout hash is."""
    return schema_text(_plans()).split("\n")


def schema_of(plans: Mapping[int, _Plan]) -> int:
    """The same of any plans."""
    return zlib.crc32(schema_text(plans).encode()) & 0xFFFF


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
        """The same, without the way through copy.deepcopy for eight bytes and a name: a quarter of the time."""
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

    Parameters
    ----------
    node : 1..63.

    Raises
    ------
    ValueError
        No such node.
    """

    def __init__(self, node: int) -> None:
        if not 1 <= node <= HIGHEST_NODE:
            raise ValueError(f"node = {node}; give a node from 1 to {HIGHEST_NODE}")
        self.node = node
        self._by_id = {node << COMMAND_BITS | command: plan for command, plan in _plans().items()}
        self._by_type = {plan.type: (id_, plan) for id_, plan in self._by_id.items()}

    def encode(self, frame: Frame) -> can.Message:
        """The frame as a classic CAN message.

        Raises
        ------
        FrameError
            A value is not finite or outside the range that the DBC gives.
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

    def name_of(self, frame: Frame) -> str:
        """The frame's name in the DBC."""
        return str(self._by_type[type(frame)][1].layout.name)

    def decode(self, message: can.Message) -> Frame | Refused:
        """The frame in a message, or why there is none."""
        id_, data = message.arbitration_id, message.data
        plan = self._by_id.get(id_)
        if plan is None:
            return Refused(Refusal.UNKNOWN if id_ >> COMMAND_BITS == self.node else Refusal.FOREIGN)
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd:
            return Refused(Refusal.NOT_DATA)
        if len(data) != plan.layout.length:
            return Refused(Refusal.LENGTH)
        if plan.checked and data[-1] != frame_crc(id_, data[:-1]):
            return Refused(Refusal.CHECKSUM)
        values = plan.bits.unpack(data)
        return Refused(Refusal.RANGE) if values is None else plan.make(*values)
