"""A controller that speaks any DBC: numbers into frames and out of them, by a mapping.

Every value that goes out is finite and inside what the signal can carry: cantools alone puts NaN into a gain frame
without complaint. A message is sent with everything that it carries: what was last written of its other signals, the
fixed values of the mapping, else the DBC's start values.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import can

from retuner.drivers.dbc.dbc_file import DbcFile, Key, SignalPlace, defaults
from retuner.drivers.dbc.frame_guard import FrameGuard, data_frame, guard_of
from retuner.drivers.profiles.controller_access import (
    Alive,
    Heard,
    NoFault,
    ProfileError,
    Stopped,
    Told,
    Use,
    require_distinct,
    units_of,
)
from retuner.drivers.profiles.mapping import Ask, DeviceMapping, SignalOf, States
from retuner.drivers.telemetry.signal_source import DECODING_ERRORS
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.vendor_units import VendorGain

Slot = tuple[int, int | None]  # identifier of a message and page of it: what one frame carries


@dataclass(frozen=True, slots=True)
class _State:
    """A state signal at its place. stop : whether it tells of a stop, rather than of the mode."""

    place: SignalPlace
    states: States
    stop: bool


@dataclass(frozen=True, slots=True)
class AskFrame:
    """A data frame that asks. place : any signal of its message. values : of all of them."""

    place: SignalPlace
    values: tuple[tuple[str, float], ...]

    def message(self, guard: FrameGuard | None) -> can.Message:
        """The frame."""
        return data_frame(self.place.layout, self.place.frame_id, dict(self.values), guard)

    def is_asked_by(self, message: can.Message) -> bool:
        """Whether a frame says the same in the signals that were given values."""
        layout = self.place.layout
        if (message.arbitration_id, message.is_extended_id) != (self.place.frame_id, layout.is_extended_frame):
            return False
        return bytes(message.data) == bytes(self.message(None).data)


def ask_frame(file: DbcFile, ask: Ask, key: Key) -> AskFrame:
    """The frame that asks, as the file describes it.

    Raises ProfileError: the message, a signal of it, or a value is not there.
    """
    layout = file.layout(ask.message, (*key, "ask", "message"))
    places = [file.signal(ask.message, name, (*key, "ask")) for name in ask.values]
    given = {f"{layout.name}.{name}": value for name, value in ask.values.items()}
    values = {**defaults(layout, None, given), **ask.values}
    place = places[0] if places else SignalPlace(layout, layout.signals[0], file.frame_id(layout, key))
    made = AskFrame(place, tuple(values.items()))
    try:
        made.message(None)
    except DECODING_ERRORS as error:
        told = " ".join(str(error).split())[:160]
        raise ProfileError(f"{file.source}: message {layout.name}: {told}", (*key, "ask")) from None
    return made


class DbcAccess:
    """See the head of this file.

    file : the messages. mapping : what is what.

    Raises ProfileError: a signal is not there, or cannot be what it is said to be.
    """

    acknowledges = False

    def __init__(self, file: DbcFile, mapping: DeviceMapping) -> None:
        self._file, self._mapping = file, mapping
        self._heard: dict[tuple[int, bool], list[tuple[str, SignalPlace]]] = {}
        self._states: dict[tuple[int, bool], list[_State]] = {}
        self._requests: dict[str, SignalPlace] = {}
        self._asks: dict[str, AskFrame] = {}
        self._written: dict[str, SignalPlace] = {}
        self._queue: list[can.Message] = []
        self._last: dict[Slot, dict[str, float]] = {}
        self.damaged = 0  # frames refused for their checksum, counter or content
        self._hear("pv", mapping.pv, ("pv",))
        self._hear("co", mapping.co, ("co",))
        if mapping.sp is not None:
            self._hear("sp", mapping.sp, ("sp",))
        if mapping.mode is not None:
            self._watch(mapping.mode, ("mode",), stop=False)
        for i, states in enumerate(mapping.stops):
            self._watch(states, ("stop", i), stop=True)
        self.telemetry = frozenset(n for n in ("pv", "co", "sp", "mode") if getattr(mapping, n) is not None)
        slots: list[Slot] = []
        gains = []
        for gain in mapping.gains:
            key: Key = ("gains", str(gain.quantity))
            place = self._written[str(gain.quantity)] = self._place(gain.at, key)
            slot = (place.frame_id, place.page)
            slots += [slot] if slot not in slots else []
            try:
                gains.append(VendorGain(gain.quantity, gain.scale, place.holds(), slots.index(slot), gain.off))
            except ValueError as error:
                raise ProfileError(f"{file.source}: {place.text}: {error}", key) from None
            if gain.read is not None:
                self._hear(str(gain.quantity), gain.read, key)
        self.units = units_of(mapping, gains)
        self.reads_back = bool(mapping.gains) and all(gain.read is not None for gain in mapping.gains)
        self.on_request = frozenset(self._requests) & self.telemetry
        self.takes_setpoint = mapping.setpoint is not None
        if mapping.setpoint is not None:
            place = self._written["setpoint"] = self._place(mapping.setpoint, ("setpoint",))
            try:
                place.holds()
            except ValueError as error:
                raise ProfileError(f"{file.source}: {place.text}: {error}", ("setpoint",)) from None
        self._guards: dict[int, FrameGuard] = {}  # by the identifier of their messages
        for i, protection in enumerate(self._mapping.protected):
            layout = self._file.layout(protection.message, ("protect", i, "message"))
            self._guards[self._file.frame_id(layout)] = guard_of(layout, protection, self._file.source, ("protect", i))
        require_distinct(self._uses(), file.source)

    def _uses(self) -> Iterator[Use]:
        """Where everything of the mapping lies, and what is put into its messages beside it."""
        for role, what, key, at in self._mapping.named():
            yield self._place(at, key).used_as(role, what, key)
        for i, one in enumerate(self._mapping.protected):
            for role in ("counter", "checksum"):
                if name := getattr(one, role):
                    key = ("protect", i, role)
                    yield self._file.signal(one.message, name, key).used_as(f"protect.{role}", role, key)
        for name in self._mapping.fixed:
            message, _, signal = name.partition(".")
            yield self._file.signal(message, signal, ("fixed",)).used_as("fixed", "fixed", ("fixed",))

    def _place(self, at: object, key: Key) -> SignalPlace:
        assert isinstance(at, SignalOf)
        return self._file.place(at.message, at.signal, key, at.scale, at.offset)

    def _hear(self, name: str, at: object, key: Key) -> None:
        assert isinstance(at, SignalOf)
        place = self._place(at, key)
        self._heard.setdefault((place.frame_id, place.layout.is_extended_frame), []).append((name, place))
        if at.on_request:
            self._requests[name] = place
        if at.on_request and at.ask is not None:
            self._asks[name] = ask_frame(self._file, at.ask, key)

    def _watch(self, states: States, key: Key, *, stop: bool) -> None:
        place = self._place(states.at, key)
        known = self._states.setdefault((place.frame_id, place.layout.is_extended_frame), [])
        known.append(_State(place, states, stop))

    def take(self, message: can.Message) -> Sequence[Told]:
        """What a frame tells: see Access."""
        if message.is_remote_frame or message.is_error_frame:
            return ()
        at = (message.arbitration_id, message.is_extended_id)
        heard, states = self._heard.get(at, []), self._states.get(at, [])
        layout = next((place.layout for place in (*(p for _, p in heard), *(s.place for s in states))), None)
        if layout is None:
            return ()
        guard = self._guards.get(message.arbitration_id)
        if guard is not None and not guard.accepts(bytes(message.data)):
            self.damaged += 1
            return ()
        try:
            values = layout.decode(bytes(message.data), decode_choices=False, allow_truncated=False)
        except DECODING_ERRORS:
            self.damaged += 1
            return ()
        return list(self._told(values if isinstance(values, Mapping) else {}, heard, states))

    def _told(
        self, values: Mapping[str, object], heard: Iterable[tuple[str, SignalPlace]], states: Iterable[_State]
    ) -> Iterable[Told]:
        """Numbers and states of one decoded frame; a number that is none is passed over."""
        yield Alive()
        for state in states:
            value = _number(values.get(state.place.signal.name))
            if value is None:
                continue
            expected = state.states.holds(value)
            if not state.stop:
                yield Heard("mode", float(expected))
            elif expected:
                yield NoFault(state.place.text)
            else:
                yield Stopped(state.states.reason or f"{state.place.text} = {value:g}", state.place.text)
        for name, place in heard:
            value = _number(values.get(place.signal.name))
            if value is not None:
                yield Heard(name, place.scale * value + place.offset)

    def ask(self, names: Iterable[str]) -> None:
        """Have numbers sent that come on request only."""
        asked: set[object] = set()
        for name in names:
            place, ask = self._requests.get(name), self._asks.get(name)
            if ask is not None and (ask.place.frame_id, ask.values) not in asked:
                asked.add((ask.place.frame_id, ask.values))
                self._queue.append(ask.message(self._guards.get(ask.place.frame_id)))
            elif ask is None and place is not None and place.frame_id not in asked:
                asked.add(place.frame_id)
                self._queue.append(
                    can.Message(
                        arbitration_id=place.frame_id,
                        is_extended_id=place.layout.is_extended_frame,
                        is_remote_frame=True,
                        dlc=min(place.layout.length, 8),
                    )
                )

    def put(self, numbers: Mapping[str, float]) -> None:
        """Have numbers written: see Access."""
        slots: dict[Slot, SignalPlace] = {}
        for name, number in numbers.items():
            place = self._written.get(name)
            if place is None:
                raise ValueError(f"the mapping has no entry for {name}")
            value = (number - place.offset) / place.scale
            try:
                value = place.holds().nearest(value)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
            slot = (place.frame_id, place.page)
            last = self._last.setdefault(slot, defaults(place.layout, place.page, self._mapping.fixed))
            last[place.signal.name] = value
            slots.setdefault(slot, place)
        for slot, place in slots.items():
            try:
                frame = data_frame(place.layout, place.frame_id, self._last[slot], self._guards.get(place.frame_id))
            except DECODING_ERRORS as error:
                raise ValueError(f"message {place.layout.name}: {' '.join(str(error).split())[:160]}") from None
            self._queue.append(frame)

    def due(self, now_s: float) -> Sequence[can.Message]:
        """What is to be sent."""
        del now_s
        queue, self._queue = self._queue, []
        return queue

    def forget(self) -> None:
        """Give up what waits."""
        self._queue.clear()


def _number(value: object) -> float | None:
    if not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
