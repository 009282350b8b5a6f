"""Which signals or objects of a foreign device are what: plain values, as a configuration or a profile gives them."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field
from retuner.schedule.vendor_units import Quantity


@dataclass(frozen=True, slots=True)
class Ask:
    """A data frame that asks for something: a message, and values of its signals by name."""

    message: str
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SignalOf:
    """A number in a DBC. scale, offset : ours = scale x the signal's + offset. on_request : comes only when asked for:
    with the frame `ask`, else with a remote frame.
    """

    message: str
    signal: str
    scale: float = 1.0
    offset: float = 0.0
    on_request: bool = False
    ask: Ask | None = None


@dataclass(frozen=True, slots=True)
class ObjectOf:
    """A number in an object dictionary: "6130", "6130:1" or the name in the EDS; scale, offset as SignalOf."""

    object: str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class GainAt:
    """A gain. at : where it is written. read : where it is read back, None where it cannot be. scale : ours for one of
    the controller's. off : number that stands for no such action.
    """

    quantity: Quantity
    at: SignalOf | ObjectOf
    read: SignalOf | ObjectOf | None = None
    scale: float = 1.0
    off: float | None = None


@dataclass(frozen=True, slots=True)
class States:
    """A number that tells a state. expected : the values, after `mask`, that count as auto, or as no stop."""

    at: SignalOf | ObjectOf
    expected: tuple[int, ...]
    mask: int = 0xFFFFFFFF
    reason: str = ""

    def holds(self, value: float) -> bool:
        """Whether a value is one of the expected."""
        return int(value) & self.mask in self.expected


@dataclass(frozen=True, slots=True)
class Protection:
    """What guards a message: names of its counter and checksum signals, "" for none, and the checksum's algorithm."""

    message: str
    counter: str = ""
    checksum: str = ""
    algorithm: str = ""
    data_id: int | None = None


class MappedPlace(NamedTuple):
    """One place that a mapping names. role : its key, for people ("gains.kp"). what : places of one kind may be one: a
    gain and its read-back, the setpoint and its report, states with masks of their own. key : path in the mapping.
    """

    role: str
    what: str
    key: tuple[str | int, ...]
    at: SignalOf | ObjectOf


@dataclass(frozen=True, slots=True)
class DeviceMapping:
    """Which signals or objects of a device are what.

    pv, co : needed. sp : where the device reports its setpoint. mode : where it tells whether it controls.
    setpoint : where it takes one. gains : one a quantity; by_hand : the set that runs, where there are none. series :
    form of kp and the times. stops : what ends a trial. protected : messages with counter or checksum. fixed : values
    of other signals in the messages that are written, by "message.signal".
    """

    pv: SignalOf | ObjectOf
    co: SignalOf | ObjectOf
    gains: tuple[GainAt, ...] = ()
    by_hand: PidGains | None = None
    sp: SignalOf | ObjectOf | None = None
    mode: States | None = None
    setpoint: SignalOf | ObjectOf | None = None
    series: bool = False
    pv_span: float = 100.0
    co_span: float = 100.0
    stops: tuple[States, ...] = ()
    protected: tuple[Protection, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)

    def named(self) -> Iterator[MappedPlace]:
        """Every signal or object that it names, with what it is."""
        signals = (("pv", "pv", self.pv), ("co", "co", self.co), ("sp", "setpoint", self.sp))
        for role, what, at in (*signals, ("setpoint", "setpoint", self.setpoint)):
            if at is not None:
                yield MappedPlace(role, what, (role,), at)
        for gain in self.gains:
            role = f"gains.{gain.quantity}"
            for at in (gain.at, gain.read):
                if at is not None:
                    yield MappedPlace(role, role, ("gains", str(gain.quantity)), at)
        if self.mode is not None:
            yield MappedPlace("mode", "state", ("mode",), self.mode.at)
        for i, states in enumerate(self.stops):
            yield MappedPlace("stop", "state", ("stop", i), states.at)
