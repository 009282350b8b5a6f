"""The write of a gain set to a controller that knows no staging: message by message, each proved before the next.

    IDLE -> WRITING -> CHECKING -> WRITING ... -> IDLE        the good way: acknowledged, and read back right
    any trouble -> UNDOING -> READING -> IDLE                 the old numbers are written, and what runs is read

A message is written again, a few times, when it is not acknowledged or not read back right: the same numbers twice do
no harm. Then those that were begun are taken back. Whatever was written, the outcome is what is read at the end; as
long as nobody answers, READING goes on asking. Without read-back each message is sent several times and believed.
"""

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import NamedTuple

from retuner.drivers.state_machine import StateMachine

Numbers = Mapping[str, float]


class CoursePhase(Enum):
    """Where a write stands."""

    IDLE = "nothing to write"
    WRITING = "a message is being written"
    CHECKING = "what was written is being read back"
    UNDOING = "the old numbers are being written"
    READING = "what runs is being read"


class CourseInput(Enum):
    """What can happen to it."""

    BEGIN = "begin"
    TAKEN = "the message was taken"
    NEXT = "read back right, another message follows"
    LAST = "read back right, and it was the last one"
    AGAIN = "no answer, or read back wrong; another try is left"
    EXHAUSTED = "no try is left"
    REFUSED = "refused by the controller"
    RESTARTED = "the controller restarted"
    LEFT = "nothing is heard of it any more, or two answer: it is left as it is"
    READ = "what runs was read"


P, C = CoursePhase, CourseInput
COURSE: dict[tuple[CoursePhase, CourseInput], CoursePhase] = {
    (P.IDLE, C.BEGIN): P.WRITING,
    (P.WRITING, C.TAKEN): P.CHECKING,
    (P.WRITING, C.AGAIN): P.WRITING,
    (P.WRITING, C.EXHAUSTED): P.UNDOING,
    (P.WRITING, C.REFUSED): P.UNDOING,
    (P.WRITING, C.RESTARTED): P.READING,
    (P.WRITING, C.LEFT): P.READING,
    (P.CHECKING, C.NEXT): P.WRITING,
    (P.CHECKING, C.LAST): P.IDLE,
    (P.CHECKING, C.AGAIN): P.WRITING,
    (P.CHECKING, C.EXHAUSTED): P.UNDOING,
    (P.CHECKING, C.REFUSED): P.UNDOING,
    (P.CHECKING, C.RESTARTED): P.READING,
    (P.CHECKING, C.LEFT): P.READING,
    (P.UNDOING, C.TAKEN): P.READING,
    (P.UNDOING, C.AGAIN): P.UNDOING,
    (P.UNDOING, C.EXHAUSTED): P.READING,
    (P.UNDOING, C.RESTARTED): P.READING,
    (P.UNDOING, C.LEFT): P.READING,
    (P.READING, C.AGAIN): P.READING,
    (P.READING, C.READ): P.IDLE,
}
"""Everything that is not here leaves the phase as it is: a late answer."""

TRIES = {P.WRITING: 8, P.CHECKING: 8, P.UNDOING: 4}  # frames and questions together, of one message
SENDINGS = 3  # times that a message is sent which nobody acknowledges and nobody can read back
COUNT_ON = frozenset({C.TAKEN, C.AGAIN})  # inputs after which the tries of a message are counted on
UNKNOWN_AFTER = 3  # questions without an answer after which what runs is said to be unknown


class Sending(NamedTuple):
    """What is to be put on the bus now: numbers to write, or the whole set to be read."""

    write: Numbers
    read: bool


class CourseEnd(NamedTuple):
    """The end of a write. done : the new set runs. numbers : what was read (or, without read-back, believed)."""

    done: bool
    numbers: Numbers
    reason: str


