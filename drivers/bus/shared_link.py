"""One open bus for all the loops on it: frames are read once and handed to the node that they belong to.

A bus per loop would make every loop read every other loop's frames: with n loops n times the work. Up to 63 nodes can
share a link; each gets a port, which is all that a CanDevice needs of a link. A port reads the link when it is asked,
unless a thread does it (link_reader.py); both hold the lock while they use the link.
"""

import threading
from collections import deque

import can

from retuner.drivers.bus.bus import CanLink, FaultNews
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.device import LinkState
from retuner.drivers.protocol.codec import COMMAND_BITS
from retuner.drivers.protocol.frames import HIGHEST_NODE

WAITING_MAX = 10_000
"""Frames kept for a port that is not polled, about a second of a full 1 Mbit/s bus; the oldest fall out and are counted
as dropped, and the samples among them show as a gap."""


class LinkShare:
    """Hands the frames of one link to ports.

    link : open bus; nobody else may read from it.
    """

    def __init__(self, link: CanLink) -> None:
        self.link = link
        self.lock = threading.RLock()
        self.read_by_thread = False
        self.unclaimed = 0  # frames to nodes without a port: other traffic on the bus
        self._ports: dict[int, LinkPort] = {}
        self._whole: list[LinkPort] = []

    def port(self, node: int) -> "LinkPort":
        """The port of a node, made at the first call. Raises ValueError: no such node."""
        if not 1 <= node <= HIGHEST_NODE:
            raise ValueError(f"node = {node}; give a node from 1 to {HIGHEST_NODE}")
        return self._ports.setdefault(node, LinkPort(self))

    def whole(self) -> "LinkPort":
        """A port that is given every frame: for a controller whose identifiers are not ours to know."""
        self._whole.append(LinkPort(self))
        return self._whole[-1]

    def news(self) -> list[FaultNews]:
        """See CanLink."""
        with self.lock:
            return self.link.news()

    def pump(self) -> int:
        """Take what has arrived and sort it; how many frames."""
        ports = self._ports
        messages = self.link.receive_all()
        for message in messages:
            for whole in self._whole:
                whole.give(message)
            port = ports.get(message.arbitration_id >> COMMAND_BITS)
            if port is None:
                self.unclaimed += 1
            else:
                port.give(message)
        return len(messages)


class LinkPort:
    """What one node's host sees of a shared link: see CanLink for what its methods promise."""

    def __init__(self, share: LinkShare) -> None:
        self._share = share
        self._waiting: deque[can.Message] = deque()
        self.dropped = 0

    @property
    def settings(self) -> LinkSettings:
        """How the bus was opened."""
        return self._share.link.settings

    @property
    def state(self) -> LinkState:
        """State of the shared bus; whether this node is heard is for its host to judge."""
        return self._share.link.state

    def send(self, message: can.Message) -> bool:
        """Send a frame; False when the bus did not take it."""
        with self._share.lock:
            return self._share.link.send(message)

    def note(self, message: can.Message) -> None:
        """Put a frame into the log of the shared bus, and on no bus."""
        with self._share.lock:
            self._share.link.note(message)

    @property
    def waiting(self) -> bool:
        """Whether frames have come for this node that nobody has taken yet."""
        return bool(self._waiting)

    def expect_silence(self) -> None:
        """See CanLink; it holds for the whole shared link."""
        self._share.link.expect_silence()

    def wait_until(self, t_s: float) -> None:
        """Return when a frame may be there, for whichever port, or the clock has reached t_s."""
        self._share.link.wait_until(t_s)

    def give(self, message: can.Message) -> None:
        """A frame for this node."""
        if len(self._waiting) >= WAITING_MAX:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append(message)

    def receive_all(self, limit: int = WAITING_MAX) -> list[can.Message]:
        """The node's frames that have arrived, oldest first, at most limit."""
        with self._share.lock:
            if not self._share.read_by_thread or not self._waiting:  # a process that was held up: what came meanwhile
                self._share.pump()  # may still be where the thread has not been yet, and is no silence
            waiting = self._waiting
            if len(waiting) > limit:
                return [waiting.popleft() for _ in range(limit)]
            self._waiting = deque()
        return list(waiting)
