"""One open bus for all the loops on it: frames are read once and handed to the node that they belong to.

A bus per loop would make every loop read every other loop's frames: with n loops n times the work. Up to 63 nodes can
share a link; each gets a port, which is all that a CanDevice needs of a link.
"""

from collections import deque

import can

from retuner.drivers.bus.bus import CanLink
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.device import LinkState
from retuner.drivers.protocol.codec import COMMAND_BITS
from retuner.drivers.protocol.frames import HIGHEST_NODE

WAITING_MAX = 10_000
"""Frames kept for a port that is not polled, about a second of a full 1 Mbit/s bus; the oldest fall out and are counted
as dropped, and the samples among them show as a gap."""


class LinkShare:
    """Hands the frames of one link to ports.

    Parameters
    ----------
    link : open bus; nobody else may read from it.
    """

    def __init__(self, link: CanLink) -> None:
        self.link = link
        self.unclaimed = 0  # frames to nodes without a port: other traffic on the bus
        self._ports: dict[int, LinkPort] = {}
        self._whole: list[LinkPort] = []

    def port(self, node: int) -> "LinkPort":
        """The port of a node, made at the first call.

        Raises
        ------
        ValueError
            No such node.
        """
        if not 1 <= node <= HIGHEST_NODE:
            raise ValueError(f"node = {node}; give a node from 1 to {HIGHEST_NODE}")
        return self._ports.setdefault(node, LinkPort(self))

    def whole(self) -> "LinkPort":
        """A port that is given every frame: for a controller whose identifiers are not ours to know."""
        self._whole.append(LinkPort(self))
        return self._whole[-1]

    def pump(self) -> None:
        """Take what has arrived and sort it."""
        ports = self._ports
        for message in self.link.receive_all():
            for whole in self._whole:
                whole.give(message)
            port = ports.get(message.arbitration_id >> COMMAND_BITS)
            if port is None:
                self.unclaimed += 1
            else:
                port.give(message)


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
        return self._share.link.send(message)

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
        self._share.pump()
        waiting = self._waiting
        if len(waiting) > limit:
            return [waiting.popleft() for _ in range(limit)]
        self._waiting = deque()
        return list(waiting)
