"""[device] with kind = "dbc" or "canopen": a controller that is not ours, and what of it is what."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import Field, model_validator

from retuner.config.plants import PlantConfig
from retuner.config.section import CrossCheckError, Many, Problem, Section, setting
from retuner.drivers.profiles.mapping import Ask, DeviceMapping, GainAt, ObjectOf, Protection, SignalOf, States
from retuner.drivers.profiles.ready import profile_names, profile_settings
from retuner.schedule.gains import PidGains
from retuner.schedule.vendor_units import ACTIONS, Quantity

NO_READ_BACK, UNPROVED_ORDER = "no_read_back", "unproved_order"
UNITS = {"": 1.0, "s": 1.0, "ms": 1e-3, "min": 60.0}
Whole = Annotated[int, Field(ge=-(2**31), le=2**32 - 1)]
BIGGEST = 1e12
BY_HAND = "Its gains; absent: they are set by hand at the device and in the regions, it is watched and advised"


def _scale(what: str) -> Any:  # noqa: ANN401  as setting
    return setting(what, f"{-BIGGEST}..{BIGGEST}", 1.0, "the device's manual")


def _offset() -> Any:  # noqa: ANN401  as setting
    return setting("Ours at the device's 0", f"{-BIGGEST}..{BIGGEST}", 0.0, "none")


class AskConfig(Section):
    """A data frame that asks for a message."""

    message: str = setting("Message, by name or identifier (0x...)", "1..128 characters", source="the DBC")
    values: dict[str, float] = setting(
        "Values of its signals; others are as in the DBC", default={}, source="the device's manual"
    )

    def ask(self) -> Ask:
        """The request as the drivers take it."""
        return Ask(self.message, self.values)


def _asked() -> Any:  # noqa: ANN401  as setting
    return setting("The data frame that asks for it; absent: sent unasked", default=None, source="none")


class SignalConfig(Section):
    """A number of the loop in a DBC: ours = scale x the signal's + offset."""

    message: str = setting("Message, by name or identifier (0x...)", "1..128 characters", source="the DBC")
    signal: str = setting("Signal of the message", "1..128 characters", source="the DBC")
    scale: float = _scale("Ours for one of the signal's; the output is in % of its range")
    offset: float = _offset()
    on_request: bool = setting(
        "Whether it comes only when asked for, by a remote frame", default=False, source="the device's manual"
    )

    ask: AskConfig | None = _asked()

    def place(self) -> SignalOf:
        """The place as the drivers take it."""
        ask = self.ask.ask() if self.ask else None
        return SignalOf(self.message, self.signal, self.scale, self.offset, self.on_request or ask is not None, ask)


class ObjectConfig(Section):
    """A number of the loop in an object dictionary: ours = scale x the object's + offset."""

    object: str = setting('Object: "6130", "6130:1" or its name', "1..128 characters", source="the EDS")
    scale: float = _scale("Ours for one of the object's; the output is in % of its range")
    offset: float = _offset()

    def place(self) -> ObjectOf:
        """The place as the drivers take it."""
        return ObjectOf(self.object, self.scale, self.offset)


class _StateSection(Section):
    expected: Many[Whole] = setting("Values that are as they should be", source="the device's manual")
    mask: int = setting("Bits that count", f"1..{2**32 - 1}", 2**32 - 1, "all")
    reason: str = setting("What is told otherwise", "0..128 characters", "", "the number itself")


class SignalStateConfig(_StateSection):
    """A state in a DBC."""

    message: str = setting("Message, by name or identifier (0x...)", "1..128 characters", source="the DBC")
    signal: str = setting("Signal of the message", "1..128 characters", source="the DBC")

    def states(self) -> States:
        """The states as the drivers take them."""
        return States(SignalOf(self.message, self.signal), self.expected, self.mask, self.reason)


class ObjectStateConfig(_StateSection):
    """A state in an object dictionary."""

    object: str = setting('Object: "6041", "6041:0" or its name', "1..128 characters", source="the EDS")

    def states(self) -> States:
        """The states as the drivers take them."""
        return States(ObjectOf(self.object), self.expected, self.mask, self.reason)


