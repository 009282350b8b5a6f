"""A dead sensor, a fault input, a store that takes long or fails, settings that cannot be: both devices do alike."""

import math
import re
import struct

import can
import pytest
from bus_simulation.device_end import LagPlant
from bus_simulation.firmware import FIRMWARE, FirmwareDevice

from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.protocol.checksum import commit_crc, lease_stamp, set_crc
from retuner.drivers.protocol.codec import Codec, Refused
from retuner.drivers.protocol.frames import (
    Ack,
    Commit,
    Confirm,
    Flags,
    Frame,
    GainBox,
    Heartbeat,
    Item,
    Kind,
    Lease,
    Mode,
    Page,
    Read,
    Reason,
    Setpoint,
    Stage,
    Store,
)
from retuner.schedule.gains import PidGains

CODEC = Codec(1)
FIRST, SECOND = PidGains(1.0, 0.0625, 0.25), PidGains(2.0, 0.125, 0.5)
BOX = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0, direction=1)
MAKES = pytest.mark.parametrize("make", [VirtualDevice, FirmwareDevice])
NO_NUMBERS = pytest.mark.parametrize("spoilt", [math.nan, math.inf, -3e38, 2e9])
HOST = 5
MANUAL_CO = 33.0


class Sensor(LagPlant):
    """A lag whose sensor says something else where it is told to."""

    says: float | None = None

    def step(self, *given: float) -> float:
        pv = super().step(*given)
        return pv if self.says is None else self.says


class AtPowerOn:
    """A plant at rest whose first reading is none."""

    def __init__(self, says: float) -> None:
        self.pv = says

    def step(self, *_: float) -> float:
        return self.pv

    def steady_co(self, *_: float) -> float:
        return 45.5


def told(messages: list[can.Message]) -> list[Frame]:
    frames = [CODEC.decode(message) for message in messages]
    return [frame for frame in frames if not isinstance(frame, Refused)]


def say(device, *frames: Frame) -> list[Ack]:
    messages = [message for frame in frames for message in device.receive(CODEC.encode(frame))]
    return [frame for frame in told(messages) if isinstance(frame, Ack)]


def owned(make, plant=None, keep=lambda: True, **more):
    settings = VirtualDeviceSettings(FIRST, box=BOX, sp_min=0.0, sp_max=200.0, heartbeat_samples=1, **more)
    device = make(settings, plant or LagPlant(), keep=keep)
    say(device, Lease(HOST, lease_stamp(device.epoch, 0), 6000, 1))
    return device


def committed(device, seq: int, gains: PidGains, base: int) -> list[Ack]:
    values = zip(Item, (gains.kp, gains.ki, gains.kd), strict=True)
    crc = commit_crc(set_crc(1, device.epoch, seq, gains), base, HOST)
    return say(device, *(Stage(item, HOST, value, seq) for item, value in values), Commit(seq, base, crc))


def flags(device) -> Flags:
    frames = told(device.receive(CODEC.encode(Read(Page.IDENTITY, 1))))
    return next(Flags(frame.flags) for frame in frames if isinstance(frame, Heartbeat))


@MAKES
@NO_NUMBERS
def test_the_law_begins_with_the_first_number(make, spoilt: float) -> None:
    """A boot under a sensor that was not ready made the integral no number, and co stood still for ever."""
    plant = AtPowerOn(spoilt)
    device = owned(make, plant)
    device.step()
    begun = device.co
    assert math.isfinite(begun)
    assert flags(device) & Flags.BLIND
    plant.pv = 50.0
    device.step()
    assert not flags(device) & Flags.BLIND
    assert device.co == pytest.approx(begun, abs=1e-3)
    assert device.sp == 50.0
    plant.pv = 40.0
    device.step()
    assert device.co > begun + 5.0


@MAKES
@NO_NUMBERS
def test_a_reading_in_manual_does_not_stop_automatic(make, spoilt: float) -> None:
    plant = Sensor()
    device = owned(make, plant)
    say(device, Mode(1, 0, 60.0, HOST))
    device.step()
    plant.says = spoilt
    say(device, Mode(2, 0, MANUAL_CO, HOST))
    device.step()
    assert device.co == pytest.approx(MANUAL_CO)  # an operator's hand goes on without a sensor
    plant.says = None
    say(device, Mode(3, 1, 0.0, HOST))
    device.step()
    assert device.co == pytest.approx(MANUAL_CO, abs=5.0)  # pv has moved for two samples
    say(device, Setpoint(1, 150.0, HOST))
    for _ in range(200):
        device.step()
    assert device.co > MANUAL_CO + 10.0


@MAKES
def test_a_swap_waits_for_a_number(make) -> None:
    """Swapped in under NaN, co went from 45.5 to 60.75. It must be what the gains before would have given."""
    device, as_before = (owned(make, Sensor()) for _ in range(2))
    for one in (device, as_before):
        say(one, Setpoint(1, 60.0, HOST))
        one.step()
    committed(device, 1, SECOND, 0)
    for one in (device, as_before):
        one.plant.says = math.nan
    assert not [frame for frame in told(device.step()) if isinstance(frame, Ack)]
    as_before.step()
    assert device.running.seq == 0
    for one in (device, as_before):
        one.plant.says = None
    frames = told(device.step())
    as_before.step()
    assert [Reason(frame.reason) for frame in frames if isinstance(frame, Ack)] == [Reason.OK]
    assert device.running == (1, SECOND)
    assert device.co == pytest.approx(as_before.co, abs=1e-4)


