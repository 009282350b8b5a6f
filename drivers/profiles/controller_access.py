"""How a foreign controller is reached: what can be heard of it, asked and written, whatever the protocol.

The names are those of the numbers: pv, co, sp, mode, setpoint, and the gains under the names of their quantities.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple, Protocol

import can

from retuner.drivers.device import DeviceError
from retuner.drivers.profiles.mapping import DeviceMapping
from retuner.schedule.vendor_units import VendorGain, VendorUnits

LARGEST = 16 << 20  # bytes of a description


class ProfileError(DeviceError):
    """A description of a device, or a mapping onto it, that cannot be used.

    key : path of the key of the mapping that is wrong, empty for the description itself.
    """

    def __init__(self, message: str, key: tuple[str | int, ...] = ()) -> None:
        self.key = key
        super().__init__(message)


class Heard(NamedTuple):
    """A number of the controller, in our units for all but gains, which are in its own."""

    name: str
    value: float


class Stopped(NamedTuple):
    """The controller has stopped controlling, by its own word. source : which one, for Runs takes it back."""

    reason: str
    source: str = ""


class NoFault(NamedTuple):
    """What had told of a stop tells of none any more."""

    source: str = ""


class Started(NamedTuple):
    """The controller has booted."""


class Alive(NamedTuple):
    """The controller is there; nothing else is told."""


class Acknowledged(NamedTuple):
    """What was written under this name was taken."""

    name: str


class Denied(NamedTuple):
    """What was written or asked for under this name was refused."""

    name: str
    reason: str


class Doubted(NamedTuple):
    """Two answers came to one question about this gain, and they differ: two controllers, or somebody who forges."""

    name: str


Told = Doubted | Heard | Stopped | NoFault | Started | Alive | Acknowledged | Denied


class Access(Protocol):
    """One controller's numbers on a bus. No clock, no thread: what is to be sent is asked for with the time."""

    units: VendorUnits  # of the controller's gains
    telemetry: frozenset[str]  # names among pv, co, sp and mode that can be heard
    on_request: frozenset[str]  # those of them that come only when asked for
    reads_back: bool  # whether the gains can be read
    takes_setpoint: bool  # whether a setpoint can be written
    acknowledges: bool  # whether each write is answered

    def take(self, message: can.Message) -> Sequence[Told]:
        """What a frame tells; nothing for a frame of somebody else, or a damaged one."""

    def ask(self, names: Iterable[str]) -> None:
        """Have these numbers asked for."""

    def put(self, numbers: Mapping[str, float]) -> None:
        """Have these numbers written: gains in the controller's units, the setpoint in ours.

        Raises ValueError: one cannot be written: not finite, out of range, not described.
        """

    def due(self, now_s: float) -> Sequence[can.Message]:
        """Frames to send now."""

    def forget(self) -> None:
        """The controller is out of reach: give up what is under way."""


def description(path: Path, kind: str) -> bytes:
    """The bytes of a device's description. kind : "DBC" or "EDS".

    Raises ProfileError: the file cannot be read, or is too large.
    """
    key = (kind.lower(),)
    try:
        with path.open("rb") as stream:
            raw = stream.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ProfileError(f"{path}: cannot be read: {reason}; give the device's {kind} file", key) from None
    if len(raw) > LARGEST:
        article = "a" if kind == "DBC" else "an"
        raise ProfileError(f"{path}: is larger than {LARGEST >> 20} MB; is it {article} {kind}?", key)
    return raw


def units_of(mapping: DeviceMapping, gains: Iterable[VendorGain]) -> VendorUnits:
    """The units of a mapped controller. Raises ProfileError: its gains are none of one controller."""
    try:
        return VendorUnits(tuple(gains), mapping.pv_span, mapping.co_span, mapping.series, mapping.by_hand)
    except ValueError as error:
        raise ProfileError(str(error), ("gains",)) from None


class Use(NamedTuple):
    """Where one thing of a mapping lies.

    role, what, key : see mapping.MappedPlace. frame : identifier of the message, or index and sub-index of the object.
    pages : values of the multiplexer under which it is there; empty: always. bits : of the message. text : the signal
    or object, for people.
    """

    role: str
    what: str
    frame: tuple[int, int]
    pages: frozenset[int]
    bits: frozenset[int]
    text: str
    key: tuple[str | int, ...]

    def meets(self, other: "Use") -> bool:
        """Whether both lie in the same bits of the same frame."""
        together = not self.pages or not other.pages or bool(self.pages & other.pages)
        return self.frame == other.frame and together and bool(self.bits & other.bits)


def require_distinct(uses: Iterable[Use], source: str) -> None:
    """Refuse a mapping in which one signal or object is two things: a setpoint written to a gain would become it.

    Raises ProfileError: the later of the two is named by its key.
    """
    for one, other in combinations(uses, 2):
        if one.what == other.what or not one.meets(other):
            continue
        same = f"{one.text} is both" if one.text == other.text else f"{one.text} and {other.text} share bits; they are"
        raise ProfileError(f"{source}: {same} {one.role} and {other.role}; give each a place of its own", other.key)
