"""One open bus for all the loops on it: frames are read once and handed to the node that they belong to.

    bus -> link -> share -> ports -> poll of each loop
           |
           `-> lease of each controller, when a third of it is over (lease_and_commands.py)

A bus per loop would make every loop read every other loop's frames: with n loops n times the work. Up to 63 nodes can
share a link; each gets a port, which is all that a CanDevice needs of a link. A port reads the link when it is asked,
unless a thread does it; both hold the lock while they use the link. With the thread, whatever keeps the loops busy (a
disk that is slow to flush, a terminal that does not scroll), no frame has to wait in the system's queue until that is
full, and the leases of the controllers are prolonged by the clock of the link.
"""

import threading
from collections import deque
from collections.abc import Callable
from types import TracebackType

import can

from retuner.drivers.bus.bus import CanLink, FaultNews
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.clock import Clock
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


LeaseTimer = Callable[[float], None]  # told the time; sends what keeps a lease, when it is time
TIMER_PAUSES = 8
"""Pauses between two looks at the leases: a lease lasts for 30 samples or more, a pause for a quarter of one."""
END_S = 5.0  # how long the thread may take to end, s of the machine's time


class LinkReader:
    """Reads a shared link as long as its block lasts.

    share : the link's; its ports no longer read themselves. clock : the link's.
    pause_s : how long frames may gather before they are taken together, s of the clock.
    came : set whenever frames have come.
    """

    def __init__(self, share: LinkShare, clock: Clock, pause_s: float, came: threading.Event) -> None:
        self._share, self._clock, self._pause_s, self._came = share, clock, pause_s, came
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bus", daemon=True)
        self._timers_s = float("-inf")
        self.timers: list[LeaseTimer] = []
        self.defect: BaseException | None = None
        """Why the thread has ended by itself; the ports read for themselves again then."""

    def __enter__(self) -> "LinkReader":
        self._share.read_by_thread = True
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join(END_S)
        self._share.read_by_thread = False

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                # Wait for frames, or for the time to look after the leases; take all that are there
                clock, link = self._clock, self._share.link
                link.wait_until(clock.now_s() + 4 * self._pause_s)
                with self._share.lock:
                    frames = self._share.pump()
                now_s = clock.now_s()
                if now_s >= self._timers_s:
                    self._timers_s = now_s + TIMER_PAUSES * self._pause_s
                    for timer in self.timers:
                        timer(now_s)
                if frames:
                    self._came.set()
                self._ending.wait(clock.left_s(now_s + self._pause_s))
        except BaseException as defect:  # noqa: BLE001  told to the session, which ends with it
            self.defect = defect
            self._share.read_by_thread = False
            self._came.set()
