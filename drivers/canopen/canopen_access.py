"""A CANopen node: gains and setpoint by SDO with their acknowledges, telemetry by the PDOs that its EDS has in force.

What no PDO carries is read by SDO, sample by sample. A boot-up, a stop by NMT and an emergency are the node's own word.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import can
from canopen.emcy import EmcyError
from canopen.objectdictionary import ObjectDictionaryError, datatypes

from retuner.drivers.canopen.eds_file import EdsFile, Key, PdoEntry, Variable, holds, text_of
from retuner.drivers.canopen.sdo_queue import SdoQueue, pace_s
from retuner.drivers.profiles.controller_access import (
    Acknowledged,
    Alive,
    Denied,
    Doubted,
    Heard,
    NoFault,
    ProfileError,
    Started,
    Stopped,
    Told,
    Use,
    require_distinct,
    units_of,
)
from retuner.drivers.profiles.mapping import DeviceMapping, ObjectOf, States
from retuner.schedule.vendor_units import VendorGain

NMT, HEARTBEAT, EMERGENCY = 0x000, 0x700, 0x080
START = 0x01
BOOTED, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
WRITTEN = "write "
ALWAYS, WHOLE = frozenset[int](), frozenset({0})  # an object is on no page, and one place


class NodeSettings(NamedTuple):
    """What the host does beside. start : NMT start of a node found pre-operational. heartbeat_s : period of its own
    heartbeat as node own_node, 0 for none. reply_s : how long an SDO answer is awaited, s.
    """

    start: bool = True
    heartbeat_s: float = 0.0
    own_node: int = 127
    reply_s: float = 0.3


class _ObjectPlace(NamedTuple):
    """An object and its conversion: ours = scale x its + offset."""

    variable: Variable
    scale: float = 1.0
    offset: float = 0.0


class CanOpenAccess:
    """See the head of this file.

    file : the objects. mapping : what is what. settings : see there.

    Raises ProfileError: an object is not there, or cannot be what it is said to be.
    """

    acknowledges = True

    def __init__(self, file: EdsFile, mapping: DeviceMapping, settings: NodeSettings | None = None) -> None:
        self._file, self._settings = file, settings or NodeSettings()
        self._sdo = SdoQueue(file.node, self._settings.reply_s)
        self._read: dict[str, _ObjectPlace] = {}
        self._written: dict[str, _ObjectPlace] = {}
        self._watched: dict[str, States] = {}
        self._queue: list[can.Message] = []
        self._beat_s = float("-inf")
        self._read["pv"] = self._place(mapping.pv, ("pv",))
        self._read["co"] = self._place(mapping.co, ("co",))
        if mapping.sp is not None:
            self._read["sp"] = self._place(mapping.sp, ("sp",))
        if mapping.mode is not None:
            self._watch("mode", mapping.mode, ("mode",))
        for i, states in enumerate(mapping.stops):
            self._watch(f"stop {i}", states, ("stop", i))
        if mapping.setpoint is not None:
            self._written["setpoint"] = self._place(mapping.setpoint, ("setpoint",), written=True, read=False)
        gains = []
        for i, gain in enumerate(mapping.gains):
            key: Key = ("gains", str(gain.quantity))
            variable = self._place(gain.at, key, written=True).variable
            self._read[gain.quantity] = self._written[gain.quantity] = _ObjectPlace(variable)
            try:
                gains.append(VendorGain(gain.quantity, gain.scale, holds(variable), i, gain.off))
            except ValueError as error:
                raise ProfileError(f"object {text_of(variable)}: {error}", key) from None
        self.units = units_of(mapping, gains)
        self.reads_back = bool(mapping.gains)
        self.takes_setpoint = mapping.setpoint is not None
        # each object is a place of its own
        named = [
            (role, what, key, self._place(at, key, read=False).variable) for role, what, key, at in mapping.named()
        ]
        require_distinct(
            (Use(role, what, (v.index, v.subindex), ALWAYS, WHOLE, text_of(v), key) for role, what, key, v in named),
            file.source,
        )
        # what each PDO that the device sends carries of this
        self._pdos: dict[int, list[tuple[str, PdoEntry]]] = {}
        places = {name: place.variable for name, place in self._read.items() if name not in self.units.names}
        for cob, entries in file.tpdos():
            found = [
                (name, entry)
                for entry in entries
                for name, variable in places.items()
                if (variable.index, variable.subindex) == (entry.variable.index, entry.variable.subindex)
            ]
            if found:
                self._pdos[cob] = found
        carried = {name for entries in self._pdos.values() for name, _ in entries}
        self.on_request = frozenset(name for name in self._read if name not in carried) - set(self.units.names)
        self.telemetry = frozenset({"pv", "co", "sp", "mode"} & self._read.keys())

    def _place(self, at: object, key: Key, *, written: bool = False, read: bool = True) -> _ObjectPlace:
        assert isinstance(at, ObjectOf)
        return _ObjectPlace(self._file.variable(at.object, key, written=written, read=read), at.scale, at.offset)

    def _watch(self, name: str, states: States, key: Key) -> None:
        self._read[name], self._watched[name] = self._place(states.at, key), states

    def take(self, message: can.Message) -> Sequence[Told]:
        """What a frame tells: see Access."""
        if message.is_remote_frame or message.is_error_frame or message.is_extended_id:
            return ()
        node, cob = self._file.node, message.arbitration_id
        if cob == 0x580 + node:
            answer = self._sdo.take(message)
            if answer is None:
                doubled, self._sdo.doubled = self._sdo.doubled.removeprefix(WRITTEN), ""
                return (Alive(), Doubted(doubled)) if doubled in self.units.names else (Alive(),)
            name = answer.transfer.name
            if answer.refused:
                where = text_of(answer.transfer.variable)
                return (Alive(), Denied(name.removeprefix(WRITTEN), f"object {where}: {answer.refused}"))
            if answer.data is None:
                return (Alive(), Acknowledged(name.removeprefix(WRITTEN)))
            return (Alive(), *self._number(name, answer.transfer.variable, answer.data))
        if cob in self._pdos:
            data = bytes(message.data)
            whole = int.from_bytes(data, "little")
            told: list[Told] = [Alive()]
            for name, entry in self._pdos[cob]:
                if entry.first + entry.bits > 8 * len(data) or entry.bits % 8:
                    return ()
                part = whole >> entry.first & ((1 << entry.bits) - 1)
                told += self._number(name, entry.variable, part.to_bytes(entry.bits // 8, "little"))
            # states first
            return sorted(told, key=lambda one: isinstance(one, Heard) and one.name in {"pv", "co"})
        if cob == HEARTBEAT + node and message.data:
            state = message.data[0] & 0x7F
            if state == BOOTED:
                return (Alive(), Started())
            if state == PRE_OPERATIONAL and self._settings.start:
                self._queue.append(_frame(NMT, bytes([START, self._file.node])))
            if state == STOPPED:
                return (Alive(), Stopped("the node was stopped (NMT)", "nmt"))
            return (Alive(), NoFault("nmt")) if state == OPERATIONAL else (Alive(),)
        if cob == EMERGENCY + node and len(message.data) == 8:
            # An emergency object; error code 0 says that it is over
            data = bytes(message.data)
            code, register = int.from_bytes(data[:2], "little"), data[2]
            if not code:
                return (Alive(), NoFault("emergency"))
            described = EmcyError(code, register, data[3:], 0.0).get_desc()
            words = f", {described.lower()}" if described else ""
            return (Alive(), Stopped(f"emergency {code:#06x}{words}", "emergency"))
        return ()

    def _number(self, name: str, variable: Variable, data: bytes) -> Sequence[Told]:
        try:
            value = variable.decode_raw(data)
        except (ObjectDictionaryError, ValueError):
            value = None
        if not isinstance(value, int | float) or not abs(value) < float("inf"):
            return ()
        states = self._watched.get(name)
        if states is None:
            place = self._read[name]
            return (Heard(name, place.scale * float(value) + place.offset),)
        expected = states.holds(value)
        if name == "mode":
            return (Heard("mode", float(expected)),)
        if expected:
            return (NoFault(name),)
        return (Stopped(states.reason or f"object {text_of(variable)} = {int(value):#x}", name),)

    def polled(self, sample_time_s: float) -> str:
        """How fast what no PDO carries can be read, in a sentence; "" where all comes by PDO."""
        names = sorted(self.on_request)
        if not names:
            return ""
        wire_s, whole_s = pace_s(self._read[name].variable for name in names)
        told = (
            f"{', '.join(names)}: read by SDO for each sample; {1e3 * wire_s:.2g} ms on a free bus of 500 kbit/s, "
            f"about {1e3 * whole_s:.2g} ms where a node answers in 5 ms"
        )
        if sample_time_s >= whole_s:
            return told
        return f"{told}; sample_time_s = {sample_time_s:g} s is shorter: map them into a PDO, or sample more slowly"

    def ask(self, names: Iterable[str]) -> None:
        """Have numbers read."""
        for name in names:
            self._sdo.ask(name, self._read[name].variable)

    def put(self, numbers: Mapping[str, float]) -> None:
        """Have numbers written: see Access."""
        for name, number in numbers.items():
            place = self._written.get(name)
            if place is None:
                raise ValueError(f"the mapping has no entry for {name}")
            variable = place.variable
            try:
                value = holds(variable).nearest((number - place.offset) / place.scale)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
            raw = value if variable.data_type in datatypes.FLOAT_TYPES else round(value)
            self._sdo.ask(WRITTEN + name, variable, variable.encode_raw(raw))

    def due(self, now_s: float) -> Sequence[can.Message]:
        """What is to be sent."""
        queue, self._queue = self._queue, []
        beat = self._settings.heartbeat_s
        if beat and now_s >= self._beat_s + beat:
            self._beat_s = now_s
            queue.append(_frame(HEARTBEAT + self._settings.own_node, bytes([OPERATIONAL])))
        return [*queue, *self._sdo.due(now_s)]

    def forget(self) -> None:
        """Give up what is under way."""
        self._sdo.forget()
        self._queue.clear()


def _frame(cob: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=cob, is_extended_id=False, data=data)
