"""Gains being written to a CANopen node while somebody else is on the bus: forged answers, strangers, outages.

Whatever happens, the node runs only sets on the way that was chosen, the host ends every write once, and knows what
runs as soon as it is left alone. What a stranger writes, the node runs: it obeys everybody; the host tells it.
"""

import itertools
import random
import struct
from collections.abc import Callable

import can
import pytest
from effort import sized
from test_canopen_device import NEW, Stage

from retuner.drivers.device import Event, LinkChanged, LinkState, RunningChanged, WriteDone, WriteFailed
from retuner.schedule.gains import IdealGains, PidGains

ANSWER, REQUEST, GAINS = 0x585, 0x605, (0x6450, 0x6452, 0x6454)
OTHER = IdealGains(2.5, 100.0, 1.0).to_parallel()
Frames = Callable[[random.Random], list[can.Message]]
Receive = Callable[[can.Message], list[can.Message]]


def frame(cob: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=cob, is_extended_id=False, data=data)


def forged_acknowledge(draw: random.Random) -> list[can.Message]:
    return [frame(ANSWER, struct.pack("<BHBI", 0x60, draw.choice(GAINS), 1, 0))]


def forged_number(draw: random.Random) -> list[can.Message]:
    return [frame(ANSWER, struct.pack("<BHBf", 0x43, draw.choice(GAINS), 1, draw.uniform(0.0, 300.0)))]


def forged_abort(draw: random.Random) -> list[can.Message]:
    return [frame(ANSWER, struct.pack("<BHBI", 0x80, draw.choice(GAINS), 1, 0x08000020))]


def noise(draw: random.Random) -> list[can.Message]:
    """Of any length and kind, under identifiers near the node's."""
    cob = draw.choice([0x000, 0x080, 0x085, 0x185, 0x585, 0x584, 0x705])
    odd = draw.choice(["is_remote_frame", "is_extended_id", "is_error_frame", "is_fd"])
    made = can.Message(arbitration_id=cob, is_extended_id=False, data=draw.randbytes(draw.randrange(9)))
    strange = can.Message(arbitration_id=cob, dlc=0, **{"is_extended_id": False, odd: True})
    return [made, strange]


def boot_up(draw: random.Random) -> list[can.Message]:
    del draw
    return [frame(0x705, b"\0")]


ANSWERS: tuple[Frames, ...] = (forged_acknowledge, forged_number, forged_abort, noise, boot_up)


