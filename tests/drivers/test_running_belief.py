"""What a host may believe: read-backs that fit an epoch, restarts, and a device that seems to go back in time."""

from retuner.drivers.host.page_reader import ReadBack
from retuner.drivers.host.running_set import ALONE, DISPROVED_MAX, Belief, RunningBelief
from retuner.drivers.protocol.checksum import page_crc, set_crc
from retuner.drivers.protocol.frames import Heartbeat, Page
from retuner.schedule.gains import PidGains

GAINS = PidGains(1.0, 0.0625)


def page(epoch: int, seq: int = 0, gains: PidGains | None = GAINS) -> ReadBack:
    return ReadBack(Page.RUNNING, seq, gains, page_crc(set_crc(1, epoch, seq, gains or GAINS), 9), 9)


def believing(epoch: int) -> RunningBelief:
    belief = RunningBelief(1)
    assert belief.on_page(page(epoch)) is Belief.NOTHING  # no heartbeat has told an epoch yet
    belief.on_heartbeat(Heartbeat(5, epoch, 0))
    assert belief.on_page(page(epoch)) is Belief.FIRST
    return belief


def restart(belief: RunningBelief, epoch: int) -> Belief:
    belief.on_heartbeat(Heartbeat(1, epoch, 0))
    assert belief.on_page(page(epoch)) is not Belief.RESTARTED
    belief.identify()
    return belief.on_page(page(epoch))


def test_the_same_another_and_a_restarted_set() -> None:
    belief = believing(3)
    assert belief.on_page(page(3)) is Belief.SAME
    assert belief.on_page(page(3, seq=4)) is Belief.CHANGED
    assert belief.on_page(page(3, seq=4, gains=None)) is Belief.NOTHING
    assert restart(belief, 4) is Belief.RESTARTED
    assert (belief.epoch, belief.running.seq, belief.boot_sample) == (4, 0, 1)


def test_going_back_to_an_epoch_that_was_left_means_two_devices() -> None:
    belief = believing(3)
    restart(belief, 4)
    assert restart(belief, 3) is Belief.CONFLICT
    assert belief.running is None
    for _ in range(ALONE - 2):
        belief.on_heartbeat(Heartbeat(9, 3, 0))
        assert belief.on_page(page(3)) is Belief.NOTHING
    belief.on_heartbeat(Heartbeat(10, 3, 0))
    belief.on_heartbeat(Heartbeat(11, 3, 0))
    assert belief.on_page(page(3)) is Belief.RESTARTED  # one of them is off now


def test_heartbeats_that_read_backs_disprove_mean_two_devices_unless_they_are_rare() -> None:
    belief = believing(3)
    for _ in range(20):  # an old heartbeat now and then
        belief.on_heartbeat(Heartbeat(1, 2, 0))
        assert belief.on_page(page(3)) is Belief.SAME
        for sample in range(ALONE):
            belief.on_heartbeat(Heartbeat(sample, 3, 0))
    verdicts = []
    for _ in range(DISPROVED_MAX):
        belief.on_heartbeat(Heartbeat(1, 2, 0))
        verdicts.append(belief.on_page(page(3)))
        belief.on_heartbeat(Heartbeat(1, 3, 0))
    assert verdicts == [Belief.SAME] * (DISPROVED_MAX - 1) + [Belief.CONFLICT]


def test_an_old_heartbeat_that_is_sent_again_while_connecting_says_nothing_of_the_counter() -> None:
    belief = RunningBelief(1)
    for sample in (5000, 100, 5001, 3):
        belief.on_heartbeat(Heartbeat(sample, 3, 0))
    assert belief.on_page(page(3)) is Belief.FIRST
    assert belief.boot_sample == 5001
