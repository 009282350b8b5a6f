"""What a host needs of a link, how a link is opened and when it is doubted, and what it counts."""

from collections.abc import Mapping
from typing import Any, Protocol

import can

from retuner.drivers.device import LinkState
from retuner.schedule.late_dataclass import dataclass, field


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """How to open a bus and when to doubt it.

    interface, channel : as python-can spells them.
    hop_limit : routers that a udp_multicast frame may pass; 0 keeps it on this machine.
    options : further keyword arguments of python-can's Bus (bitrate, fd, ...).
    silent_after_s : age of the last frame after which the link counts as silent, s.
    reopen_first_s, reopen_max_s : first and longest pause between attempts to open the bus anew, s.
    garbage_limit : undecodable datagrams in one go after which the bus is opened anew.
    log_bytes_max : most bytes of a log of the frames, if there is one; then its oldest half goes. Infinite: all stay.

    Raises ValueError: a time or log_bytes_max is not positive, or hop_limit is outside 0..255.
    """

    interface: str = "virtual"
    channel: str = "retuner"
    hop_limit: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    silent_after_s: float = 10.0
    reopen_first_s: float = 0.2
    reopen_max_s: float = 5.0
    garbage_limit: int = 1000
    log_bytes_max: float = float("inf")

    def __post_init__(self) -> None:
        for name in ("silent_after_s", "reopen_first_s", "reopen_max_s"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"bus: {name} = {getattr(self, name)}; give a positive number of seconds")
        if not 0 <= self.hop_limit <= 255:
            raise ValueError(f"bus: hop_limit = {self.hop_limit}; give 0 (this machine only) to 255")
        if not self.log_bytes_max > 0:
            raise ValueError(f"bus: log_bytes_max = {self.log_bytes_max}; give a positive number of bytes")


@dataclass(slots=True)
class LinkCounters:
    """What the link has seen since it was made."""

    sent: int = 0
    send_failures: int = 0
    received: int = 0
    echoes: int = 0
    error_frames: int = 0
    garbage: int = 0
    opened: int = 0
    overflows: int = 0


class FramePort(Protocol):
    """Where one controller's host sends and receives: a whole link (bus.py) or a node's port (shared_link.py)."""

    @property
    def settings(self) -> LinkSettings:
        """How the bus was opened."""

    @property
    def state(self) -> LinkState:
        """Whether the bus is open, and heard."""

    def send(self, message: can.Message) -> bool:
        """Send a frame; False when the bus did not take it. Never raises."""

    def receive_all(self) -> list[can.Message]:
        """All frames that have arrived, oldest first. Never raises."""

    def note(self, message: can.Message) -> None:
        """Put a frame into the log, if there is one, and on no bus. Never raises."""
