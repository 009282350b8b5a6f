"""A second implementation of the device beside the first: told the same, it must answer the same, byte for byte.

So every layer is looked at, also one whose work another layer would do as well: a device that lacks it is found by its
answers, not by what they lead to.
"""

from collections import deque
from collections.abc import Callable
from random import Random

import can

from bus_simulation.truth import ViolationError
from retuner.drivers.controller.virtual_device import VirtualDevice

TELEMETRY_PV, TELEMETRY_SP = 0x12, 0x13
NOT_LIMITED = 0b11111001  # of the byte with mode, limited and running: limited follows from co in other arithmetic


class Drawn:
    """Challenges for two devices: what the first has drawn, the second gets."""

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._waiting: deque[int] = deque()

    def first(self) -> int:
        """A new one."""
        self._waiting.append(self._rng.getrandbits(48))
        return self._waiting[-1]

    def second(self) -> int:
        """The same; none is left when the first should have drawn one and has not."""
        if not self._waiting:
            raise ViolationError("answers_as_its_twin: a challenge was not renewed")
        return self._waiting.popleft()


class _SamePlant:
    """The first device's plant as the second one sees it."""

    def __init__(self, device: VirtualDevice) -> None:
        self._device = device

    @property
    def pv(self) -> float:
        return float(self._device.pv)

    def step(self, *_: float) -> float:
        """As the first device has read it."""
        return self.pv

    def steady_co(self, *_: float) -> float:
        """As the first device began."""
        return float(self._device.co)


class Twin:
    """The second device.

    Parameters
    ----------
    device : the first one. make : builds the second one on a plant.
    """

    def __init__(self, device: VirtualDevice, make: Callable[[_SamePlant], VirtualDevice]) -> None:
        self._first = device
        self.device = make(_SamePlant(device))

    def receive(self, message: can.Message, replies: list[can.Message]) -> None:
        """A frame that the first has answered so."""
        self._compare([bytes(m.data) for m in replies], [bytes(m.data) for m in self.device.receive(message)], message)

    def step(self, messages: list[can.Message], dt_s: float) -> None:
        """A sample of the first."""
        self._compare(*([_without_co(m) for m in ms] for ms in (messages, self.device.step(dt_s))), None)

    def restart(self) -> None:
        """Power off and on, as the first."""
        self.device.restart()

    def _compare(self, first: list[bytes], second: list[bytes], message: can.Message | None) -> None:
        """Raises ViolationError when they differ."""
        if first != second:
            about = "a sample" if message is None else f"{message.arbitration_id:03X}#{bytes(message.data).hex()}"
            raise ViolationError(f"answers_as_its_twin: {about}: {first} and {second}")


def _without_co(message: can.Message) -> bytes:
    """A frame's bytes without what follows from co: the two are computed in different arithmetic."""
    command, data = message.arbitration_id & 31, bytes(message.data)
    if command == TELEMETRY_PV:
        return data[:5]
    return data[:5] + bytes([data[5] & NOT_LIMITED]) if command == TELEMETRY_SP else data
