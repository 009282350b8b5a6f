"""Setpoint, mode, load, store and confirm: single-frame commands, repeated until the device has acknowledged them.

The latest command of a kind counts. A repeated frame carries the same counter, so the device acts on it once.
"""

from collections.abc import Callable
from dataclasses import dataclass

from retuner.adaptive.sample import LoopMode
from retuner.drivers.device import CommandDone, CommandFailed
from retuner.drivers.frames import (
    STORE_TAG,
    Ack,
    Confirm,
    Frame,
    Kind,
    Load,
    Mode,
    Reason,
    Setpoint,
    Store,
    reason_text,
)

COUNTER_WRAP = 256
TRIES = 10
BY_SEQUENCE = (Kind.STORE, Kind.CONFIRM)  # acknowledged by the set's number, not by a counter


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
    owner : this host's number in the lease.
    check : raises when a frame cannot be sent.
    """

    def __init__(self, timeout_s: float, owner: int, check: Callable[[Frame], object]) -> None:
        self._timeout_s, self._owner, self._check = timeout_s, owner, check
        self._counters: dict[Kind, int] = {}
        self._waiting: dict[Kind, _Waiting] = {}

    def setpoint(self, sp: float) -> None:
        """Set the target, pv unit."""
        self._put(Kind.SETPOINT, lambda counter: Setpoint(counter, sp, self._owner))

    def mode(self, *, auto: bool, co: float) -> None:
        """Auto, or manual with co percent."""
        mode = LoopMode.AUTO if auto else LoopMode.MANUAL
        self._put(Kind.MODE, lambda counter: Mode(counter, mode, co, self._owner))

    def load(self, load: float) -> None:
        """Disturb a simulated plant, percent of co."""
        self._put(Kind.LOAD, lambda counter: Load(counter, load, self._owner))

    def store(self, seq: int) -> None:
        """Keep set seq over a restart."""
        self._put(Kind.STORE, lambda _: Store(seq, self._owner % STORE_TAG), seq)

    def confirm(self, seq: int) -> None:
        """Set seq has proved itself."""
        self._put(Kind.CONFIRM, lambda _: Confirm(seq, self._owner), seq)

    def waits(self, kind: Kind) -> bool:
        """Whether a command of this kind is not acknowledged yet."""
        return kind in self._waiting

    def _put(self, kind: Kind, make: Callable[[int], Frame], number: int | None = None) -> None:
        """Send a command from the next `due` on; number takes the counter's place in its acknowledge."""
        self._check(make(0))
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
        if ack.reason == Reason.NOT_OWNER and waiting.tries < TRIES:  # the lease may be on its way: try on
            return None
        if ack.reason == Reason.STALE and kind not in BY_SEQUENCE:  # another host has counted further: go on from there
            self._counters[kind] = (ack.latest + 1) % COUNTER_WRAP
            self._waiting[kind] = _Waiting(waiting.make, self._counters[kind], waiting.tries)
            return None
        del self._waiting[kind]
        if ack.reason == Reason.OK:
            return CommandDone(kind.name.lower())
        return CommandFailed(kind.name.lower(), f"the device refused it: {reason_text(ack)}")
