"""The write's state machine by itself: its table is complete, and every way through it ends in a read-back."""

from dataclasses import replace

import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.drivers.device import RunningSet, WriteDone, WriteFailed
from retuner.drivers.host.page_reader import PageReader, ReadBack
from retuner.drivers.host.write_protocol import (
    CLAIMS,
    TRANSITIONS,
    SequenceNumbers,
    WriteInput,
    WriteOrder,
    WritePhase,
    WriteProtocol,
)
from retuner.drivers.protocol.checksum import page_crc
from retuner.drivers.protocol.frames import Abort, Ack, Challenge, Commit, Kind, Page, Read, Reason, Stage, reason_text
from retuner.schedule.gains import PidGains

OLD, NEW = PidGains(1.0, 0.0625), PidGains(1.5, 0.125)
ORDER = WriteOrder(node=1, epoch=3, seq=7, base=6, gains=NEW)
OLD_SET, NEW_SET = RunningSet(6, OLD, 1), RunningSet(7, NEW, ORDER.set_crc)
TIMEOUT_S = 6.0
RIGHT = page_crc(ORDER.set_crc, 0)


def started() -> WriteProtocol:
    protocol = WriteProtocol(PageReader(), TIMEOUT_S)
    protocol.begin(ORDER)
    return protocol


def test_the_table_leads_from_everywhere_to_idle_and_to_idle_only_by_a_read_back() -> None:
    ways = {phase: {new for (old, _), new in TRANSITIONS.items() if old is phase} for phase in WritePhase}
    for phase in WritePhase:
        seen = {phase}
        while more := {new for old in seen for new in ways[old]} - seen:
            seen |= more
        assert WritePhase.IDLE in seen
    into_idle = {(old, event) for (old, event), new in TRANSITIONS.items() if new is WritePhase.IDLE}
    assert into_idle == {(WritePhase.READING, WriteInput.RUNNING_READ)}
    assert {event for _, event in TRANSITIONS} == set(WriteInput)


def test_a_commit_is_sent_once_and_only_after_the_right_read_back() -> None:
    protocol = started()
    frames = protocol.due(0.0, owned=True)
    assert [type(f) for f in frames] == [Stage, Stage, Stage, Read]
    assert protocol.due(1.0, owned=True) == []
    protocol.on_staged(ReadBack(Page.STAGED, 7, OLD, RIGHT))
    protocol.on_staged(ReadBack(Page.STAGED, 7, NEW, 1))
    protocol.on_staged(ReadBack(Page.STAGED, 8, NEW, RIGHT))
    assert protocol.phase is WritePhase.STAGING
    assert len(protocol.due(6.0, owned=True)) == 4
    protocol.on_staged(ReadBack(Page.STAGED, 7, NEW, RIGHT))
    assert protocol.due(7.0, owned=True) == ORDER.commit()
    assert protocol.due(8.0, owned=True) == []
    assert protocol.due(13.0, owned=True) == [Abort(7)]


def test_a_lease_that_runs_out_again_and_again_ends_the_write_without_a_commit() -> None:
    """Found by the simulation (seed 70030): the fifth time the commit was sent without a lease."""
    protocol, now_s, sent = started(), 0.0, []
    for _ in range(CLAIMS + 1):
        sent += protocol.due(now_s, owned=True)
        protocol.renumber(7)
        sent += protocol.due(now_s + TIMEOUT_S, owned=True)
        protocol.on_staged(ReadBack(Page.STAGED, 7, NEW, RIGHT))
        assert protocol.phase is WritePhase.COMMITTING
        now_s += 2 * TIMEOUT_S
        sent += protocol.due(now_s, owned=False)
        now_s += 1.0
    assert not [frame for frame in sent if isinstance(frame, Commit)]
    assert sent[-1] == Abort(7)
    assert protocol.phase is WritePhase.FENCING


def test_gains_that_are_sent_again_are_read_back_again_before_the_commit() -> None:
    """With a key the challenge may be what is missing: what was right before the gains were sent once more proves
    nothing of how they stand there now.
    """
    order = replace(ORDER, key=bytes(16))
    protocol = WriteProtocol(PageReader(), TIMEOUT_S)
    protocol.begin(order)
    protocol.due(0.0, owned=True)
    protocol.on_staged(ReadBack(Page.STAGED, 7, NEW, RIGHT))
    assert [type(frame) for frame in protocol.due(7.0, owned=True)] == [Stage, Stage, Stage, Read, Read]
    protocol.on_challenge(Challenge(0, 1, 5))
    assert protocol.phase is WritePhase.STAGING
    protocol.on_staged(ReadBack(Page.STAGED, 7, NEW, RIGHT))
    assert protocol.phase is WritePhase.COMMITTING


