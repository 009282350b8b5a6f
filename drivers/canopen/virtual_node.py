"""A CANopen node in software, for benches: the package's own LocalNode, with a loop behind the objects of a mapping.

Object dictionary, SDO server, NMT and PDOs are `canopen`'s; so a host that is understood here is understood by code
that shares nothing with it.
"""

from contextlib import suppress
from typing import Any, cast

import can
import canopen
from canopen.network import PeriodicMessageTask
from canopen.objectdictionary import datatypes

from retuner.drivers.canopen.canopen_access import CanOpenAccess
from retuner.drivers.canopen.eds_file import EdsFile, Variable, holds
from retuner.drivers.profiles.bench_loop import BenchLoop, load_of
from retuner.drivers.profiles.mapping import DeviceMapping, ObjectOf
from retuner.schedule.vendor_units import VendorUnits

HEARTBEAT = 0x700
OPERATIONAL, PRE_OPERATIONAL = 5, 127
BEAT_SAMPLES = 5


class _Unsent(PeriodicMessageTask):
    """A frame that the package would repeat by the machine's clock; here the samples are the clock."""

    def _start(self) -> None:
        """No thread begins."""

    def stop(self) -> None:
        """There is none to stop."""

    def update(self, data: bytes) -> None:
        """Nor one to change."""


class _OffLine(canopen.Network):
    """A network without a bus and without threads: what is sent is kept, what comes is handed in."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[can.Message] = []

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Keep a frame."""
        self.sent.append(
            can.Message(arbitration_id=can_id, is_extended_id=False, is_remote_frame=remote, data=bytes(data))
        )

    def send_periodic(self, can_id: int, data: bytes, period: float, remote: bool = False) -> PeriodicMessageTask:
        """Do nothing: an EDS that has a heartbeat (1017) would begin one here; the node's samples send theirs."""
        return _Unsent(can_id, data, period, self.bus, remote)


class VirtualCanOpenNode:
    """See the head of this file.

    file, mapping : as CanOpenAccess. loop : law and plant.
    """

    def __init__(self, file: EdsFile, mapping: DeviceMapping, loop: BenchLoop) -> None:
        self.loop, self.sample_time_s = loop, loop.settings.sample_time_s
        self.units: VendorUnits = CanOpenAccess(file, mapping).units
        self._file, self._mapping = file, mapping
        self._network = _OffLine()
        self.node = cast("Any", canopen.LocalNode(file.node, file.dictionary))
        self.node.associate_network(self._network)
        self.refused = self._samples = 0
        # state after power-on: gains as the loop has them, boot-up sent, then operational or waiting for the start
        self.numbers = dict(self.units.numbers(loop.settings.gains))
        for gain in mapping.gains:
            self._put(gain.at, self.numbers[gain.quantity])
        loop.take_gains(self.units.of(self.numbers))
        if mapping.setpoint is not None:
            self._put(mapping.setpoint, loop.sp)
        self._publish()
        self.node.add_write_callback(self._on_write)
        self.node.tpdo.read(from_od=True)
        self._network.send_message(HEARTBEAT + self._file.node, b"\0")
        self.node.nmt.state = "PRE-OPERATIONAL"

    def _variable(self, at: object) -> tuple[Variable, ObjectOf]:
        assert isinstance(at, ObjectOf)
        return self._file.variable(at.object, (), read=False), at

    def _put(self, at: object, ours: float) -> None:
        variable, place = self._variable(at)
        there = holds(variable)
        value = there.nearest(min(max((ours - place.offset) / place.scale, there.low), there.high))
        raw = variable.encode_raw(value if variable.data_type in datatypes.FLOAT_TYPES else round(value))
        self.node.set_data(variable.index, variable.subindex, raw)

    def _publish(self) -> None:
        loop, mapping = self.loop, self._mapping
        self._put(mapping.pv, loop.pv)
        self._put(mapping.co, loop.co)
        if mapping.sp is not None:
            self._put(mapping.sp, loop.sp)
        told: dict[tuple[int, int], int] = {}
        for states in (*mapping.stops, *([mapping.mode] if mapping.mode else [])):
            variable, _ = self._variable(states.at)
            at = variable.index, variable.subindex
            told[at] = told.get(at, 0) | states.expected[0]  # a value that is as it should be
        for (index, sub), value in told.items():
            told_by = self._file.dictionary.get_variable(index, sub)
            assert told_by is not None
            self.node.set_data(index, sub, told_by.encode_raw(value))

    def step(self, dt_s: float | None = None) -> list[can.Message]:
        """One controller sample: PDOs while operational, a heartbeat now and then."""
        self.loop.step(self.sample_time_s if dt_s is None else dt_s)
        self._publish()
        self._samples += 1
        operational = self.node.nmt.state == "OPERATIONAL"
        if self._samples % BEAT_SAMPLES == 1:
            state = OPERATIONAL if operational else PRE_OPERATIONAL
            self._network.send_message(HEARTBEAT + self._file.node, bytes([state]))
        if operational:
            for pdo in self.node.tpdo.values():
                if not pdo.enabled or not len(pdo):
                    continue
                for variable in pdo:
                    with suppress(canopen.SdoAbortedError):  # nothing is known of an object that the loop has not
                        variable.set_data(self.node.get_data(variable.index, variable.subindex))
                pdo.transmit()
        return self._taken()

    def receive(self, message: can.Message) -> list[can.Message]:
        """Take a frame; the frames that answer it. Anything whatsoever may come."""
        load = load_of(self._file.node, message)
        if load is not None:
            self.loop.load = load
        elif not (message.is_error_frame or message.is_extended_id or message.is_remote_frame):
            try:
                self._network.notify(message.arbitration_id, bytearray(message.data), message.timestamp)
            except (ValueError, LookupError, TypeError, IndexError, OSError):  # a damaged frame
                self.refused += 1
        return self._taken()

    def emergency(self, code: int) -> list[can.Message]:
        """Tell of an error, or with code 0 that it is over."""
        self._network.send_message(0x80 + self._file.node, code.to_bytes(2, "little") + bytes(6))
        return self._taken()

    def _taken(self) -> list[can.Message]:
        sent, self._network.sent = self._network.sent, []
        return sent

    def _on_write(self, index: int, subindex: int, od: Variable, data: bytes) -> None:
        value = od.decode_raw(bytes(data))
        for gain in self._mapping.gains:
            variable, _ = self._variable(gain.at)
            if (variable.index, variable.subindex) == (index, subindex):
                new = {**self.numbers, str(gain.quantity): float(value)}
                try:
                    self.loop.take_gains(self.units.of(new))
                except ValueError as error:
                    self.refused += 1
                    raise canopen.SdoAbortedError(0x06090030) from error
                self.numbers = new
        if self._mapping.setpoint is not None:
            variable, place = self._variable(self._mapping.setpoint)
            if (variable.index, variable.subindex) == (index, subindex):
                self.loop.sp = place.scale * float(value) + place.offset