class _GainSection(Section):
    scale: float = _scale("Ours for one of the controller's; negative where it counts reverse action as positive")
    unit: Literal["", "s", "ms", "min"] = setting("Unit of a time", default="", source="s")
    off: float | None = setting("Number that stands for no such action", f"{-BIGGEST}..{BIGGEST}", None, "none does")

    def factor(self, quantity: Quantity, general: float) -> float:
        """Ours for one of the controller's."""
        return self.scale * (general if quantity in {Quantity.KP, Quantity.KI, Quantity.KD} else 1.0) * UNITS[self.unit]


class SignalGainConfig(_GainSection):
    """A gain in a DBC."""

    message: str = setting("Message that writes it", "1..128 characters", source="the DBC")
    signal: str = setting("Signal of the message", "1..128 characters", source="the DBC")
    read_message: str = setting("Message that tells it; empty: it cannot be read", "0..128 characters", "", "the DBC")
    read_signal: str = setting("Signal of that message; empty: the same name", "0..128 characters", "", "the DBC")
    read_on_request: bool = setting(
        "Whether that message comes only when asked for, by a remote frame", default=True, source="most do"
    )

    read_ask: AskConfig | None = _asked()

    def gain(self, quantity: Quantity, general: float) -> GainAt:
        """The gain as the drivers take it."""
        read = None
        if self.read_message:
            ask = self.read_ask.ask() if self.read_ask else None
            asked = self.read_on_request or ask is not None
            read = SignalOf(self.read_message, self.read_signal or self.signal, on_request=asked, ask=ask)
        return GainAt(quantity, SignalOf(self.message, self.signal), read, self.factor(quantity, general), self.off)


class ObjectGainConfig(_GainSection):
    """A gain in an object dictionary; it is read back where it was written."""

    object: str = setting('Object: "6450", "6450:1" or its name', "1..128 characters", source="the EDS")

    def gain(self, quantity: Quantity, general: float) -> GainAt:
        """The gain as the drivers take it."""
        at = ObjectOf(self.object)
        return GainAt(quantity, at, at, self.factor(quantity, general), self.off)


def _gain(what: str) -> Any:  # noqa: ANN401  as setting
    return setting(what, default=None, source="the device's manual")


Gain = TypeVar("Gain", SignalGainConfig, ObjectGainConfig)


class _GainsSection(Section, Generic[Gain]):
    """One number an action, in the controller's form and unit."""

    form: Literal["ideal", "series"] = setting(
        "Form that xp, tn and tv (and kp beside them) are of; kp, ki, kd alone are parallel",
        default="ideal",
        source="the device's manual",
    )
    scale: float = _scale("Ours for one of the controller's, of kp, ki and kd together")
    without: Many[Literal["kp", "xp", "ki", "tn", "repeats", "kd", "tv"]] = setting(
        "Gains of the profile that this device lacks; kd = false says the same", default=(), source="none"
    )

    kp: Gain | None = _gain("Proportional gain")
    xp: Gain | None = _gain("Proportional band in % of the pv range")
    ki: Gain | None = _gain("Integral gain, per second")
    tn: Gain | None = _gain("Integral time")
    repeats: Gain | None = _gain("Integral action in repeats per minute")
    kd: Gain | None = _gain("Derivative gain, times seconds")
    tv: Gain | None = _gain("Derivative time")

    @model_validator(mode="before")
    @classmethod
    def _taken_away(cls, given: object) -> object:
        """A gain that is false is one that the device lacks."""
        return _with_lacking(given) if isinstance(given, Mapping) else given

    def problems(self) -> Iterator[Problem]:
        """One number an action, and a proportional one among them."""
        for action, quantities in ACTIONS.items():
            found = [str(quantity) for quantity in quantities if getattr(self, quantity) is not None]
            if len(found) > 1:
                yield Problem((found[1],), f"and {found[0]} are both {action} action; give one of them")
            elif not found and action == "proportional":
                yield Problem((), "has no proportional gain; give kp or xp")

    def gains(self) -> tuple[GainAt, ...]:
        given = [(quantity, getattr(self, quantity)) for quantities in ACTIONS.values() for quantity in quantities]
        return tuple(one.gain(quantity, self.scale) for quantity, one in given if one is not None)


class SignalGainsConfig(_GainsSection[SignalGainConfig]):
    """[device.gains] with kind = "dbc": The gains as the controller has them."""


