"""Where the examined device is: an object in this thread, or a node on a bus in real time."""

from collections.abc import Callable
from typing import Protocol

import can

from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import Clock
from retuner.drivers.protocol.codec import COMMAND_BITS, Codec, Refused
from retuner.drivers.protocol.frames import CHALLENGE_TAG, Challenge, Page, Read

READ, TELEMETRY_SP = 0x02, 0x13
LOOK_S = 0.03  # longest sleep
LEAST_S = 0.3  # longest wait for an answer, at least: an operating system lets a process wait that long
SAMPLES = 1.5  # and in samples: a device answers within one


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

    It answers within one controller sample, in the order in which it was asked. So behind every question goes one that
    is always answered, by CHALLENGE: when that has come, nothing more is to be waited for.

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
        self._codec, self._ask = Codec(node), restart
        self._tokens: set[int] = set()
        self._waiting: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        """Put it on the bus."""
        if message.arbitration_id & 31 == READ and len(message.data) > 1:
            self._tokens.add(message.data[1] % CHALLENGE_TAG)
        self._link.send(message)

    def heard(self) -> list[can.Message]:
        """What comes until all that was sent is answered."""
        token = next(token for token in range(CHALLENGE_TAG) if token not in self._tokens)
        self._tokens.clear()
        self._link.send(self._codec.encode(Read(Page.CHALLENGE, token)))
        self._listen(self._clock.now_s() + max(SAMPLES * self._sample_s, LEAST_S), lambda m: self._is_last(m, token))
        messages, self._waiting = self._waiting, []
        return [message for message in messages if not self._is_last(message, token)]

    def _is_last(self, message: can.Message, token: int) -> bool:
        """Whether it is the answer to the question behind all others."""
        frame = self._codec.decode(message)
        return not isinstance(frame, Refused) and isinstance(frame, Challenge) and frame.token == token

    def sample(self) -> list[can.Message]:
        """What comes until a whole sample has come."""
        patience_s = self._clock.now_s() + 4 * self._sample_s + 1.0
        self._listen(patience_s, lambda m: m.arbitration_id & 31 == TELEMETRY_SP)
        messages, self._waiting = self._waiting, []
        return messages

    def restart(self) -> bool:
        """Ask for it; what was heard of the time before is forgotten."""
        done = self._ask()
        self._link.receive_all()
        self._waiting = []
        return done

    def _listen(self, until_s: float, last: Callable[[can.Message], bool]) -> None:
        """Take the node's frames until one is the last, or the time is over."""
        ended = False
        while not ended and self._clock.now_s() < until_s:
            self._link.wait_until(min(until_s, self._clock.now_s() + LOOK_S))
            for message in self._link.receive_all():
                if message.arbitration_id >> COMMAND_BITS == self._node and not message.is_extended_id:
                    self._waiting.append(message)
                    ended = ended or last(message)
