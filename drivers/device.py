"""What a controller behind a driver can do, what it reports, and the errors of `drivers`.

DeviceError
+-- BusError             the bus cannot be opened
+-- DeviceSilentError    nobody answered at the first connection
+-- DeviceMismatchError  who answered is not the controller that is expected
+-- WriteRefusedError    the host will not even start this write (not connected, busy, gains that do not fit)
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple, Protocol

from retuner.adaptive.signals.sample import LoopSample
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass


class DeviceError(Exception):
    """Anything that goes wrong with a device; the message is one line: what, where, the limit, what to do."""


class BusError(DeviceError):
    """The bus cannot be opened: no such interface, no permission, a missing package."""


class DeviceSilentError(DeviceError):
    """No answer within the connection time."""


class DeviceMismatchError(DeviceError):
    """The device speaks another protocol version, frame layout or sample time."""


class WriteRefusedError(DeviceError):
    """The write was not started; nothing has been sent."""


class LinkState(IntEnum):
    """How the link stands, by the age of the last frame."""

    DOWN = 0
    SILENT = 1
    UP = 2


class RunningSet(NamedTuple):
    """A gain set as read back from the device: sequence number, gains (float32 values), its CRC-32."""

    seq: int
    gains: PidGains
    crc: int


@dataclass(frozen=True, slots=True)
class WriteDone:
    """The set runs: acknowledged or not, it has been read back from the running page. gains are what truly runs."""

    seq: int
    gains: PidGains
    running: RunningSet


@dataclass(frozen=True, slots=True)
class WriteFailed:
    """The set does not run and never will; running is the set that does, as read back afterwards."""

    seq: int
    reason: str
    running: RunningSet


@dataclass(frozen=True, slots=True)
class WriteUnknown:
    """Which set runs is not known now: the device does not answer. WriteDone or WriteFailed follows once it does."""

    seq: int
    reason: str


@dataclass(frozen=True, slots=True)
class LinkChanged:
    """The device is heard and its running set verified (UP), or is not heard (SILENT), or the bus is gone (DOWN)."""

    state: LinkState
    reason: str


@dataclass(frozen=True, slots=True)
class DeviceRestarted:
    """The device has booted; running is the set that it runs now, as read back; gap : samples over which time went."""

    epoch: int
    running: RunningSet
    gap: int = 1


@dataclass(frozen=True, slots=True)
class RunningChanged:
    """Somebody else has changed the running set."""

    running: RunningSet


@dataclass(frozen=True, slots=True)
class Reverted:
    """The device has gone back to its confirmed set, because the newer one was not confirmed in time."""

    running: RunningSet


@dataclass(frozen=True, slots=True)
class LeaseChanged:
    """Another host holds the lease on the controller (and this one may only watch), or this one has it (again)."""

    ours: bool
    owner: int


@dataclass(frozen=True, slots=True)
class ForeignHost:
    """Commands to this controller that another host has sent: count of them so far. Told at 1, 2, 4, 8, ..."""

    count: int


@dataclass(frozen=True, slots=True)
class DeviceConflict:
    """Two devices answer under one node number, old frames come again, or the device counts anew in an old epoch.

    What runs is unknown, nothing is written until that is over.
    """

    node: int


@dataclass(frozen=True, slots=True)
class VariableChanged:
    """A scheduling variable that is a signal on the bus has become unknown (stale), or is known again."""

    name: str
    known: bool
    reason: str


@dataclass(frozen=True, slots=True)
class DeviceStopped:
    """The controller has stopped controlling, by its own word: an error, a state, an emergency message."""

    reason: str


@dataclass(frozen=True, slots=True)
class SamplesLost:
    """count samples before t_s never arrived: a window that spans them is not for identification. reason : once half of
    all are lost, why that may be.
    """

    count: int
    t_s: float
    reason: str = ""


@dataclass(frozen=True, slots=True)
class CommandDone:
    """A setpoint, mode, load or store command was carried out."""

    command: str


@dataclass(frozen=True, slots=True)
class CommandFailed:
    """A setpoint, mode, load or store command was refused or never answered."""

    command: str
    reason: str


Event = (
    LoopSample | WriteDone | WriteFailed | WriteUnknown | LinkChanged | DeviceRestarted | RunningChanged | Reverted
    | LeaseChanged | ForeignHost | DeviceConflict | DeviceStopped | SamplesLost | VariableChanged | CommandDone
    | CommandFailed
)  # fmt: skip


class Device(Protocol):
    """One loop's controller. Nothing blocks and nothing happens outside poll()."""

    @property
    def connected(self) -> bool:
        """Whether the device is heard and its running set is known."""

    @property
    def running(self) -> RunningSet | None:
        """The set that runs, always from read-back; None while unknown."""

    @property
    def writing(self) -> bool:
        """Whether a write is under way (also while its result is unknown)."""

    def poll(self, now_s: float) -> list[Event]:
        """Take what has arrived, send what is due, and tell what happened. Call at least once per sample.

        Raises DeviceSilentError, DeviceMismatchError: before the first connection only; later troubles are events.
        """

    def begin_write(self, gains: PidGains, now_s: float, *, back: bool = False) -> int:
        """Start the two-phase write of a gain set; WriteDone or WriteFailed follows, with the returned sequence number
        or, when the lease ran out meanwhile and was taken again, with a later one.

        back : it is the way back to a verified set, which bad telemetry does not close: the write has its own checks.

        Raises WriteRefusedError: not connected, another host holds the lease, a write is under way, or the gains do not
        fit the wire.
        """

    def send_setpoint(self, sp: float, now_s: float) -> None:
        """Set the target in pv units. Repeated until acknowledged; the latest one counts.

        Raises WriteRefusedError: the value is not finite or outside what the wire carries.
        """

    def send_mode(self, *, auto: bool, co: float, now_s: float) -> None:
        """Auto, or manual with co percent; raises as send_setpoint."""

    def send_load(self, load: float, now_s: float) -> None:
        """Disturb a simulated plant, percent of co; raises as send_setpoint."""

    def store(self, now_s: float) -> None:
        """Let the running set survive a restart of the device.

        Raises WriteRefusedError: the running set is not known, or still on probation.
        """

    def confirm(self, now_s: float) -> bool:
        """Confirm the running set at once, because it has proved itself before: until that is acknowledged, a
        controller with a trial time would go back to the set before. Whether no confirmation is open; ask again.
        """

    def release(self, now_s: float) -> None:
        """Let another host command at once: for the end of a session."""


