"""Every abort of a write in every phase, with its verified end."""

import itertools

import pytest

from retuner.drivers.device import RunningSet, WriteDone, WriteFailed
from retuner.drivers.host.page_reader import PageReader, ReadBack
from retuner.drivers.host.write_protocol import TRIES, WriteInput, WriteOrder, WritePhase, WriteProtocol
from retuner.drivers.protocol.checksum import page_crc
from retuner.drivers.protocol.frames import Abort, Ack, Challenge, Commit, Kind, Page, Read, Reason
from retuner.schedule.gains import PidGains

OLD, NEW = PidGains(1.0, 0.0625), PidGains(1.5, 0.125)
ORDER = WriteOrder(node=1, epoch=3, seq=7, base=6, gains=NEW)
OLD_SET, NEW_SET = RunningSet(6, OLD, 1), RunningSet(7, NEW, ORDER.set_crc)
RIGHT = ReadBack(Page.STAGED, 7, NEW, page_crc(ORDER.set_crc, 0))
TIMEOUT_S = 6.0
P, W = WritePhase, WriteInput


class Driven:
    """A protocol that is taken to a phase, and to which an event happens, through what it offers the outside."""

    def __init__(self, phase: WritePhase, *, sent: bool = True) -> None:
        self.protocol = WriteProtocol(PageReader(), TIMEOUT_S)
        self.t = 0.0
        self.owned = True
        if phase is P.IDLE:
            return
        self.protocol.begin(ORDER)
        if phase is P.CLAIMING:
            self.owned = False
        self.send()
        if phase is P.CLAIMING:
            return
        for until, step in ((P.STAGING, self.right), (P.COMMITTING, self.refused), (P.FENCING, self.fenced)):
            if phase is until:
                break
            step()
            if sent:
                self.send()
        assert self.protocol.phase is phase

    def send(self) -> list:
        self.t += 0.5
        return self.protocol.due(self.t, owned=self.owned)

    def right(self) -> None:
        self.protocol.on_staged(RIGHT)

    def refused(self) -> None:
        self.protocol.on_ack(Ack(Kind.COMMIT, 7, Reason.WRONG_BASE, 7))

    def fenced(self) -> None:
        self.protocol.on_ack(Ack(Kind.ABORT, 7, Reason.OK, 7))

    def pass_time(self) -> None:
        self.t += TIMEOUT_S
        self.protocol.due(self.t, owned=self.owned)

    def lapse(self) -> None:
        """The lease has run out when the next frames are due; of a commit that was sent, no time-out yet."""
        later = TIMEOUT_S if self.protocol.phase is P.STAGING else 0.0
        self.protocol.due(self.t + later, owned=False)

    def happen(self, event: WriteInput) -> None:
        """What the outside has to do for it."""
        protocol = self.protocol
        {
            W.LAPSED: self.lapse,
            W.REFUSED: self.refused,
            W.EXHAUSTED: lambda: [self.pass_time() for _ in range(max(TRIES.values()))],
            W.RESTARTED: protocol.on_restart,
        }[event]()

    def finish(self, running: RunningSet) -> object:
        """The device answers everything from now on; what the write comes to."""
        for _ in range(20):
            for frame in self.send():
                assert not isinstance(frame, Commit), "a commit after the write was given up"
                if isinstance(frame, Abort):
                    self.fenced()
                elif isinstance(frame, Read) and frame.page == Page.RUNNING:
                    return self.protocol.on_running(running)
        return None


def test_a_commit_that_was_sent_is_never_followed_by_another_whatever_the_lease_does() -> None:
    driven = Driven(P.COMMITTING)
    driven.happen(W.LAPSED)
    assert driven.protocol.phase is P.COMMITTING
    driven.protocol.on_ack(Ack(Kind.STAGE, 7, Reason.NOT_OWNER, 7))
    assert driven.protocol.phase is P.FENCING


ABORTS = [W.REFUSED, W.EXHAUSTED, W.RESTARTED]
OPEN = [phase for phase in P if phase is not P.IDLE]


@pytest.mark.parametrize(("phase", "event"), list(itertools.product(OPEN, ABORTS)), ids=lambda value: value.name)
@pytest.mark.parametrize("running", [OLD_SET, NEW_SET], ids=["old set runs", "new set runs"])
def test_every_abort_ends_in_what_truly_runs_read_back(phase, event, running: RunningSet) -> None:
    driven = Driven(phase)
    driven.happen(event)
    outcome = driven.finish(running)
    assert isinstance(outcome, WriteDone if running == NEW_SET else WriteFailed)
    assert outcome.running == running
    assert driven.protocol.phase is P.IDLE


@pytest.mark.parametrize(("phase", "event"), list(itertools.product(OPEN, ABORTS)), ids=lambda value: value.name)
def test_every_abort_without_answers_is_known_to_be_unknown(phase, event) -> None:
    driven = Driven(phase)
    driven.happen(event)
    unknown = []
    for _ in range(20):
        driven.pass_time()
        unknown.append(driven.protocol.unknown())
    assert driven.protocol.phase in {P.FENCING, P.READING}
    assert driven.protocol.busy
    assert sum(u is not None for u in unknown) == 1


def test_with_a_key_the_commit_waits_for_the_challenge_in_either_order() -> None:
    order = WriteOrder(node=1, epoch=3, seq=7, base=6, gains=NEW, key=bytes(16))
    for first_page in (True, False):
        protocol = WriteProtocol(PageReader(), TIMEOUT_S)
        protocol.begin(order)
        assert [type(f) for f in protocol.due(0.0, owned=True)][-2:] == [Read, Read]
        steps = [lambda p=protocol: p.on_staged(RIGHT), lambda p=protocol: p.on_challenge(Challenge(0, 1, 99))]
        for step in steps if first_page else reversed(steps):
            assert protocol.phase is P.STAGING
            step()
        assert protocol.phase is P.COMMITTING
        assert protocol.due(1.0, owned=True) == order.commit(99)
        assert len(order.commit(99)) == 3


def test_a_challenge_of_a_device_without_a_key_is_a_refusal() -> None:
    order = WriteOrder(node=1, epoch=3, seq=7, base=6, gains=NEW, key=bytes(16))
    protocol = WriteProtocol(PageReader(), TIMEOUT_S)
    protocol.begin(order)
    protocol.due(0.0, owned=True)
    protocol.on_challenge(Challenge(0, 0, 99))
    assert protocol.phase is P.FENCING