class ObjectGainsConfig(_GainsSection[ObjectGainConfig]):
    """[device.gains] with kind = "canopen": The gains as the controller has them."""


class ProtectConfig(Section):
    """[[device.protect]]: counter and checksum of one message."""

    message: str = setting("Message", "1..128 characters", source="the DBC")
    counter: str = setting("Signal that counts; empty: none", "0..128 characters", "", "the DBC")
    checksum: str = setting("Signal of the checksum; empty: none", "0..128 characters", "", "DBC")
    algorithm: str = setting(
        "Algorithm of the checksum: crc8_sae_j1850, crc8_autosar, crc8, crc16_ccitt, crc16_xmodem, sum8, "
        "sum8_inverted, sum8_negated, xor8",
        "0..32 characters",
        "",
        "the device's manual",
    )
    data_id: int | None = setting("Data identifier that the checksum covers as well", "0..65535", None, "none")

    def protection(self) -> Protection:
        """The protection as the drivers take it."""
        return Protection(self.message, self.counter, self.checksum, self.algorithm, self.data_id)


class ForeignConfig(Section):
    """What every controller that is not ours has."""

    profile: str = setting(
        "Ready mapping that what is given here completes: odrive, cia402, cia404; empty: all is given here",
        "0..32 characters",
        "",
        "none",
    )
    node: int | None = setting("Number of the device; absent: that of [bus]", "0..127", None, "[bus] node")
    accept: Many[Literal["no_read_back", "unproved_order"]] = setting(
        "What the user accepts: a device without read-back of gains (else nothing is written); an order of messages "
        "that no model proves (else such gains are refused)",
        default=(),
        source="neither",
    )
    feed_s: float = setting(
        "The setpoint is sent again after so long, for the device's watchdog; 0: never", "0..3600 s", 0.0, "no watchdog"
    )
    look_s: float = setting(
        "Gains are read again after so long, to see what others change", ">0..1e6 s", 60.0, "a minute"
    )
    silent_s: float | None = setting(
        "Age of the last frame at which the device counts as silent; absent: 6 samples, at least 0.5 s",
        ">0..1e6 s",
        None,
        "6 samples",
    )
    sp_start: float = setting("Setpoint until one is sent, where the device reports none", "-1e9..1e9 pv", 0.0)
    seed: int = setting("Seed of the simulated noise", f"0..{2**32 - 1}", 1)
    plant: PlantConfig | None = setting(
        "Simulated plant, for a virtual device of this kind; absent: a real one is connected", default=None
    )

    @model_validator(mode="before")
    @classmethod
    def _with_profile(cls, given: object) -> object:
        name = given.get("profile") if isinstance(given, Mapping) else None
        if not isinstance(given, Mapping) or not isinstance(name, str) or not name:
            return given
        ready = profile_settings(name)
        if ready is None:
            known = ", ".join(profile_names())
            raise CrossCheckError([Problem(("profile",), f'= "{name}" is no profile; there is {known}')])
        if ready["kind"] != given.get("kind"):
            raise CrossCheckError([Problem(("profile",), f'= "{name}" is for kind = "{ready["kind"]}"')])
        # the profile without its gains of an action for which another number is given
        gains = given.get("gains")
        own = set(gains) if isinstance(gains, Mapping) else set[str]()
        rivals = {name for quantities in ACTIONS.values() if own & {*quantities} for name in quantities} - own
        without = _with_lacking(gains).get("without", ()) if isinstance(gains, Mapping) else ()
        left_out = rivals | {str(one) for one in without}
        kept = {one: value for one, value in ready["gains"].items() if one not in left_out}
        return merged({**ready, "gains": kept}, given)