class Attacked(Stage):
    """A stage that notes every set that the node runs and every end of a write."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.draw = random.Random(seed)
        self.ran: list[PidGains] = []
        self.ends: list[WriteDone | WriteFailed] = []
        take = self.node.loop.take_gains

        def noted(gains: PidGains) -> None:
            self.ran.append(gains)
            take(gains)

        self.node.loop.take_gains = noted
        super().run(5)
        self.host.choose_way = self.way
        self.allowed = {self.node.loop.gains}
        self.begun = 0

    def way(self, old: dict[str, float], new: dict[str, float], back: bool) -> tuple[int, ...]:
        """Time first, and what it leads through."""
        del back
        now = dict(old)
        for message in (1, 2, 0):
            now |= self.node.units.of_message(message, new)
            self.allowed.add(self.node.units.of(now))
        return (1, 2, 0)

    def write(self, gains: PidGains) -> None:
        if self.host.connected and not self.host.writing:
            self.host.begin_write(gains, self.now_s)
            self.begun += 1

    def run(self, samples: int, *extra: can.Message, silent: bool = False) -> list[Event]:
        events = super().run(samples, *extra, silent=silent)
        self.ends += [event for event in events if isinstance(event, WriteDone | WriteFailed)]
        return events

    def strangers(self, request: bytes) -> None:
        """Another client asks the node; everybody hears the answer."""
        self.wire.waiting += self.node.receive(frame(REQUEST, request))

    def left_alone(self) -> None:
        """What must be true a while after the last attack."""
        self.wire.lost = lambda _: False
        self.run(90)
        assert self.host.connected
        assert not self.host.writing
        assert self.host.running.gains == self.node.loop.gains
        assert len(self.ends) == self.begun
        self.write(OTHER if self.node.loop.gains == NEW else NEW)
        self.run(10)
        assert isinstance(self.ends[-1], WriteDone)
        assert self.node.loop.gains == self.ends[-1].gains == self.host.running.gains


@pytest.mark.parametrize("seed", range(sized(6, 8, 60)))
def test_forged_answers_lead_to_no_set_that_was_not_proved(seed: int) -> None:
    stage = Attacked(seed)
    for _ in range(40):
        stage.write(stage.draw.choice([NEW, OTHER]))
        forged = [one for _ in range(stage.draw.randrange(4)) for one in stage.draw.choice(ANSWERS)(stage.draw)]
        stage.wire.waiting += forged  # they come before the node's own answers
        stage.run(stage.draw.randrange(1, 4), *forged[:1])
    assert set(stage.ran) <= stage.allowed
    stage.left_alone()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(sized(6, 8, 60)))
def test_outages_in_the_middle_of_writes_are_recovered_from(seed: int) -> None:
    stage = Attacked(seed)
    for _ in range(15):
        stage.write(stage.draw.choice([NEW, OTHER]))
        share = stage.draw.random()
        stage.wire.lost = lambda _, share=share: stage.draw.random() < share
        stage.run(stage.draw.randrange(1, 4))
        silent = stage.draw.random() < 0.5
        stage.wire.lost = lambda message, silent=silent: silent or message.arbitration_id == ANSWER
        stage.wire.state = LinkState.DOWN if silent and stage.draw.random() < 0.5 else LinkState.UP
        stage.run(stage.draw.randrange(1, 30), silent=silent)
        stage.wire.state, stage.wire.lost = LinkState.UP, lambda _: False
        stage.run(stage.draw.randrange(0, 6))
    assert set(stage.ran) <= stage.allowed
    stage.left_alone()


@pytest.mark.parametrize("seed", range(sized(6, 8, 60)))
def test_what_strangers_write_meanwhile_is_told(seed: int) -> None:
    stage = Attacked(seed)
    draw = stage.draw
    for _ in range(20):
        stage.write(draw.choice([NEW, OTHER]))
        for _ in range(draw.randrange(3)):
            index = draw.choice(GAINS)
            written = struct.pack("<BHBf", 0x23, index, 1, draw.uniform(5.0, 200.0))
            stage.strangers(draw.choice([written, struct.pack("<BHB4x", 0x40, index, 1)]))
        stage.run(draw.randrange(1, 4))
    stage.left_alone()


def test_a_stranger_between_two_messages_ends_the_way_that_was_proved() -> None:
    stage = Attacked(1)
    band = stage.node.numbers["xp"]
    acknowledged = []

    def lost(message: can.Message) -> bool:
        if message.arbitration_id == ANSWER and message.data[0] == 0x60 and not acknowledged:
            acknowledged.append(message)
            stage.node.receive(frame(REQUEST, struct.pack("<BHBf", 0x23, 0x6450, 1, 3.0)))  # a narrow band
        return False

    stage.wire.lost = lost
    stage.wire.sent.clear()
    stage.write(NEW)
    (failed,) = [event for event in stage.run(5) if isinstance(event, WriteFailed)]
    assert failed.reason == "gains were changed by someone else meanwhile"
    assert stage.written() == [(0x6452, 1), (0x6452, 1)]  # tn, and back
    assert failed.running.gains == stage.host.running.gains == stage.node.loop.gains
    assert stage.node.numbers["xp"] == 3.0 != band


def test_silence_in_the_middle_of_a_write_ends_it_with_what_runs() -> None:
    stage = Attacked(1)
    stage.wire.lost = lambda message: message.arbitration_id == ANSWER
    stage.write(NEW)
    gone = stage.run(60, silent=True)
    assert [event.state for event in gone if isinstance(event, LinkChanged)] == [LinkState.SILENT]
    stage.wire.lost = lambda _: False
    back = stage.run(10)
    up, failed = (event for event in back if isinstance(event, LinkChanged | WriteFailed))
    assert isinstance(up, LinkChanged)
    assert isinstance(failed, WriteFailed)
    assert up.state is LinkState.UP
    assert stage.ends == [failed]
    assert failed.reason == "no frame for 7 s"
    assert not [event for event in back if isinstance(event, RunningChanged)]
    stage.left_alone()


def test_two_nodes_of_one_number_are_noticed_and_not_written_to() -> None:
    stage, twin = Attacked(1), Stage()
    twin.run(5)
    twin.host.begin_write(OTHER, twin.now_s)
    twin.run(5)
    own = stage.node.receive

    def both(message: can.Message) -> list[can.Message]:
        answers = [own(message), twin.node.receive(message)]
        stage.draw.shuffle(answers)
        return [one for some in answers for one in some]

    stage.node.receive = both
    told = [event for _ in range(20) for event in stage.run(10) if isinstance(event, LinkChanged)]
    assert [event.state for event in told] == [LinkState.SILENT]
    assert "a second node of this number?" in told[0].reason
    assert stage.written() == []
    stage.node.receive = own
    stage.left_alone()
    assert set(stage.ran) <= stage.allowed


@pytest.mark.parametrize("seed", range(sized(5, 6, 40)))
def test_a_second_node_that_comes_in_the_middle_of_a_write_leaves_a_set_that_was_proved(seed: int) -> None:
    stage, twin = Attacked(seed), Stage()
    twin.run(5)
    own = stage.node.receive
    left = itertools.count(-stage.draw.randrange(12))
    stage.node.receive = lambda message: own(message) + (twin.node.receive(message) if next(left) >= 0 else [])
    stage.write(NEW)
    stage.run(20)
    assert set(stage.ran) <= stage.allowed
    stage.node.receive = own
    stage.left_alone()
