"""Two naive protocols over the same bus in the same weather: they must be seen to fail, or the harness has no teeth.

A frame per gain, applied when it arrives; and one frame with both gains, without checksum, number or range. The host
sends a new set every UPDATE_EVERY steps. The invariants are those that the real protocol is held to.
"""

import math
import struct
from collections import Counter
from random import Random

import can

from bus_simulation.bus import Bus
from bus_simulation.weather import CHANGE_EVERY, draw

UPDATE_EVERY = 25  # steps
KP_ID, BOTH_ID = 0x24, 0x26
KP_MAX, KI_MAX = 100.0, 10.0
KIND = ("a frame per gain", "one frame without check")


class NaiveWorld:
    """A host and a device with two gains.

    seed : decides everything. per_gain : a frame per gain, else one for both.
    """

    def __init__(self, seed: int, *, per_gain: bool) -> None:
        self._rng, self._per_gain = Random(seed), per_gain
        self._bus = Bus(self._rng, ("device", "host"))
        self._running = [1.0, 0.0625]
        self._newest = 0
        self._orders: dict[tuple[float, float], int] = {(1.0, 0.0625): 0}
        self.counts: Counter[str] = Counter()

    def run(self, steps: int) -> Counter[str]:
        """So many steps; in how many of them which invariant was broken."""
        for number in range(steps):
            if number % CHANGE_EVERY == 0:
                weather = self._bus.weather = draw(self._rng)
                self._bus.ways["device"].cut = weather.out_cut
            self._bus.tick(number)
            if number % UPDATE_EVERY == 0:
                wire = struct.pack("<ff", self._rng.uniform(0.5, 20.0), self._rng.uniform(0.01, 1.0))
                kp, ki = struct.unpack("<ff", wire)
                self._orders[kp, ki] = number
                frames = [(KP_ID, b"\0" + wire[:4]), (KP_ID, b"\1" + wire[4:])] if self._per_gain else [(BOTH_ID, wire)]
                for id_, data in frames:
                    self._bus.send("host", can.Message(arbitration_id=id_, is_extended_id=False, data=data))
            for message in self._bus.ways["device"].take():
                # What arrives is what runs
                data = bytes(message.data)
                if self._per_gain and len(data) == 5 and data[0] < 2:
                    (self._running[data[0]],) = struct.unpack("<f", data[1:])
                elif not self._per_gain and len(data) == 8:
                    self._running = list(struct.unpack("<ff", data))
            self._bus.ways["host"].take()
            self._check()
        self.counts["steps"] = steps
        return self.counts

    def _check(self) -> None:
        """The invariants, by the names that they have in truth.py."""
        kp, ki = self._running
        number = self._orders.get((kp, ki))
        if not (math.isfinite(kp) and math.isfinite(ki) and 0 <= kp <= KP_MAX and 0 <= ki <= KI_MAX):
            self.counts["finite_and_inside_the_box"] += 1
        if number is None:
            self.counts["running_set_is_a_committed_one"] += 1
        elif number < self._newest:
            self.counts["sequence_is_monotonic"] += 1
        else:
            self._newest = number