class GainCourse:
    """See the head of this file.

    acknowledges, reads_back : what the controller does. reply_s : how long to wait for an answer, s.
    """

    def __init__(self, *, acknowledges: bool, reads_back: bool, reply_s: float) -> None:
        self._acknowledges, self._reads_back, self._reply_s = acknowledges, reads_back, reply_s
        self.machine = StateMachine(COURSE, CoursePhase.IDLE)
        self._steps: Sequence[Numbers] = ()
        self._old: Numbers = {}
        self._new: Numbers = {}
        self._at = self._tries = 0
        self._open: set[str] = set()  # written, and not acknowledged yet
        self._deadline_s: float | None = None
        self._told = False
        self.reason = ""
        self.outcome: CourseEnd | None = None

    @property
    def busy(self) -> bool:
        """Whether a write is under way."""
        return self.machine.phase is not CoursePhase.IDLE

    def begin(self, steps: Sequence[Numbers], old: Numbers, new: Numbers) -> None:
        """Start: steps are the messages' numbers in the order of writing; only when not busy."""
        self._steps, self._old, self._new, self._at = steps, dict(old), dict(new), 0
        self.reason, self.outcome, self._told = "", None, False
        if steps:
            self._move(CourseInput.BEGIN)
        else:
            self.outcome = CourseEnd(True, self._new, "")

    def due(self, now_s: float) -> Sending | None:
        """What is to be sent now, if anything."""
        if self.busy and self._deadline_s is not None:
            if now_s < self._deadline_s:
                return None
            self._time_out()
        if not self.busy:
            return None
        self._tries += 1
        sending = self._sending()
        self._deadline_s = now_s + self._reply_s
        return sending

    def _sending(self) -> Sending:
        phase = self.machine.phase
        if phase is CoursePhase.WRITING:
            write: Numbers = self._steps[self._at]
        elif phase is CoursePhase.UNDOING:
            begun = [name for step in self._steps[: self._at + 1] for name in step]
            write = {name: self._old[name] for name in reversed(begun)}
        else:
            return Sending({}, read=True)
        self._open = set(write) if self._acknowledges else set()
        if not self._acknowledges and self._reads_back:  # the answer to the question is the acknowledge
            self._move(CourseInput.TAKEN)
            return Sending(write, read=True)
        return Sending(write, read=False)

    def _time_out(self) -> None:
        phase = self.machine.phase
        if phase is CoursePhase.WRITING and not self._acknowledges and not self._reads_back:
            if self._tries < SENDINGS:  # sent once more; the last time it is believed
                return
            if self._at + 1 < len(self._steps):
                self._at, self._tries = self._at + 1, 0
            else:
                self._move(CourseInput.TAKEN)
                self._move(CourseInput.LAST)
                self.outcome = CourseEnd(True, self._new, "")
            return
        self.reason = self.reason or "no answer"
        self._move(CourseInput.AGAIN if self._tries < TRIES.get(phase, self._tries + 1) else CourseInput.EXHAUSTED)

    def on_acknowledged(self, name: str) -> None:
        """A number was taken."""
        self._open.discard(name)
        if not self._open and self.machine.phase in {CoursePhase.WRITING, CoursePhase.UNDOING}:
            self._move(CourseInput.TAKEN)

    def on_refused(self, name: str, reason: str) -> None:
        """A number was refused; while the old ones are written, what is refused was refused before: it is unchanged."""
        if self.machine.phase is CoursePhase.UNDOING:
            self.on_acknowledged(name)
        elif name in self._new and self.machine.phase in {CoursePhase.WRITING, CoursePhase.CHECKING}:
            self.reason = f"the controller refused {name}: {reason}"
            self._move(CourseInput.REFUSED)

    def on_restart(self) -> None:
        """The controller has booted."""
        if self.busy:
            self.reason = "the controller restarted"
            self._move(CourseInput.RESTARTED)

    def leave(self, reason: str) -> None:
        """Nobody can be written to for now; what runs is read when somebody can. Without read-back all is sent anew."""
        if self.busy and self._reads_back:
            self.reason = reason
            self._move(CourseInput.LEFT)
        elif self.busy:
            self._at = self._tries = 0
            self._deadline_s = None

    def on_read(self, numbers: Numbers) -> None:
        """The whole set was read, after it was asked for here."""
        phase = self.machine.phase
        if phase is CoursePhase.CHECKING:
            step = self._steps[self._at]
            wrong = [name for name in step if numbers[name] != step[name]]
            if wrong:
                self.reason = f"{wrong[0]} was read back as {numbers[wrong[0]]:.9g}, written was {step[wrong[0]]:.9g}"
                return  # it is asked again, and written again, when its time is over
            so_far = {**self._old, **{name: one[name] for one in self._steps[: self._at + 1] for name in one}}
            if any(numbers[name] != so_far[name] for name in self._new):
                self.reason = "gains were changed by someone else meanwhile"
                self._move(CourseInput.EXHAUSTED)
            elif self._at + 1 < len(self._steps):
                self._at += 1
                self._move(CourseInput.NEXT)
            else:
                self._move(CourseInput.LAST)
                self.outcome = CourseEnd(True, dict(numbers), "")
        elif phase is CoursePhase.READING and self._tries > 0:
            self._move(CourseInput.READ)
            done = all(numbers[name] == self._new[name] for name in self._new)
            self.outcome = CourseEnd(done, dict(numbers), self.reason or "no answer")

    def unknown(self) -> str:
        """Why what runs is not known, once, when nobody has answered for a while; else nothing."""
        if self._told or self.machine.phase is not CoursePhase.READING or self._tries < UNKNOWN_AFTER:
            return ""
        self._told = True
        return f"{self.reason or 'no answer'}; the controller does not say what it runs; asking on"

    def _move(self, happened: CourseInput) -> None:
        if self.machine.take(happened):
            self._deadline_s = None
            self._tries = self._tries if happened in COUNT_ON else 0
