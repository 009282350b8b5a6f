"""A CANopen node as a device, against the LocalNode of python-canopen: samples, gains in an order, its own word."""

import struct
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import can
import pytest
from answering_wire import Wire, nothing

from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.config.bench_plants import known_plant
from retuner.config.described import foreign_settings, make_access
from retuner.config.loading import parse_config
from retuner.drivers.canopen.virtual_node import VirtualCanOpenNode
from retuner.drivers.device import (
    CommandDone,
    DeviceMismatchError,
    DeviceRestarted,
    DeviceStopped,
    Event,
    LinkChanged,
    LinkState,
    RunningChanged,
    SamplesLost,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
    WriteUnknown,
)
from retuner.drivers.profiles.foreign_device import ForeignDevice, Numbers, any_way
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.schedule.gains import IdealGains, PidGains
from retuner.session.assembly import make_far_side

LOOP = """
schema = 1
loop = {{ name = "zone", pv_unit = "degC", pv_min = 0.0, pv_max = 400.0, sample_time_s = 1.0 }}
bus = {{ node = 5 }}
[schedule]
[[schedule.region]]
name = "all"
{gains}
[device]
kind = "canopen"
{device}
plant = {{ kind = "linear", k = 2.5, lags_s = [60.0, 4.0], theta_s = 6.0, start_pv = 150.0, start_co_pct = 40.0 }}
"""
CIA404 = LOOP.format(gains="kc = 2.0\ntau_i_s = 120.0", device='profile = "cia404"')
CIA402 = LOOP.format(
    gains='form = "parallel"\nkc = 0.4\ntau_i_s = 80.0',
    device='profile = "cia402"\npv = { scale = 0.001 }\nsetpoint = { scale = 0.001 }\ngains = { scale = 0.0001 }',
)
NEW = IdealGains(1.25, 62.0, 3.0).to_parallel()


def time_first(old: Numbers, new: Numbers, back: bool) -> tuple[int, ...]:
    del old, new, back
    return (1, 2, 0)


class Stage:
    def __init__(self, text: str = CIA404) -> None:
        config = parse_config(text)
        assert config.foreign_device is not None
        plant = known_plant(config)
        assert plant is not None
        self.node: Any = make_far_side(config, plant)
        assert isinstance(self.node, VirtualCanOpenNode)
        self.wire = Wire(self.node)
        access = make_access(config, config.foreign_device)
        self.host = ForeignDevice(
            self.wire, access, foreign_settings(config, config.foreign_device, ScheduleInputs(), 1.0)
        )
        self.host.choose_way = time_first
        self.now_s = 0.0

    def run(self, samples: int, *extra: can.Message, silent: bool = False) -> list[Event]:
        events: list[Event] = []
        for _ in range(samples):
            self.now_s += 1.0
            frames = self.node.step()
            self.wire.waiting += [*([] if silent else frames), *extra]
            events += self.host.poll(self.now_s)
        return events

    def of(self, events: Sequence[Event], kind: type) -> list[Any]:
        return [event for event in events if isinstance(event, kind)]

    def written(self) -> list[tuple[int, int]]:
        """Index and part of every object that was written by SDO, in order."""
        frames = [m.data for m in self.wire.sent if m.arbitration_id == 0x605 and m.data[0] & 0xE0 == 0x20]
        return [(int.from_bytes(data[1:3], "little"), data[3]) for data in frames]


@pytest.fixture
def stage() -> Stage:
    made = Stage()
    made.run(5)
    assert made.host.connected
    return made


def test_it_is_started_read_and_heard(stage: Stage) -> None:
    assert stage.node.node.nmt.state == "OPERATIONAL"
    assert stage.host.running.gains == pytest.approx(PidGains(2.0, 2.0 / 120.0)) or stage.host.running.gains.kp == 2.0
    samples = stage.of(stage.run(20), LoopSample)
    assert [sample.t_s for sample in samples] == list(range(int(samples[0].t_s), int(samples[0].t_s) + 20))
    assert samples[-1].pv == struct.unpack("<f", struct.pack("<f", stage.node.loop.pv))[0]
    assert samples[-1].mode == LoopMode.AUTO


