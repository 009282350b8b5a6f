"""The machine's time for threads that run against it: it passes only while all of them sleep, so that no load shows."""

import math
import threading
import time

import pytest

STUCK_S = 60.0  # Of real time that a thread is waited for; more means that it hangs or has ended without leaving


class SharedTime:
    """Stands in for the module time in retuner.drivers.clock.

    Parameters
    ----------
    threads : how many live by it; each that ends must leave.
    """

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._now_s = 1000.0
        self._wake_s: list[float] = []
        self._changed = threading.Condition()

    def govern(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """All clocks made from now on go by it."""
        monkeypatch.setattr("retuner.drivers.clock.time", self)

    def monotonic(self) -> float:
        return self._now_s

    def time(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Until the others sleep as well and this is the first to wake."""
        with self._changed:
            wake_s = max(self._now_s + seconds, math.nextafter(self._now_s, math.inf))
            self._wake_s.append(wake_s)
            self._pass()
            given_up_s = time.monotonic() + STUCK_S
            while self._now_s < wake_s:
                self._changed.wait(1.0)
                assert time.monotonic() < given_up_s, "another thread neither sleeps nor has left"
            self._wake_s.remove(wake_s)

    def leave(self) -> None:
        """A thread will not sleep any more."""
        with self._changed:
            self._threads -= 1
            self._pass()

    def _pass(self) -> None:
        """Let time pass to the first that wakes when all sleep."""
        if self._wake_s and len(self._wake_s) >= self._threads:
            self._now_s = max(self._now_s, min(self._wake_s))
            self._changed.notify_all()
