"""What an examination comes to: what was tried, and what the device did otherwise than developers/protocol.md says."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from retuner.drivers.conformance.conversation import UNKNOWN, Conversation, NoAnswerError
from retuner.drivers.protocol.checksum import to_wire
from retuner.drivers.protocol.frames import Confirm, Frame, Reason
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field


class Finding(NamedTuple):
    """Something that the device does wrong, and the chapter of developers/protocol.md that says how it should be."""

    chapter: str
    said: str


@dataclass
class Examination:
    """One device under examination.

    talk : with it. other : a set that it takes, beside the one that it came with. findings : what it did wrong.
    """

    talk: Conversation
    first: PidGains = UNKNOWN
    other: PidGains = UNKNOWN
    chapter: str = ""
    tried: int = 0
    findings: list[Finding] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def expect(self, said: str, got: object, wanted: object) -> bool:
        """Hold what came against what must come."""
        self.tried += 1
        if got == wanted:
            return True
        self.findings.append(Finding(self.chapter, f"{said}: {shown(got)}, and not {shown(wanted)}"))
        return False

    def answers(self, said: str, wanted: Reason, *frames: Frame) -> bool:
        """Say these frames, and hold the answer to the last one against what it must be."""
        return self.expect(said, self.talk.reason(*frames), wanted)

    def holds(self, said: str, truth: object) -> bool:
        """Something must be so; said tells what is wrong when it is not."""
        self.tried += 1
        if not truth:
            self.findings.append(Finding(self.chapter, said))
        return bool(truth)

    def runs(self, said: str, gains: PidGains) -> None:
        """These gains must run now."""
        self.talk.look()
        self.expect(f"{said}: what runs", self.talk.known.gains, gains)

    def confirmed(self) -> None:
        """Confirm what runs, so that it does not give way."""
        self.talk.reason(Confirm(self.talk.known.seq, self.talk.owner))


def shown(value: object) -> str:
    """A value in the page's words."""
    if value is None:
        return "no answer"
    return value.name.lower().replace("_", " ") if isinstance(value, Reason) else str(value)


Check = Callable[[Examination], None]


def examine(talk: Conversation, chapters: Sequence[tuple[str, Check]]) -> Examination:
    """Go through the chapters; a device that falls silent in one is told, and examined in the next.

    The set that ran at the beginning runs at the end as well, if the device lets it.

    Raises NoAnswerError: it does not say who it is and what runs, or takes no other set.
    """
    found = Examination(talk)
    talk.look()
    found.first = found.other = talk.known.gains
    for chapter, check in chapters:
        found.chapter = chapter
        try:
            if talk.known.owner != talk.owner:
                talk.own()
            talk.look()
            check(found)
        except NoAnswerError as error:
            found.findings.append(Finding(chapter, str(error)))
    talk = found.talk
    found.chapter = "Changing gains"
    try:
        talk.own()
        talk.look()
        if talk.known.gains != found.first:
            talk.write(found.first)
            found.confirmed()
        found.expect("the set of the beginning, written back: what runs", talk.known.gains, found.first)
        found.chapter = "Frames"
        found.expect("wrong checksums and CRCs in the whole examination", list(dict.fromkeys(talk.spoilt)), [])
        talk.ack(talk.lease(samples=0))
    except NoAnswerError as error:
        found.findings.append(Finding(found.chapter, str(error)))
    return found


def near(gains: PidGains, factor: float) -> PidGains:
    """A set a little off, as float32."""
    return to_wire(gains.times(factor))