def test_a_write_that_fails_keeps_the_number_that_is_fenced_off() -> None:
    """The lease ran out, then the device restarted: the number in the report is the one that the device was told."""
    protocol = started()
    protocol.due(0.0, owned=True)
    protocol.due(6.0, owned=False)
    assert protocol.needs_number
    protocol.on_restart()
    assert protocol.due(6.0, owned=True) == [Abort(7)]
    protocol.renumber(8)
    assert (protocol.needs_number, protocol.seq) == (False, 7)


def test_only_the_read_back_decides() -> None:
    for running, outcome in ((NEW_SET, WriteDone), (OLD_SET, WriteFailed)):
        protocol = started()
        protocol.due(0.0, owned=True)
        protocol.on_staged(ReadBack(Page.STAGED, 7, NEW, RIGHT))
        protocol.due(2.0, owned=True)
        assert protocol.on_running(NEW_SET) is None
        protocol.on_ack(Ack(Kind.COMMIT, 7, Reason.OK, 7))
        assert protocol.on_running(OLD_SET) is None  # the answer to a question asked before the acknowledge
        assert [type(f) for f in protocol.due(4.0, owned=True)] == [Read]
        assert isinstance(protocol.on_running(running), outcome)
        assert not protocol.busy


INPUTS = st.one_of(
    st.builds(Ack, st.sampled_from(list(Kind)), st.sampled_from([6, 7, 8]), st.sampled_from(list(Reason)), st.just(7)),
    st.builds(
        ReadBack,
        st.just(Page.STAGED),
        st.sampled_from([6, 7]),
        st.sampled_from([OLD, NEW, None]),
        st.sampled_from([1, RIGHT]),
        st.just(0),
    ),
    st.sampled_from([OLD_SET, NEW_SET, "restart", "wait"]),
)


@given(st.lists(INPUTS, max_size=40))
@settings(max_examples=examples(500))
def test_no_order_of_events_sends_a_second_commit_or_ends_without_a_read_back(events: list) -> None:
    protocol, t, commits = started(), 0.0, 0
    for event in events:
        commits += sum(isinstance(f, Commit) for f in protocol.due(t, owned=True))
        t += TIMEOUT_S if event == "wait" else 0.5
        before, outcome = protocol.phase, None
        if isinstance(event, Ack):
            protocol.on_ack(event)
        elif isinstance(event, ReadBack):
            protocol.on_staged(event)
        elif isinstance(event, RunningSet):
            outcome = protocol.on_running(event)
        elif event == "restart":
            protocol.on_restart()
        assert protocol.phase is before or (before, protocol.phase) in {(k[0], v) for k, v in TRANSITIONS.items()}
        if not protocol.busy:
            assert before is WritePhase.READING
            assert isinstance(outcome, WriteDone) == (event == NEW_SET)
            break
    assert commits <= 1


@pytest.mark.parametrize(("reason", "text"), [(Reason.RATIO, "ratio (ki)"), (Reason.STALE, "stale"), (31, "reason 31")])
def test_refusals_in_words(reason: int, text: str) -> None:
    assert reason_text(Ack(Kind.COMMIT, 1, reason, 1, 1)) == text


def test_only_the_answer_to_its_own_number_leads_a_host_back() -> None:
    """Somebody repeats an old refusal of another's set: the numbers that were used since stay used."""
    numbers = SequenceNumbers()
    numbers.note(40)
    numbers.correct(Ack(Kind.STAGE, 9, Reason.STALE, 9), 41)
    assert numbers.after(8) == 41
    numbers.correct(Ack(Kind.STAGE, 41, Reason.STALE, 9), 41)
    assert numbers.after(8) == 10


def test_the_next_sequence_is_newer_than_all_seen_and_wraps() -> None:
    sequence = SequenceNumbers()
    assert sequence.after(4) == 5
    sequence.note(9)
    sequence.note(8)
    assert sequence.after(4) == 10
    sequence.note(65535)  # older than 9 on the circle: ignored
    assert sequence.after(9) == 10
    assert SequenceNumbers().after(65535) == 0