def test_a_set_is_written_object_by_object_in_the_order_that_was_chosen_each_read_back(stage: Stage) -> None:
    stage.host.choose_way = time_first
    stage.wire.sent.clear()
    stage.host.begin_write(NEW, stage.now_s)
    (done,) = stage.of(stage.run(3), WriteDone)
    assert stage.written() == [(0x6452, 1), (0x6454, 1), (0x6450, 1)]
    assert done.gains == stage.host.running.gains == stage.node.loop.gains
    assert done.gains.kp == pytest.approx(1.25, rel=1e-6)
    assert stage.node.loop.gains.kd == pytest.approx(NEW.kd, rel=1e-6)


def test_without_anybodys_proof_no_set_of_several_messages_is_written() -> None:
    stage = Stage()
    stage.host.choose_way = any_way
    stage.run(5)
    with pytest.raises(WriteRefusedError, match="the sets in between are not proved"):
        stage.host.begin_write(NEW, stage.now_s)
    assert stage.written() == []


def test_a_refused_object_takes_back_what_was_begun(stage: Stage) -> None:
    before = dict(stage.node.numbers)
    variable = stage.node.node.object_dictionary[0x6454][1]
    variable.access_type = "ro"
    stage.host.begin_write(NEW, stage.now_s)
    (failed,) = stage.of(stage.run(10), WriteFailed)
    assert "tv" in failed.reason
    assert "0x06010002" in failed.reason
    assert stage.node.numbers == before
    assert failed.running.gains == stage.host.running.gains


def test_answers_that_are_lost_are_asked_for_again(stage: Stage) -> None:
    dropped: list[int] = []

    def lost(message: can.Message) -> bool:
        drop = message.arbitration_id == 0x585 and len(dropped) < 3
        dropped.extend([1] * drop)
        return drop

    stage.wire.lost = lost
    stage.host.begin_write(NEW, stage.now_s)
    assert stage.of(stage.run(60), WriteDone)
    assert len(dropped) == 3
    assert stage.node.loop.gains == stage.host.running.gains


def test_a_node_that_stops_answering_leaves_the_result_unknown_until_it_does(stage: Stage) -> None:
    stage.wire.lost = lambda message: message.arbitration_id == 0x585
    stage.host.begin_write(NEW, stage.now_s)
    events = stage.run(120)
    assert stage.of(events, WriteUnknown)
    assert not stage.of(events, (WriteDone, WriteFailed))
    assert stage.host.writing
    stage.wire.lost = nothing
    events = stage.run(20)
    (end,) = stage.of(events, (WriteDone, WriteFailed))
    assert end.running.gains == stage.node.loop.gains == stage.host.running.gains


def test_an_emergency_stops_and_its_end_lets_go(stage: Stage) -> None:
    frames = stage.node.emergency(0x4210)
    events = stage.run(1, *frames)
    (stop,) = stage.of(events, DeviceStopped)
    assert stop.reason.startswith("emergency 0x4210")
    assert stage.of(stage.run(3), LoopSample)[-1].mode == LoopMode.MANUAL
    stage.run(1, *stage.node.emergency(0))
    assert stage.of(stage.run(3), LoopSample)[-1].mode == LoopMode.AUTO


def test_a_boot_up_makes_it_read_again_what_runs(stage: Stage) -> None:
    stage.node.node.set_data(0x6452, 1, struct.pack("<f", 33.0))
    events = stage.run(3, can.Message(arbitration_id=0x705, is_extended_id=False, data=b"\0"))
    restarted = stage.of(events, DeviceRestarted)
    assert restarted
    assert restarted[0].running.gains.ki == pytest.approx(2.0 / 33.0)


