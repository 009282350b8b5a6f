"""One session: the loops that it watches, what they share, and who looks on.

    bus, bus -> port of each loop -> LoopSession -> rows -> one ledger
                                        |  ^
                                   questions, answers: one set of workers

A session is driven by `poll(now_s)` and never waits. Each loop goes its own way (loop_session.py): one that ends, or
whose controller was never there, does not hold the others up; a ledger that fails ends all of them.
"""

from collections.abc import Callable, Collection, Mapping, Sequence

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.device import DeviceError
from retuner.errors import LedgerError
from retuner.ledger import Recorder
from retuner.session.loop_session import LoopSession

PROVING_SAMPLES = 30  # within which a set that has been written is confirmed


class Observer:
    """Looks on at a session. It is told of everything just after it happened, and asked for nothing.

    What it does is done in the middle of the loops' time: it must neither wait nor raise. All that it is given is to be
    read, not to be changed. This one does nothing.
    """

    def sampled(self, loop: LoopSession, sample: LoopSample) -> None:
        """The loop has taken a sample: see its `retuner`, `device.running`, `machine.phase`, `writer`."""

    def recorded(self, loop: LoopSession | None, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """A row stands in the ledger. A decision is the newest of `loop.decisions`; loop : None before it has begun."""

    def said(self, text: str) -> None:
        """A line for whoever runs the session."""


class LoopRecorder:
    """Keeps the rows of one loop: each with its place in the order of samples, and with the loop's name where there
    are several.

    keep : the ledger. name : of the loop, empty where it is the only one. observer : is told of each row.
    failed : is told, once there is a session, why the ledger takes no more rows.
    """

    def __init__(self, keep: Recorder, name: str, observer: Observer, failed: Callable[[str], None]) -> None:
        self._keep, self._observer, self._failed = keep, observer, failed
        self._named = {"loop": name} if name else {}
        self.loop: LoopSession | None = None

    def __call__(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """Record a row: see Recorder. A ledger that fails is an alarm; the controller goes on with what it runs.

        Raises LedgerError: it fails before there is a session.
        """
        samples = self.loop.samples if self.loop is not None else 0
        try:
            self._keep(kind, t_s, {**body, **self._named, "samples": samples})
        except LedgerError as error:
            if self.loop is None:
                raise
            self._failed(str(error))
            return
        self._observer.recorded(self.loop, kind, t_s, body)


class Session:
    """See the head of this file.

    loops : one or more. say : is told a line when a loop is left out.
    """

    def __init__(self, loops: Sequence[LoopSession], say: Callable[[str], None]) -> None:
        self.loops = tuple(loops)
        self.absent: dict[str, str] = {}
        """Loops whose controller was never there, by name, with the reason."""
        self._say = say
        self._watched = list(self.loops)
        self._polled_s = dict.fromkeys(range(len(self.loops)), float("-inf"))
        self._writing: dict[int, int] = {}  # samples of a loop when it last was in the middle of a write

    @property
    def finished(self) -> bool:
        """Whether every loop's end has come."""
        return all(loop.finished for loop in self._watched)

    @property
    def seen(self) -> bool:
        """Whether a sample has come, of any loop."""
        return any(loop.seen for loop in self.loops)

    @property
    def frozen(self) -> str:
        """Why rows cannot be recorded any more; empty while they can."""
        return next((loop.frozen for loop in self.loops if loop.frozen), "")

    @property
    def left_open(self) -> str:
        """What could not be brought to its end, in a sentence; empty when all was."""
        open_ = [loop for loop in self.loops if loop.left_open]
        if len(self.loops) == 1 or not open_:
            return open_[0].left_open if open_ else ""
        return "; ".join(f"{loop.name}: {loop.left_open}" for loop in open_)

    @property
    def t_s(self) -> float:
        """Time of the newest sample, s."""
        return max(loop.writer.t_s for loop in self.loops)

    def poll(self, now_s: float, heard: Collection[int] | None = None, clock: Callable[[], float] | None = None) -> int:
        """Take what the devices have to tell; returns the number of samples among it.

        heard : indexes of the loops for which frames have come, None where that is not known; the others are looked
        after once in a sample time. clock : tells the time as this goes on: loops in the middle of a write are then
        looked after once in a sample time between the others too, for half of the time at the most. On a busy machine
        one look at many loops takes seconds, and a set that is not confirmed within the controller's trial time gives
        way.

        Raises DeviceError: before the first connection: nobody answers for any loop, or the wrong controller does.
        """
        samples, between_s = 0, 0.0
        for i, loop in enumerate(self.loops):
            quiet = heard is not None and i not in heard
            if quiet and now_s - self._polled_s[i] < loop.retuner.settings.sample_time_s:
                continue
            samples += self._poll(i, max(now_s, self._polled_s[i]))
            if clock is None:
                continue
            for j in sorted(self._writing, key=self._polled_s.__getitem__):
                later_s = clock()
                if 2.0 * between_s > later_s - now_s:
                    break
                if later_s - self._polled_s[j] >= self.loops[j].retuner.settings.sample_time_s:
                    samples += self._poll(j, later_s)
                    between_s += clock() - later_s
        return samples

    def _poll(self, i: int, now_s: float) -> int:
        loop, samples = self.loops[i], 0
        if len(self.loops) > 1 and (loop.name in self.absent or loop.finished):
            self._writing.pop(i, None)
            return 0
        self._polled_s[i] = now_s
        try:
            samples = loop.poll(now_s)
        except DeviceError as error:
            if len(self._watched) == 1:
                raise
            self._watched.remove(loop)
            self.absent[loop.name] = str(error)
            loop.tell_absent(str(error))
            self._say(f"{loop.name}: {error}; the other loops go on without it")
        if loop.device.writing:
            self._writing[i] = loop.samples
        elif i in self._writing and loop.samples - self._writing[i] >= PROVING_SAMPLES:
            del self._writing[i]
        if len(self.loops) > 1 and loop.finished:
            loop.device.release(now_s)
        return samples

    def stop(self, reason: str) -> None:
        """Come to an end: undecided changes are settled, and `finished` says when that is done."""
        for loop in self._watched:
            loop.stop(reason)

    def fail(self, reason: str) -> None:
        """Come to an end after a defect: no sample is looked at any more, and the verified sets come back."""
        for loop in self._watched:
            loop.fail(reason)

    def freeze(self, reason: str) -> None:
        """Begin no write any more in any loop: what cannot be recorded must not be done, but the way back."""
        if not self.frozen:
            self._say(f"{reason}; nothing more is changed, and the run ends")
        for loop in self.loops:
            loop.freeze(reason)

    def tell_what_is_open(self) -> None:
        """Record of each loop that it ends without knowing that the verified set runs, if it is so."""
        for loop in self._watched:
            loop.tell_what_is_open()

    def release(self, now_s: float) -> None:
        """Let other hosts command at once: for the end of the session."""
        for loop in self._watched:
            loop.device.release(now_s)
