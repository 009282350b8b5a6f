"""Reads a bus in a thread of its own: whatever keeps the loops busy (a disk that is slow to flush, a terminal that
does not scroll), no frame has to wait in the system's queue until that is full, and the leases of the controllers are
prolonged by the clock of the link.

    bus -> this thread -> ports (shared_link.py) -> poll of each loop
             |
             `-> lease of each controller, when a third of it is over (lease_and_commands.py)
"""

import threading
from collections.abc import Callable
from types import TracebackType

from retuner.drivers.bus.shared_link import LinkShare
from retuner.drivers.clock import Clock

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
