"""Being stopped from outside: SIGTERM, or a terminal that goes away, ends a run as Ctrl-C does, with everything whole.

Between two polls of a session, that is: a row of the ledger and what it tells of belong together. What a run leaves
behind is written without interruption as well: a second, impatient Ctrl-C waits for it.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import FrameType

STOPS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that stop a run beside SIGINT; Windows has no SIGHUP."""


class _StopSignals:
    """Hears SIGINT and STOPS while it listens; what comes while it waits is raised when the wait is over.

    Handlers are put in once for a session and not at each of its polls: that took a twentieth of a simulated run.
    """

    def __init__(self) -> None:
        self.listening = False
        self.waiting = 0
        self.came = False

    def hear(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        if not self.waiting:
            raise KeyboardInterrupt
        self.came = True

    @contextmanager
    def listen(self) -> Iterator[None]:
        """Inside, signals are heard; the old handlers come back afterwards."""
        if self.listening:
            yield
            return
        before = {number: signal.signal(number, self.hear) for number in (signal.SIGINT, *STOPS)}
        self.listening = True
        try:
            yield
        finally:
            self.listening = False
            for number, handler in before.items():
                signal.signal(number, handler)

    def __enter__(self) -> None:
        """Inside, signals wait; if one came, KeyboardInterrupt is raised at the end of the outermost wait."""
        self.waiting += 1

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.waiting -= 1
        if not self.waiting:
            came, self.came = self.came, False
            if came and kind is None:
                raise KeyboardInterrupt


_SIGNALS = _StopSignals()


def stoppable() -> AbstractContextManager[None]:
    """Inside, the signals of STOPS raise KeyboardInterrupt as SIGINT does; the old handlers come back afterwards."""
    return _SIGNALS.listen()


def unstoppable() -> AbstractContextManager[None]:
    """Inside, SIGINT and STOPS wait; if one came, KeyboardInterrupt is raised at the end. Only the main thread hears
    signals; in another one this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        return nullcontext()
    return _SIGNALS if _SIGNALS.listening else _heard()


@contextmanager
def _heard() -> Iterator[None]:
    with _SIGNALS.listen(), _SIGNALS:
        yield
