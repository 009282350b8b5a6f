"""A controller that a DBC describes, in software: for benches, and to try a mapping before the motor turns.

It sends what the mapping hears and obeys what the mapping writes; whatever the device would do beside is not simulated.
"""

from collections.abc import Callable, Mapping
from functools import partial

import can

from retuner.drivers.dbc.dbc_access import AskFrame, DbcAccess, ask_frame
from retuner.drivers.dbc.dbc_file import DbcFile, SignalPlace, defaults
from retuner.drivers.dbc.frame_guard import FrameGuard, data_frame, guard_of
from retuner.drivers.profiles.bench_loop import BenchLoop, load_of
from retuner.drivers.profiles.mapping import DeviceMapping, SignalOf
from retuner.drivers.telemetry.signal_source import DECODING_ERRORS
from retuner.schedule.vendor_units import VendorUnits

Slot = tuple[int, int | None]


class VirtualDbcDevice:
    """See the head of this file.

    file, mapping : as DbcAccess. loop : law and plant. node : of the device.
    """

    def __init__(self, file: DbcFile, mapping: DeviceMapping, loop: BenchLoop, node: int) -> None:
        self.loop, self.node = loop, node
        self.sample_time_s = loop.settings.sample_time_s
        self.units: VendorUnits = DbcAccess(file, mapping).units
        self.numbers = dict(self.units.numbers(loop.settings.gains))
        loop.take_gains(self.units.of(self.numbers))
        self.healthy = True
        self.refused = 0
        self._file, self._mapping = file, mapping
        self._sent: dict[Slot, dict[str, Callable[[], float]]] = {}
        self._places: dict[Slot, SignalPlace] = {}
        self._on_request: set[Slot] = set()
        self._asked_by: list[tuple[AskFrame, Slot]] = []
        self._guards: dict[int, FrameGuard] = {}
        self._send(mapping.pv, lambda: loop.pv)
        self._send(mapping.co, lambda: loop.co)
        if mapping.sp is not None:
            self._send(mapping.sp, lambda: loop.sp)
        for states in (*mapping.stops, *([mapping.mode] if mapping.mode else [])):
            self._send(states.at, partial(self._state, float(states.expected[0])))
        for gain in mapping.gains:
            if gain.read is not None:
                self._send(gain.read, partial(self.numbers.__getitem__, str(gain.quantity)))
        for protection in mapping.protected:
            layout = self._file.layout(protection.message, ("protect",))
            self._guards[self._file.frame_id(layout)] = guard_of(layout, protection, self._file.source, ())

    def _state(self, good: float) -> float:
        return good if self.healthy else good + 1.0

    def _send(self, at: object, value: Callable[[], float]) -> None:
        assert isinstance(at, SignalOf)
        place = self._file.place(at.message, at.signal, (), at.scale, at.offset)
        slot = (place.frame_id, place.page)
        self._places[slot] = place
        self._sent.setdefault(slot, {})[at.signal] = lambda: (value() - place.offset) / place.scale
        self._on_request |= {slot} if at.on_request else set()
        self._asked_by += [(ask_frame(self._file, at.ask, ()), slot)] if at.on_request and at.ask is not None else []

    def step(self, dt_s: float | None = None) -> list[can.Message]:
        """One controller sample; what the device sends by itself."""
        self.loop.step(self.sample_time_s if dt_s is None else dt_s)
        return [self._frame(slot) for slot in self._sent if slot not in self._on_request]

    def receive(self, message: can.Message) -> list[can.Message]:
        """Take a frame; the answer to a request. Anything whatsoever may come."""
        load = load_of(self.node, message)
        if load is not None:
            self.loop.load = load
            return []
        if message.is_remote_frame:
            slots = [s for s in self._on_request if s[0] == message.arbitration_id]
            extended = message.is_extended_id
            return [self._frame(s) for s in slots if self._places[s].layout.is_extended_frame == extended]
        asked = list(dict.fromkeys(slot for ask, slot in self._asked_by if ask.is_asked_by(message)))
        if asked:
            return [self._frame(slot) for slot in asked]
        written = {str(gain.quantity): gain.at for gain in self._mapping.gains}
        if self._mapping.setpoint is not None:
            written["setpoint"] = self._mapping.setpoint
        found: dict[str, float] = {}
        for name, at in written.items():
            assert isinstance(at, SignalOf)
            place = self._file.place(at.message, at.signal, (), at.scale, at.offset)
            if (place.frame_id, place.layout.is_extended_frame) != (message.arbitration_id, message.is_extended_id):
                continue
            value = self._decoded(place, message)
            if value is not None:
                found[name] = place.scale * value + place.offset
        if "setpoint" in found:
            self.loop.sp = found.pop("setpoint")
        if found:
            try:
                self.loop.take_gains(self.units.of({**self.numbers, **found}))
                self.numbers.update(found)
            except ValueError:
                self.refused += 1
        return []

    def _frame(self, slot: Slot) -> can.Message:
        place = self._places[slot]
        values = defaults(place.layout, place.page, {})
        for name, value in self._sent[slot].items():
            there = SignalPlace(place.layout, place.layout.get_signal_by_name(name), place.frame_id).holds()
            values[name] = there.nearest(min(max(value(), there.low), there.high))
        return data_frame(place.layout, slot[0], values, self._guards.get(slot[0]))

    def _decoded(self, place: SignalPlace, message: can.Message) -> float | None:
        try:
            values = place.layout.decode(bytes(message.data), decode_choices=False)
        except DECODING_ERRORS:
            self.refused += 1
            return None
        value = values.get(place.signal.name) if isinstance(values, Mapping) else None
        return float(value) if isinstance(value, int | float) else None
