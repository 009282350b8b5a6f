"""How a foreign controller is reached: what can be heard of it, asked and written, whatever the protocol.

The names are those of the numbers: pv, co, sp, mode, setpoint, and the gains under the names of their quantities.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol

import can

from retuner.drivers.device import DeviceError
from retuner.schedule.vendor_units import VendorUnits


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

    @property
    def units(self) -> VendorUnits:
        """Units of the controller's gains."""

    @property
    def telemetry(self) -> frozenset[str]:
        """Names among pv, co, sp and mode that can be heard."""

    @property
    def on_request(self) -> frozenset[str]:
        """The places that come only when asked for."""

    @property
    def reads_back(self) -> bool:
        """Whether the gains can be read."""

    @property
    def takes_setpoint(self) -> bool:
        """Whether a setpoint can be written."""

    @property
    def acknowledges(self) -> bool:
        """Whether each write is answered."""

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
