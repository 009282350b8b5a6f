"""Being stopped from outside: SIGTERM, or a terminal that goes away, ends a run as Ctrl-C does, with everything whole.

Between two polls of a session, that is: a row of the ledger and what it tells of belong together. What a run leaves
behind is written without interruption as well: a second, impatient Ctrl-C waits for it.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

STOPS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that stop a run beside SIGINT; Windows has no SIGHUP."""


@contextmanager
def stoppable() -> Iterator[None]:
    """Inside, the signals of STOPS raise KeyboardInterrupt; the old handlers come back afterwards."""

    def stop(number: int, frame: FrameType | None) -> None:
        del number, frame
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in STOPS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def unstoppable() -> Iterator[None]:
    """Inside, SIGINT and STOPS wait; if one came, KeyboardInterrupt is raised at the end. Only the main thread hears
    signals; in another one this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        del frame
        came.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, *STOPS)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        raise KeyboardInterrupt