# How long nothing has been heard of a device, and whether that is too long.


class Contact:
    """Ages of one node's frames.

    silent_s : age of the last frame at which the node counts as silent, s.
    connect_s : how long the first connection may take, s.
    """

    def __init__(self, silent_s: float, connect_s: float) -> None:
        self._silent_s, self._connect_s = silent_s, connect_s
        self._first_poll_s = float("inf")
        self.heard_s = float("-inf")
        self.made = False  # whether there has ever been a connection

    def lost(self, now_s: float, link: LinkState) -> str:
        """Why the device is out of reach, or an empty string."""
        if link is LinkState.DOWN:
            return "the bus is gone"
        age_s = now_s - self.heard_s
        return f"no frame for {age_s:.3g} s" if age_s > self._silent_s else ""

    def in_vain(self, now_s: float) -> bool:
        """Whether the first connection takes too long; asked at each poll until there is one."""
        self._first_poll_s = min(self._first_poll_s, now_s)
        return not self.made and now_s - self._first_poll_s > self._connect_s


class Bench(NamedTuple):
    """device : the controller, to be polled after each turn. turn : lets time pass; the time in s. silent_s : age of
    telemetry at which the controller counts as silent, s.
    """

    device: Device
    turn: Callable[[], float]
    silent_s: float
