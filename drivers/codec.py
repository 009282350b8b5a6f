"""Frames to bytes and back as drivers/retuner.dbc lays them out, with our own checks on both ways.

cantools encodes NaN without complaint, decodes NaN, infinity and values outside the declared range without complaint
and accepts frames that are too long; so every number is held to the DBC's range here, which NaN fails as well, and
every checksum and length is compared. decode() gives a frame or a Refused, whatever bytes it is shown, and raises
nothing.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import lru_cache
from importlib.resources import files

import can
import cantools.database
from cantools.database.can.database import Database
from cantools.database.can.message import Message as Layout

from retuner.drivers.bit_layout import BitLayout
from retuner.drivers.checksum import frame_crc
from retuner.drivers.frames import HIGHEST_NODE, NAMES, Frame

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
class _Signal:
    """Range of one field; its name in the DBC and in the frame's class."""

    name: str
    field: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class _Plan:
    """What is known of one frame: its layout, class, the fields in the class's order, whether a checksum ends it."""

    layout: Layout
    bits: BitLayout
    type: type[Frame]
    make: Callable[..., Frame]
    signals: tuple[_Signal, ...]
    checked: bool


@lru_cache(maxsize=1)
def _plans() -> dict[int, _Plan]:
    """Command number to plan, from the DBC."""
    plans = {}
    for layout in _database().messages:
        make = NAMES[layout.name]
        by_field = {signal.name.lower(): signal for signal in layout.signals}
        signals = []
        for field in fields(make):
            signal = by_field[field.name]
            if signal.minimum is None or signal.maximum is None:
                raise FrameError(f"retuner.dbc: {layout.name}.{signal.name} has no range; give it one")
            signals.append(_Signal(signal.name, field.name, float(signal.minimum), float(signal.maximum)))
        bits = BitLayout(layout, [signal.name for signal in signals])
        plan = _Plan(layout, bits, make, make, tuple(signals), CHECKSUM.lower() in by_field)
        plans[layout.frame_id & ((1 << COMMAND_BITS) - 1)] = plan
    return plans


@lru_cache(maxsize=1)
def _database() -> Database:
    """The shipped DBC."""
    text = files("retuner.drivers").joinpath("retuner.dbc").read_text(encoding="ascii")
    database = cantools.database.load_string(text, database_format="dbc", strict=True)
    if not isinstance(database, Database):
        raise FrameError("retuner.dbc is no CAN database")
    return database


@lru_cache(maxsize=1)
def schema() -> int:
    """Layout of all frames as 16 bits of a CRC-32: equal on both ends or nothing is written. Comments do not count."""
    parts = []
    for command, plan in sorted(_plans().items()):
        parts.append(f"{command} {plan.layout.name} {plan.layout.length}")
        parts += [
            f"{s.name} {s.start} {s.length} {s.byte_order} {s.is_signed} {s.is_float} {s.scale} {s.offset}"
            for s in plan.layout.signals
        ]
    return zlib.crc32("\n".join(parts).encode()) & 0xFFFF


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
        values: list[float] = []
        for signal in plan.signals:
            value: float = getattr(frame, signal.field)
            if not signal.low <= value <= signal.high:
                raise FrameError(
                    f"{plan.layout.name}.{signal.name} = {value}; give a number from {signal.low:g} to {signal.high:g}"
                )
            values.append(value)
        data = plan.bits.pack(values)
        if plan.checked:
            data[-1] = frame_crc(id_, data[:-1])
        return can.Message(arbitration_id=id_, is_extended_id=False, data=data, check=True)

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