class DbcDeviceConfig(ForeignConfig):
    """[device] with kind = "dbc": a controller whose messages a DBC describes; see docs/devices.md."""

    kind: Literal["dbc"] = setting("Which device")
    dbc: str = setting("DBC file of the device; a profile has one", "1..1024 characters", source="its maker")
    described_node: int = setting("Node that the DBC describes", "0..127", 0, "DBC")
    node_shift: int | None = setting(
        "Bits by which the node's number is moved in the identifiers; absent: they are as in the DBC",
        "0..22",
        None,
        "the device's manual",
    )
    pv: SignalConfig = setting("Process value", source="the DBC")
    co: SignalConfig = setting("Output, in % of its range", source="the DBC")
    sp: SignalConfig | None = setting("Setpoint as the device reports it", default=None, source="none")
    setpoint: SignalConfig | None = setting("Where a setpoint is written", default=None, source="none")
    mode: SignalStateConfig | None = setting("Where it tells that it controls", default=None, source="none")
    gains: SignalGainsConfig | None = setting(BY_HAND, default=None, source="the DBC")
    stop: Many[SignalStateConfig] = setting("Where it tells that it has stopped", default=(), source="none")
    protect: Many[ProtectConfig] = setting("Counters and checksums", default=(), source="none")
    fixed: dict[str, float] = setting(
        'Values of other signals in written messages, by "message.signal"', default={}, source="the DBC's"
    )

    def mapping(self, pv_span: float, co_span: float, by_hand: PidGains) -> DeviceMapping:
        """The mapping as the drivers take it."""
        return DeviceMapping(
            **_common(self, pv_span, co_span, by_hand),
            protected=tuple(one.protection() for one in self.protect),
            fixed=self.fixed,
        )


class CanOpenDeviceConfig(ForeignConfig):
    """[device] with kind = "canopen": a node whose objects an EDS describes; see docs/devices.md."""

    kind: Literal["canopen"] = setting("Which device")
    eds: str = setting("EDS (or DCF) of the device; a profile has one", "1..1024 characters", source="its maker")
    pv: ObjectConfig = setting("Process value", source="the EDS")
    co: ObjectConfig = setting("Output, in % of its range", source="the EDS")
    sp: ObjectConfig | None = setting("Setpoint as the device reports it", default=None, source="none")
    setpoint: ObjectConfig | None = setting("Where a setpoint is written", default=None, source="none")
    mode: ObjectStateConfig | None = setting("Where it tells that it controls", default=None, source="none")
    gains: ObjectGainsConfig | None = setting(BY_HAND, default=None, source="the EDS")
    stop: Many[ObjectStateConfig] = setting("Where it tells that it has stopped", default=(), source="none")
    start: bool = setting(
        "Whether the node is started (NMT) when it is found pre-operational", default=True, source="CiA 301"
    )
    heartbeat_s: float = setting(
        "Period of this host's own heartbeat, as node own_node; 0: none", "0..60 s", 0.0, "the device's object 1016"
    )
    own_node: int = setting("Number of this host", "1..127", 127, "a common choice")

    def mapping(self, pv_span: float, co_span: float, by_hand: PidGains) -> DeviceMapping:
        """The mapping as the drivers take it."""
        return DeviceMapping(**_common(self, pv_span, co_span, by_hand))


def _common(
    device: DbcDeviceConfig | CanOpenDeviceConfig, pv_span: float, co_span: float, by_hand: PidGains
) -> dict[str, Any]:
    """What the mappings of both kinds have. by_hand : the set that runs where the description has no gains."""
    return {
        "pv": device.pv.place(),
        "co": device.co.place(),
        "gains": device.gains.gains() if device.gains else (),
        "by_hand": by_hand if device.gains is None else None,
        "sp": device.sp.place() if device.sp else None,
        "mode": device.mode.states() if device.mode else None,
        "setpoint": device.setpoint.place() if device.setpoint else None,
        "series": device.gains is not None and device.gains.form == "series",
        "pv_span": pv_span,
        "co_span": co_span,
        "stops": tuple(one.states() for one in device.stop),
    }


def _with_lacking(gains: Mapping[str, Any]) -> dict[str, Any]:
    """The table of gains with those that are false named in `without`."""
    lacking = [name for name, value in gains.items() if value is False]
    kept = {name: value for name, value in gains.items() if value is not False}
    named = gains.get("without", ())
    return {**kept, "without": [*named, *lacking]} if lacking and isinstance(named, list | tuple) else kept


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Two tables in one: what is above counts, tables inside are merged alike."""
    found = dict(below)
    for key, value in above.items():
        inner = found.get(key)
        both = isinstance(value, Mapping) and isinstance(inner, Mapping)
        found[key] = merged(inner, value) if both and isinstance(inner, Mapping) else value
    return found
