"""The loop inside a virtual foreign controller: our PID law on a simulated plant, and how a bench disturbs it."""

import struct

import can

from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings
from retuner.drivers.plants.plant import Plant
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import StateTuple, change, start, step

LOAD_ID = 0x10100
"""29-bit identifier of a load for a simulated plant, + node: float32, percent. No real device listens to it."""


class BenchLoop:
    """Law and plant, at rest at first.

    settings : of the law, with the gains at the start. plant : what it controls.
    """

    def __init__(self, settings: VirtualDeviceSettings, plant: Plant) -> None:
        self.settings, self.plant = settings, plant
        self.gains, self.load = settings.gains, 0.0
        self.sp = self.pv = plant.pv
        self._law = settings.law_of(settings.gains)
        self._state: StateTuple = start(self._law, self.sp, self.pv, plant.steady_co(self.pv, 0.0))
        self.co = plant.steady_co(self.pv, 0.0)

    def step(self, dt_s: float) -> None:
        """One sample."""
        self.pv = self.plant.step(self.co, self.load, dt_s)
        self._state, self.co = step(self._law, self._state, self.sp, self.pv, dt_s)

    def take_gains(self, gains: PidGains) -> None:
        """Run other gains from the next sample on."""
        law = self.settings.law_of(gains)
        self._state = change(self._law, law, self._state, self.sp, self.pv, self.settings.sample_time_s)
        self._law, self.gains = law, gains


def load_frame(node: int, load: float) -> can.Message:
    """The frame that disturbs a simulated plant."""
    return can.Message(arbitration_id=LOAD_ID + node, is_extended_id=True, data=struct.pack("<f", load))


def load_of(node: int, message: can.Message) -> float | None:
    """The load in a frame; None when it is another one."""
    fits = message.arbitration_id == LOAD_ID + node and message.is_extended_id and len(message.data) == 4
    return float(struct.unpack("<f", message.data)[0]) if fits and not message.is_remote_frame else None
