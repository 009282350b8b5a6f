"""What a device answers where two things are wrong at once, and in which sample what ends: as protocol.md says.

The virtual device and the firmware in C are told the same.
"""

import can
import pytest
from bus_simulation.firmware import FirmwareDevice
from speaking import FIRST, OWNER, SECOND, THIRD, acks, commit, say, stage, step, take_lease

from retuner.adaptive.process.model import LinearProcess
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.frames import (
    Abort,
    Ack,
    Commit,
    Confirm,
    Frame,
    GainBox,
    Heartbeat,
    Mode,
    Read,
    Reason,
    Setpoint,
    Store,
    TelemetrySp,
)

TRIAL = 4
OTHER = 77


class Both:
    """The two of them, told the same: what one of them answers is what the other answers."""

    def __init__(self) -> None:
        box = GainBox(kp_max=20.0, ki_max=2.0, kd_max=5.0, ratio_max=10.0, direction=1)
        settings = VirtualDeviceSettings(
            FIRST, box=box, trial_samples=TRIAL, sp_min=0.0, sp_max=100.0, co_min=0.0, co_max=100.0
        )
        self.virtual, self.firmware = (
            make(settings, LinearPlant(LinearProcess(1.2, (30.0,), (), 4.0), start_pv=50.0, start_co=40.0))
            for make in (VirtualDevice, FirmwareDevice)
        )
        self.settings = settings

    @property
    def epoch(self) -> int:
        return self.virtual.epoch

    @property
    def sample(self) -> int:
        return self.virtual.sample

    def receive(self, message: can.Message) -> list[can.Message]:
        told = self.virtual.receive(message)
        assert [m.data for m in told] == [m.data for m in self.firmware.receive(message)]
        return told

    def step(self) -> list[can.Message]:
        told = self.virtual.step()
        assert [m.arbitration_id for m in told] == [m.arbitration_id for m in self.firmware.step()]
        return told


@pytest.fixture
def dev() -> Both:
    """With its lease taken, on the set of number 0."""
    both = Both()
    take_lease(both)
    return both


def reasons(dev: Both, *frames: Frame) -> list[Reason]:
    return acks(say(dev, *frames))


def runs(dev: Both) -> int:
    """Low bits of the running number in the next sample."""
    return next(f.running for f in step(dev) if isinstance(f, TelemetrySp))


def test_commands_are_checked_by_owner_then_counter_then_range(dev: Both) -> None:
    assert reasons(dev, Setpoint(10, 60.0, OWNER)) == [Reason.OK]
    assert reasons(dev, Setpoint(9, 1e6, OTHER)) == [Reason.NOT_OWNER]
    assert reasons(dev, Setpoint(9, 1e6, OWNER)) == [Reason.STALE]
    assert reasons(dev, Setpoint(11, 1e6, OWNER)) == [Reason.OUT_OF_RANGE]
    assert reasons(dev, Setpoint(11, 61.0, OWNER)) == [Reason.OK]  # the counter was not used up
    assert reasons(dev, Setpoint(11, 62.0, OWNER)) == [Reason.STALE]
    assert next(f.sp for f in step(dev) if isinstance(f, TelemetrySp)) == 61.0
    assert reasons(dev, Mode(1, 0, -50.0, OWNER), Mode(1, 1, -50.0, OWNER)) == [Reason.OUT_OF_RANGE, Reason.OK]
    assert next(f.flags for f in say(dev, Read(3, 1)) if isinstance(f, Heartbeat)) & 1


def test_an_abort_of_a_newer_number_ends_a_commit_that_waits_and_one_of_an_older_does_not(dev: Both) -> None:
    assert reasons(dev, *stage(5, SECOND), commit(5, SECOND)) == []
    assert reasons(dev, Abort(4)) == [Reason.STALE]
    assert runs(dev) == 5
    assert reasons(dev, *stage(6, THIRD), commit(6, THIRD, base=5)) == []
    assert reasons(dev, Abort(7)) == [Reason.OK]
    frames = step(dev)
    assert acks(frames) == []
    assert next(f.running for f in frames if isinstance(f, TelemetrySp)) == 5
    assert reasons(dev, commit(6, THIRD, base=5)) == [Reason.STALE]


def test_a_commit_that_is_not_staged_or_comes_beside_another_burns_nothing(dev: Both) -> None:
    assert reasons(dev, *stage(3, SECOND), commit(8, SECOND)) == [Reason.NOT_STAGED]
    assert reasons(dev, commit(3, SECOND), Commit(3, 0, 1)) == [Reason.BUSY]
    assert runs(dev) == 3
    assert reasons(dev, *stage(8, THIRD), commit(8, THIRD, base=3)) == []
    assert runs(dev) == 8


def test_confirm_and_store_of_another_number_are_stale_whatever_else_is_wrong(dev: Both) -> None:
    say(dev, *stage(3, SECOND), commit(3, SECOND))
    step(dev)
    for other in (0, 2, 4):
        assert reasons(dev, Confirm(other, OWNER)) == [Reason.STALE]
        assert reasons(dev, Store(other, OWNER % 256)) == [Reason.STALE]
    assert reasons(dev, Store(3, OWNER % 256)) == [Reason.NOT_CONFIRMED]
    assert reasons(dev, Confirm(0, OTHER), Store(0, OTHER)) == [Reason.NOT_OWNER] * 2


def test_a_trial_of_n_samples_ends_in_the_nth_sample_after_the_swap_before_its_output(dev: Both) -> None:
    say(dev, *stage(3, SECOND), commit(3, SECOND))
    shown = [runs(dev) for _ in range(TRIAL)]
    frames = step(dev)
    assert shown == [3] * TRIAL
    told = [f for f in frames if isinstance(f, Ack | TelemetrySp)]
    assert isinstance(told[0], Ack)
    assert (told[0].seq, told[0].reason) == (3, Reason.REVERTED)
    assert isinstance(told[1], TelemetrySp)
    assert told[1].running == 0
