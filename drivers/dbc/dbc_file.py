"""A DBC file, and the signals that a mapping names in it: found, or told in one line with the key that is wrong."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cantools.database
from cantools.database.can.database import Database
from cantools.database.can.message import Message as Layout
from cantools.database.can.signal import Signal

from retuner.drivers.profiles.controller_access import ProfileError, Use, description
from retuner.drivers.protocol.codec import PARSING_ERRORS
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.vendor_units import SINGLE_MAX, StorableNumbers

Key = tuple[str | int, ...]
NAMES_SHOWN = 8
SINGLE_BITS = 32
BYTE = 8


@dataclass(frozen=True, slots=True)
class SignalPlace:
    """One signal of one message, as this node sends or takes it.

    scale, offset : ours = scale x the signal's + offset. frame_id : with the node in it.
    """

    layout: Layout
    signal: Signal
    frame_id: int
    scale: float = 1.0
    offset: float = 0.0

    @property
    def page(self) -> int | None:
        """Value of the multiplexer under which it is there; None where it always is."""
        ids = self.signal.multiplexer_ids
        return ids[0] if ids else None

    @property
    def text(self) -> str:
        """The signal as people read it."""
        return f"{self.layout.name}.{self.signal.name}"

    def used_as(self, role: str, what: str, key: Key) -> Use:
        """Where it lies, and as what."""
        pages, frame = frozenset(self.signal.multiplexer_ids or ()), (self.frame_id, int(self.layout.is_extended_frame))
        return Use(role, what, frame, pages, frozenset(bits_of(self.signal)), self.text, key)

    def holds(self) -> StorableNumbers:
        """The numbers that it can carry, by the limits of its bits and, where the DBC has some, by those of the DBC."""
        signal = self.signal
        low, high = carried(signal)
        single = signal.is_float and signal.length == SINGLE_BITS
        step, zero = (0.0, 0.0) if signal.is_float else (abs(float(signal.scale)), float(signal.offset))
        if signal.minimum is not None or signal.maximum is not None:
            told_low = float(signal.minimum) if signal.minimum is not None else low
            told_high = float(signal.maximum) if signal.maximum is not None else high
            if told_low < told_high:  # [0|0] says that nobody has filled it in
                low, high = max(low, told_low), min(high, told_high)
        return StorableNumbers(low, high, step, zero, single)


def carried(signal: Signal) -> tuple[float, float]:
    """The smallest and largest number that a signal's bits can carry, whatever the DBC says of its range."""
    if signal.is_float:
        return -SINGLE_MAX, SINGLE_MAX
    half = 1 << (signal.length - 1)
    ends = (-half, half - 1) if signal.is_signed else (0, 2 * half - 1)
    low, high = sorted(float(raw * signal.scale + signal.offset) for raw in ends)
    return low, high


def bits_of(signal: Signal) -> Sequence[int]:
    """The bits of a message in which a signal lies, from its least significant one, as 8 x byte + bit of the byte."""
    if signal.byte_order == "little_endian":
        return range(signal.start, signal.start + signal.length)
    found = [int(signal.start)]
    while len(found) < signal.length:  # downwards, then at the top of the next byte
        found.append(found[-1] - 1 if found[-1] % BYTE else found[-1] + 2 * BYTE - 1)
    return found[::-1]


