"""The simulated bus: every frame goes to every other node, and on each way something may happen to it."""

from collections import deque
from heapq import heappop, heappush
from itertools import count
from random import Random

import can

from bus_simulation.weather import CALM, FAULTS, Fault, Weather

HISTORY = 256  # frames that a repeater may send again
STRANGER = "intruder"  # may send, and receives nothing
LONGEST_DELAYS = (4, 4, 12, 40)  # steps, one of them for each late frame


class Way:
    """What is on its way to one node."""

    __slots__ = ("cut", "inbox", "late", "name")

    def __init__(self, name: str) -> None:
        self.name = name
        self.inbox: list[can.Message] = []
        self.late: list[tuple[int, int, can.Message]] = []
        self.cut = False

    def take(self) -> list[can.Message]:
        """All that has arrived."""
        messages, self.inbox = self.inbox, []
        return messages


class Bus:
    """Ways to all nodes, and the weather.

    rng : decides everything.
    names : of the nodes.
    """

    def __init__(self, rng: Random, names: tuple[str, ...]) -> None:
        self._rng, self._random = rng, rng.random
        self.ways = {name: Way(name) for name in names}
        self._others = {
            sender: [way for name, way in self.ways.items() if name != sender] for sender in (*names, STRANGER)
        }
        self._number = count()
        self.weather: Weather = CALM
        self.step = 0
        self.history: deque[can.Message] = deque(maxlen=HISTORY)
        self.faults = 0

    def tick(self, step: int) -> None:
        """Time goes on: what was late arrives."""
        self.step = step
        for way in self.ways.values():
            while way.late and way.late[0][0] <= step:
                way.inbox.append(heappop(way.late)[2])

    def send(self, sender: str, message: can.Message) -> None:
        """From one node to all others."""
        rate = self.weather.frame_fault
        if not rate:
            for way in self._others[sender]:
                way.inbox.append(message)
            return
        self.history.append(message)
        for way in self._others[sender]:
            if way.cut:
                self.faults += 1
            elif self._random() >= rate:
                way.inbox.append(message)
            else:
                self.faults += 1
                rng = self._rng
                fault = rng.choices(FAULTS, self.weather.weights)[0]
                if fault is Fault.DELAY:
                    self._delay(way, message)
                elif fault is Fault.REORDERING:
                    way.inbox.insert(rng.randrange(len(way.inbox) + 1), message)
                elif fault in {Fault.DUPLICATION, Fault.REPLAY}:
                    self._delay(way, message if fault is Fault.DUPLICATION else rng.choice(self.history))
                    way.inbox.append(message)
                elif fault is not Fault.LOSS:
                    way.inbox.append(damaged(rng, fault, message))

    def deliver(self, sender: str, message: can.Message) -> None:
        """The same, and nothing happens to it on the way: one thing is wrong with it already, and must stay so."""
        for way in self._others[sender]:
            way.inbox.append(message)

    def clear(self) -> None:
        """Calm from now on: nothing is on its way any more."""
        for way in self.ways.values():
            way.cut = False
            for _, _, message in sorted(way.late, key=lambda entry: entry[:2]):
                way.inbox.append(message)
            way.late.clear()

    def _delay(self, way: Way, message: can.Message) -> None:
        """Let a frame arrive later."""
        late = self._rng.randrange(1, self._rng.choice(LONGEST_DELAYS))
        heappush(way.late, (self.step + late, next(self._number), message))


def damaged(rng: Random, fault: Fault, message: can.Message) -> can.Message:
    """A copy with wrong bits, random bytes, or fewer of them."""
    data = bytearray(message.data)
    if fault is Fault.CORRUPTION and data:
        for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif fault is Fault.GARBLING:
        start = rng.randrange(len(data) + 1)
        data[start:] = rng.randbytes(len(data) - start)
    elif fault is Fault.TRUNCATION:
        data = data[: rng.randrange(len(data) + 1)]
    return can.Message(arbitration_id=message.arbitration_id, is_extended_id=False, data=data)
