"""A device that is examined in the thread of who asks, without a bus."""

from typing import Protocol

import can


class Answering(Protocol):
    """A device as an object: see VirtualDevice."""

    def step(self) -> list[can.Message]:
        """One controller sample."""

    def receive(self, message: can.Message) -> list[can.Message]:
        """A frame, and its answers."""

    def restart(self) -> None:
        """Power off and on."""


class InThread:
    """A device in this thread, in simulated time."""

    def __init__(self, device: Answering) -> None:
        self._device = device
        self._waiting: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        """Answered at once."""
        self._waiting += self._device.receive(message)

    def heard(self) -> list[can.Message]:
        """The answers."""
        messages, self._waiting = self._waiting, []
        return messages

    def sample(self) -> list[can.Message]:
        """One controller sample."""
        return [*self.heard(), *self._device.step()]

    def restart(self) -> bool:
        """Power off and on."""
        self._device.restart()
        return True
