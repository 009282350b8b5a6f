"""Where the examined device is: an object in this thread, or a node on a bus in real time."""

from collections.abc import Callable
from typing import Protocol

import can

from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import Clock
from retuner.drivers.protocol.codec import COMMAND_BITS

TELEMETRY_SP, HEARTBEAT = 0x13, 0x10
QUIET_S = 0.03  # no frame for so long: whatever was to be answered has been
ANSWER_S = 0.3  # longest wait for the first frame after a question


class Answering(Protocol):
    """A device as an object: see VirtualDevice."""

    def step(self) -> list[can.Message]:
        """One controller sample."""
        ...

    def receive(self, message: can.Message) -> list[can.Message]:
        """A frame, and its answers."""
        ...

    def restart(self) -> None:
        """Power off and on."""
        ...


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


class OnBus:
    """A node on a bus.

    Parameters
    ----------
    link : open bus of its own. clock : the machine's, in real seconds. node : the device's.
    sample_s : real seconds of a controller sample.
    restart : lets somebody switch the device off and on; whether that was done.
    """

    def __init__(
        self, link: CanLink, clock: Clock, node: int, sample_s: float, restart: Callable[[], bool] = lambda: False
    ) -> None:
        self._link, self._clock, self._node, self._sample_s = link, clock, node, sample_s
        self._ask = restart
        self._waiting: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        """Put it on the bus."""
        self._link.send(message)

    def heard(self) -> list[can.Message]:
        """What comes until the node is quiet."""
        self._listen(self._clock.now_s() + ANSWER_S, lambda _: False)
        messages, self._waiting = self._waiting, []
        return messages

    def sample(self) -> list[can.Message]:
        """What comes until a whole sample has come."""
        patience_s = self._clock.now_s() + 4 * self._sample_s + 1.0
        self._listen(patience_s, lambda m: m.arbitration_id & 31 == TELEMETRY_SP, quiet_s=patience_s)
        messages, self._waiting = self._waiting, []
        return messages

    def restart(self) -> bool:
        """Ask for it; what was heard of the time before is forgotten."""
        done = self._ask()
        self._link.receive_all()
        self._waiting = []
        return done

    def _listen(self, until_s: float, last: Callable[[can.Message], bool], quiet_s: float = QUIET_S) -> None:
        """Take the node's frames until one is the last, the node is quiet, or the time is over."""
        clock, heard_s = self._clock, self._clock.now_s()
        answered = ended = False
        while not ended and clock.now_s() < until_s and not (answered and clock.now_s() - heard_s > quiet_s):
            self._link.wait_until(min(until_s, clock.now_s() + QUIET_S))
            for message in self._link.receive_all():
                if message.arbitration_id >> COMMAND_BITS != self._node or message.is_extended_id:
                    continue
                self._waiting.append(message)
                ended = ended or last(message)
                if message.arbitration_id & 31 not in {TELEMETRY_SP, TELEMETRY_SP - 1, HEARTBEAT, HEARTBEAT + 1}:
                    answered, heard_s = True, clock.now_s()
