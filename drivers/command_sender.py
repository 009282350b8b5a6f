"""Setpoint, mode, load and store: single-frame commands, repeated until the device has acknowledged them.

The latest command of a kind counts. A repeated frame carries the same counter, so the device acts on it once.
"""

from collections.abc import Callable
from dataclasses import dataclass

from retuner.drivers.device import CommandDone, CommandFailed
from retuner.drivers.frames import Ack, Frame, Kind, Reason, reason_text

COUNTER_WRAP = 256
TRIES = 10


@dataclass(slots=True)
class _Waiting:
    """A command that is not acknowledged yet; make builds its frame for a counter."""

    make: Callable[[int], Frame]
    counter: int
    tries: int = 0
    next_s: float = float("-inf")


class CommandSender:
    """Commands under way, at most one of each kind.

    Parameters
    ----------
    timeout_s : how long to wait for an acknowledge, s.
    """

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._counters: dict[Kind, int] = {}
        self._waiting: dict[Kind, _Waiting] = {}

    def put(self, kind: Kind, make: Callable[[int], Frame], number: int | None = None) -> None:
        """Send a command from the next `due` on; number takes the counter's place in its acknowledge."""
        if number is None:
            number = self._counters[kind] = (self._counters.get(kind, 0) + 1) % COUNTER_WRAP
        self._waiting[kind] = _Waiting(make, number)

    def due(self, now_s: float) -> tuple[list[Frame], list[CommandFailed]]:
        """Frames to send now, and the commands that nobody has answered."""
        frames: list[Frame] = []
        failed: list[CommandFailed] = []
        for kind, waiting in list(self._waiting.items()):
            if now_s < waiting.next_s:
                continue
            if waiting.tries >= TRIES:
                del self._waiting[kind]
                failed.append(CommandFailed(kind.name.lower(), f"no answer to {TRIES} frames"))
                continue
            waiting.tries += 1
            waiting.next_s = now_s + self._timeout_s
            frames.append(waiting.make(waiting.counter))
        return frames, failed

    def on_ack(self, ack: Ack) -> CommandDone | CommandFailed | None:
        """An acknowledge has come; what it means, if it is for a command that waits."""
        kind = next((kind for kind in self._waiting if kind == ack.kind), None)
        if kind is None or ack.seq != self._waiting[kind].counter:
            return None
        waiting = self._waiting[kind]
        if ack.reason == Reason.STALE and kind is not Kind.STORE:  # another host has counted further: go on from there
            self._counters[kind] = (ack.latest + 1) % COUNTER_WRAP
            self._waiting[kind] = _Waiting(waiting.make, self._counters[kind], waiting.tries)
            return None
        del self._waiting[kind]
        if ack.reason == Reason.OK:
            return CommandDone(kind.name.lower())
        return CommandFailed(kind.name.lower(), f"the device refused it: {reason_text(ack)}")
