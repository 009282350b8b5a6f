"""Datagrams at the door of a udp_multicast link: python-can unpacks whatever any process sends to its port."""

import random
from collections import deque

import can
import msgpack
from can.interfaces.udp_multicast.utils import unpack_message
from mutants import mutant

from retuner.drivers.bus import bus
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.bus.shared_link import LinkShare
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.protocol.codec import Codec

NODE = 5
ODD = (0.5, -1, -0.5, 1e300, float("nan"), float("inf"), True, None, "abc", b"\x00", [], {}, [1, 2], 1 << 40, "", 178.0)
GOOD = {
    "timestamp": 0.0,
    "arbitration_id": NODE << 5 | 16,
    "is_extended_id": False,
    "is_remote_frame": False,
    "is_error_frame": False,
    "channel": None,
    "dlc": 8,
    "data": bytes(8),
    "is_fd": False,
    "bitrate_switch": False,
    "error_state_indicator": False,
}
FIELDS = (*GOOD, "check", "nonsense")


class DatagramBus:
    """python-can's bus from the datagram on."""

    def __init__(self) -> None:
        self.datagrams: deque[bytes] = deque()

    def recv(self, timeout: float) -> can.Message | None:
        """As UdpMulticastBus does it."""
        del timeout
        if not self.datagrams:
            return None
        try:
            return unpack_message(self.datagrams.popleft(), replace={"timestamp": 0.0}, check=True)
        except Exception as error:
            raise can.CanOperationError("could not unpack received message") from error

    def fileno(self) -> int:
        """None."""
        return -1

    def shutdown(self) -> None:
        """Nothing to close."""


def hostile(rng: random.Random) -> bytes:
    """A datagram that is odd in one way or two."""
    good: dict[str, object] = {**GOOD}
    if rng.random() < 0.7:
        for _ in range(rng.choice((1, 1, 2))):
            good[rng.choice(FIELDS)] = rng.choice(ODD)
        return msgpack.packb(good)
    return mutant(msgpack.packb(good), rng)


class Door:
    """A shared link on such a bus, and a host's decoder behind it."""

    def __init__(self) -> None:
        self.bus = DatagramBus()
        self._open, bus.open_bus = bus.open_bus, lambda *_: self.bus
        self.link = CanLink(LinkSettings(interface="udp_multicast", garbage_limit=10**9), SimulatedClock())
        bus.open_bus = self._open
        self.share = LinkShare(self.link)
        self.port, self.codec = self.share.port(NODE), Codec(NODE)

    def knock(self, datagram: bytes) -> str:
        """What became of it."""
        self.bus.datagrams.append(datagram)
        before = self.link.counters.garbage + self.link.counters.error_frames
        for message in self.port.receive_all():
            self.codec.decode(message)
            return "a message"
        dropped = self.link.counters.garbage + self.link.counters.error_frames > before
        return "dropped" if dropped else "another node's"