@dataclass(frozen=True, slots=True)
class DbcFile:
    """The messages of a file, and how they move with the node's number.

    source : name of the file. node : of the device. described : node that the DBC describes. shift : bits by which the
    node's number is moved in the identifiers; None where they do not depend on it.
    """

    database: Database
    source: str
    node: int = 0
    described: int = 0
    shift: int | None = None

    def frame_id(self, layout: Layout, key: Key = ()) -> int:
        """Identifier of a message of this node."""
        found = layout.frame_id + (0 if self.shift is None else (self.node - self.described) << self.shift)
        if not 0 <= found < 1 << (29 if layout.is_extended_frame else 11):
            raise ProfileError(f"{self.source}: message {layout.name} of node {self.node} has no identifier", key)
        return found

    def layout(self, name: str, key: Key) -> Layout:
        """A message by its name, or by its identifier where a name is not unique ("0x21", "0x18FF0021").

        Raises ProfileError: there is none, or several of this name.
        """
        messages = self.database.messages
        try:
            number = int(name, 16) if name.lower().startswith("0x") else None
        except ValueError:
            number = None
        found = [m for m in messages if (m.frame_id == number if number is not None else m.name == name)]
        if len(found) == 1:
            layout = found[0]
            try:
                layout.refresh(strict=True)
            except PARSING_ERRORS as error:
                raise ProfileError(f"{self.source}: {' '.join(str(error).split())[:200]}", key) from None
            return layout
        if not found:
            raise ProfileError(f"{self.source}: no message {name!r}; {_there([m.name for m in messages], name)}", key)
        ids = ", ".join(f"{m.frame_id:#x}" for m in found)
        raise ProfileError(f"{self.source}: {len(found)} messages {name!r}; name one by its identifier: {ids}", key)

    def place(self, message: str, signal: str, key: Key, scale: float = 1.0, offset: float = 0.0) -> SignalPlace:
        """A signal that carries a number.

        Raises ProfileError: as signal(), or its number says which other signals are there.
        """
        found = self.signal(message, signal, key, scale, offset)
        if found.signal.is_multiplexer:
            raise ProfileError(
                f"{self.source}: signal {signal!r} says which signals message {message!r} carries; give one of these",
                (*key, "signal"),
            )
        return found

    def signal(self, message: str, signal: str, key: Key, scale: float = 1.0, offset: float = 0.0) -> SignalPlace:
        """Any signal. Raises ProfileError: there is no such message or signal, or it is no number."""
        layout = self.layout(message, (*key, "message"))
        if layout.is_container:
            raise ProfileError(f"{self.source}: message {message!r} is a container", (*key, "message"))
        found = [s for s in layout.signals if s.name == signal]
        if not found:
            names = [s.name for s in layout.signals]
            raise ProfileError(
                f"{self.source}: message {message!r} has no signal {signal!r}; {_there(names, signal)}",
                (*key, "signal"),
            )
        if found[0].multiplexer_ids is not None and sum(s.is_multiplexer for s in layout.signals) > 1:
            raise ProfileError(f"{self.source}: message {message!r} is multiplexed in more than one way", key)
        return SignalPlace(layout, found[0], self.frame_id(layout, key), scale, offset)


def read_dbc_file(path: Path) -> Database:
    """The messages of a DBC file. Raises ProfileError: the file cannot be read, or is no DBC."""
    text = description(path, "DBC").decode("latin-1")  # names are ASCII; comments are Latin-1 as often as not
    try:  # flaws of messages that nobody needs do no harm; DbcFile.layout looks at those that are needed
        database = cantools.database.load_string(text, database_format="dbc", strict=False)
    except PARSING_ERRORS as error:
        raise ProfileError(f"{path}: cannot be used as a DBC: {' '.join(str(error).split())[:200]}", ("dbc",)) from None
    if not isinstance(database, Database) or not database.messages:
        raise ProfileError(f"{path}: describes no message; is it a DBC?", ("dbc",))
    return database


def defaults(layout: Layout, page: int | None, fixed: Mapping[str, float]) -> dict[str, float]:
    """Every signal of a message (of one page of a multiplexed one) with what it carries when nothing is said of it:
    the fixed value, else the DBC's start value, else 0 or the end nearest to it.
    """
    found: dict[str, float] = {}
    choice = next((signal for signal in layout.signals if signal.is_multiplexer), None)
    if page is None and choice is not None:  # the fixed page, else the first
        pages = sorted({page for signal in layout.signals for page in signal.multiplexer_ids or ()})
        page = int(fixed.get(f"{layout.name}.{choice.name}", pages[0] if pages else 0))
    for signal in layout.signals:
        if signal.multiplexer_ids and page not in signal.multiplexer_ids:
            continue
        if signal.is_multiplexer and page is not None:
            found[signal.name] = float(page)
            continue
        initial = signal.initial
        start = float(initial) if isinstance(initial, int | float) else 0.0
        low, high = signal.minimum, signal.maximum
        if low is not None and high is not None and low < high:
            start = min(max(start, float(low)), float(high))
        least, most = carried(signal)
        start = min(max(start, least), most)
        found[signal.name] = fixed.get(f"{layout.name}.{signal.name}", start)
    return found


def _there(names: Sequence[str], wanted: str) -> str:
    low = wanted.lower()
    # by the longest piece of the wanted name, from its start, that is in a name
    ranked = sorted(names, key=lambda name: -max(n for n in range(len(low) + 1) if low[:n] in name.lower()))
    shown = ", ".join(ranked[:NAMES_SHOWN]) + (", ..." if len(names) > NAMES_SHOWN else "")
    return f"there is {shown}" if names else "there is none"