@MAKES
def test_a_trial_ends_at_a_number(make) -> None:
    plant = Sensor()
    device = owned(make, plant, trial_samples=3)
    committed(device, 1, SECOND, 0)
    device.step()
    plant.says = math.nan
    for _ in range(6):
        device.step()
        assert device.running.seq == 1
    before = device.co
    plant.says = None
    answers = [frame for frame in told(device.step()) if isinstance(frame, Ack)]
    assert [(answer.kind, Reason(answer.reason)) for answer in answers] == [(Kind.CONFIRM, Reason.REVERTED)]
    assert device.running == (0, FIRST)
    assert device.co == pytest.approx(before, abs=1.5)


@MAKES
def test_a_fault_puts_co_where_it_harms_nobody_and_is_left_without_a_bump(make) -> None:
    plant = Sensor()
    device = owned(make, plant, co_fault=10.0, co_rate_per_s=0.5)
    device.step()
    device.tell_fault(fault=True)
    plant.says = math.nan
    device.step()
    assert device.co == pytest.approx(10.0)
    assert flags(device) & Flags.FAULT
    plant.says = None
    device.step()
    device.tell_fault(fault=False)
    device.step()
    assert not flags(device) & Flags.FAULT
    assert device.co == pytest.approx(10.0, abs=1.01)  # 0.5 % per second, 2 s


@MAKES
@pytest.mark.parametrize(("done", "reason"), [(True, Reason.OK), (False, Reason.NOT_STORED)])
def test_a_store_is_answered_when_it_is_there(make, done: bool, reason: Reason) -> None:
    device = owned(make, keep=lambda: None)
    committed(device, 1, SECOND, 0)
    device.step()
    say(device, Confirm(1, HOST))
    assert say(device, Store(1, HOST)) == []
    assert say(device, Store(1, HOST)) == []  # asked again: the answer is still to come
    assert not flags(device) & Flags.STORED
    (answer,) = told(device.stored(done=done))
    assert isinstance(answer, Ack)
    assert (answer.kind, answer.seq, Reason(answer.reason)) == (Kind.STORE, 1, reason)
    assert bool(flags(device) & Flags.STORED) == done
    assert device.stored(done=True) == []
    device.restart()
    assert device.running == ((1, SECOND) if done else (0, FIRST))


@MAKES
def test_another_set_is_not_stored_while_one_is(make) -> None:
    device = owned(make, keep=lambda: None)
    for seq, gains in ((1, SECOND), (2, FIRST)):
        committed(device, seq, gains, seq - 1)
        device.step()
        say(device, Confirm(seq, HOST))
        if seq == 1:
            assert say(device, Store(seq, HOST)) == []
    assert [Reason(answer.reason) for answer in say(device, Store(2, HOST))] == [Reason.BUSY]
    device.restart()
    assert device.running == (0, FIRST)
    assert device.stored(done=True) == []


@pytest.mark.parametrize(
    ("wrong", "name"),
    [({"b": math.nan}, "b"), ({"tau_f_s": -1.0}, "tau_f_s"), ({"heartbeat_samples": 0}, "heartbeat_samples"),
     ({"sample_time_s": math.nan}, "sample_time_s"), ({"co_max": 300.0}, "co_min, co_max"), ({"node": 64}, "node"),
     ({"lease_longest_samples": 0}, "lease_longest_samples"), ({"co_fault": math.inf}, "co_fault")],
)  # fmt: skip
def test_settings_that_cannot_be_are_named(wrong: dict[str, float], name: str) -> None:
    """The header's ranges are asked of C alone: what Python refuses before is put in by the back door of a copy."""
    settings = VirtualDeviceSettings(FIRST, box=BOX)
    for key, value in wrong.items():
        object.__setattr__(settings, key, value)
    with pytest.raises(ValueError, match=f"firmware: {name} is outside its range"):
        FirmwareDevice(settings, LagPlant())


def test_no_byte_of_the_stack_goes_to_flash() -> None:
    device = owned(FirmwareDevice)
    assert say(device, Store(0, HOST))[0].reason == Reason.OK
    kept = device.kept(0)
    assert struct.unpack("<I4xHHfff", kept) == (1, 0, 0, FIRST.kp, FIRST.ki, FIRST.kd)


def test_the_watchdog_is_told_once_a_sample_also_without_a_reading() -> None:
    plant = Sensor()
    device = owned(FirmwareDevice, plant)
    device.step()
    plant.says = math.nan
    device.step()
    assert device.alive == 2


def test_the_setpoint_of_before_a_reset_is_taken_up() -> None:
    device = owned(FirmwareDevice)
    say(device, Setpoint(1, 70.0, HOST))
    device.step()
    device.restart(sp=device.sp)
    assert device.sp == 70.0
    device.restart()
    assert device.sp == pytest.approx(device.pv)


def test_no_byte_is_shifted_as_an_int() -> None:
    """Where an int has 16 bits, a byte of 128 or more shifted by 8 does not fit it."""
    source = (FIRMWARE / "retuner_device.c").read_text(encoding="ascii")
    shifted = re.findall(r"(\([\w ]+\))?\b(at|data|message)\[[^\]]*\] << (?:8|16|24)", source)
    assert shifted
    assert {cast for cast, _ in shifted} <= {"(unsigned)", "(uint32_t)"}