def test_what_somebody_else_writes_is_seen(stage: Stage) -> None:
    stage.node.receive(
        can.Message(
            arbitration_id=0x605, is_extended_id=False, data=bytes([0x23, 0x52, 0x64, 1]) + struct.pack("<f", 77.0)
        )
    )
    (changed,) = stage.of(stage.run(70), RunningChanged)
    assert changed.running.gains.ki == pytest.approx(2.0 / 77.0)


def test_silence_and_return(stage: Stage) -> None:
    events = stage.run(20, silent=True)
    assert [event.state for event in stage.of(events, LinkChanged)] == [LinkState.SILENT]
    events = stage.run(10)
    assert stage.host.connected
    assert stage.of(events, SamplesLost)[0].count >= 19


def test_a_setpoint_is_acknowledged(stage: Stage) -> None:
    stage.host.send_setpoint(170.0, stage.now_s)
    assert CommandDone("setpoint") in stage.run(2)
    assert stage.node.loop.sp == 170.0


def test_a_node_that_holds_no_controller_is_told_in_a_line() -> None:
    stage = Stage()
    stage.node.node.data_store[0x6450][1] = struct.pack("<f", 0.0)
    with pytest.raises(DeviceMismatchError, match=r"it runs xp = 0, tn = 120, tv = 0: kc = 0"):
        stage.run(5)


def test_damaged_frames_do_nothing(stage: Stage) -> None:
    strange = [
        can.Message(arbitration_id=0x185, is_extended_id=False, data=b"\1\2"),
        can.Message(arbitration_id=0x585, is_extended_id=False, data=bytes(8)),
        can.Message(arbitration_id=0x585, is_extended_id=False, data=b"\x80"),
        can.Message(arbitration_id=0x085, is_extended_id=False, data=b"\x10"),
        can.Message(arbitration_id=0x185, is_extended_id=False, data=struct.pack("<ff", float("nan"), 1.0)),
        can.Message(arbitration_id=0x185, is_extended_id=True, data=struct.pack("<ff", 1.0, 1.0)),
    ]
    samples = stage.of(stage.run(10, *strange), LoopSample)
    assert len(samples) == 10
    assert {round(sample.pv, 3) for sample in samples} == {150.0}


def test_a_drive_of_cia_402_in_its_makers_integers() -> None:
    stage = Stage(CIA402)
    stage.run(8)
    assert stage.host.connected
    assert stage.node.numbers == {"kp": 4000.0, "ki": 50.0, "kd": 0.0}
    stage.host.begin_write(PidGains(0.51234, 0.00712), stage.now_s)
    (done,) = stage.of(stage.run(5), WriteDone)
    assert stage.node.numbers == {"kp": 5123.0, "ki": 71.0, "kd": 0.0}
    assert done.gains == PidGains(5123.0 * 0.0001, 71.0 * 0.0001)
    assert stage.of(stage.run(5), LoopSample)[-1].co == pytest.approx(40.0, abs=0.06)  # torque in 0.1 %


def test_a_node_without_pdos_is_asked_sample_by_sample(tmp_path: Path) -> None:
    text = files("retuner.drivers.profiles").joinpath("cia404.eds").read_text()
    (tmp_path / "mute.eds").write_text(text.replace("DefaultValue=$NODEID+0x180", "DefaultValue=0x80000180"))
    stage = Stage(CIA404.replace('profile = "cia404"', f'profile = "cia404"\neds = "{tmp_path}/mute.eds"'))
    samples = stage.of(stage.run(20), LoopSample)
    assert len(samples) >= 17  # pv and co of the first question came before the gains were known
    stage.wire.lost = lambda message: message.arbitration_id == 0x585 and message.data[1:3] == b"\x10\x64"  # co
    stage.run(3)
    stage.wire.lost = nothing
    assert len(stage.of(stage.run(20), LoopSample)) >= 15
