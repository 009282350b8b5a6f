"""A controller behind its DBC, against an ODrive that knows nothing of DBCs: bytes by struct, as in its manual."""

import itertools
import struct
from collections.abc import Sequence

import can
import pytest
from answering_wire import Wire

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.config.described import foreign_settings, make_access, mapping_of
from retuner.config.loading import parse_config
from retuner.drivers.device import (
    CommandDone,
    DeviceSilentError,
    DeviceStopped,
    Event,
    LinkChanged,
    LinkState,
    SamplesLost,
    WriteDone,
    WriteRefusedError,
)
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.profiles.foreign_device import ForeignDevice
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import law, start, step

NODE, SAMPLE_S = 3, 0.02
ODRIVE = """
schema = 1
[loop]
name = "axis"
pv_unit = "rev/s"
pv_min = -50.0
pv_max = 50.0
co_min_pct = -100.0
sample_time_s = 0.02
[schedule]
[[schedule.region]]
name = "all"
kc = 1.0
tau_i_s = 2.0
[device]
kind = "dbc"
profile = "odrive"
node = 3
accept = [{accept}]
co = {{ scale = 5.0 }}
gains = {{ scale = 50.0 }}
"""


class Axis:
    """An ODrive axis on a flywheel: velocity control, gains in Nm per rev/s and Nm per rev, 0.1 Nm/A, 20 A."""

    def __init__(self) -> None:
        self.gains = (0.02, 0.01)
        self.vel_input = self.iq = self.vel = 0.0
        self.state, self.error = 8, 0
        self.fed = self.gain_frames = self.samples = 0
        self._plant = LinearPlant(LinearProcess(0.8, (0.5,), (), 0.04), start_pv=0.0, start_co=0.0, co_min=-100.0)
        self._law = law(PidGains(1.0, 0.5), co_min=-100.0)
        self._state = start(self._law, 0.0, 0.0, 0.0)

    def sample(self) -> list[can.Message]:
        """Encoder estimates each time, a heartbeat each fifth."""
        self.samples += 1
        self.vel = self._plant.step(5.0 * self.iq, 0.0, SAMPLE_S)
        vel_gain, integrator = self.gains
        self._law = law(PidGains(50.0 * vel_gain, 50.0 * integrator), co_min=-100.0)
        self._state, co = step(self._law, self._state, self.vel_input, self.vel, SAMPLE_S)
        self.iq = co / 5.0
        frames = [frame(0x09, struct.pack("<ff", 0.0, self.vel))]
        if self.samples % 5 == 0:
            frames.insert(0, frame(0x01, struct.pack("<IB3x", self.error, self.state)))
        return frames

    def receive(self, message: can.Message) -> list[can.Message]:
        if message.arbitration_id >> 5 != NODE or message.is_extended_id:
            return []
        self.fed += 1
        command = message.arbitration_id & 0x1F
        if command == 0x14 and message.is_remote_frame:
            return [frame(0x14, struct.pack("<ff", self.iq, self.iq))]
        if command == 0x0D:
            self.vel_input, _torque = struct.unpack("<ff", message.data)
        if command == 0x1B:
            self.gains = struct.unpack("<ff", message.data)
            self.gain_frames += 1
        return []


def frame(command: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=NODE << 5 | command, is_extended_id=False, data=data)


class Stage:
    """Axis and host, sample by sample."""

    def __init__(self, accept: str = '"no_read_back"') -> None:
        config = parse_config(ODRIVE.format(accept=accept))
        assert config.foreign_device is not None
        access = make_access(config, config.foreign_device)
        self.axis = Axis()
        self.wire = Wire(self.axis)
        settings = foreign_settings(config, config.foreign_device, ScheduleInputs(), 1.0)
        self.host = ForeignDevice(self.wire, access, settings)
        self.now_s = 0.0

    def run(self, samples: int, extra: Sequence[can.Message] = (), *, silent: bool = False) -> list[Event]:
        events: list[Event] = []
        for _ in range(samples):
            self.now_s += SAMPLE_S
            frames = self.axis.sample()
            self.wire.waiting += [*extra, *([] if silent else frames)]
            events += self.host.poll(self.now_s)
        return events


def samples_of(events: Sequence[Event]) -> list[LoopSample]:
    return [event for event in events if isinstance(event, LoopSample)]


@pytest.fixture
def stage() -> Stage:
    made = Stage()
    made.run(10)
    return made


def test_samples_are_the_axis_own_values_one_by_one(stage: Stage) -> None:
    stage.host.send_setpoint(10.0, stage.now_s)
    events = stage.run(100)
    samples = samples_of(events)
    assert len(samples) == 100
    assert [round((b.t_s - a.t_s) / SAMPLE_S) for a, b in itertools.pairwise(samples)] == [1] * 99
    assert samples[-1].pv == struct.unpack("<f", struct.pack("<f", stage.axis.vel))[0]
    assert samples[-1].co == pytest.approx(5.0 * stage.axis.iq, rel=1e-6)
    assert samples[-1].sp == stage.axis.vel_input == 10.0
    assert samples[-1].mode == LoopMode.AUTO


def test_a_set_goes_out_in_one_frame_in_the_axis_units_and_is_believed_where_that_is_accepted(stage: Stage) -> None:
    assert stage.axis.gains == struct.unpack("<ff", struct.pack("<ff", 0.02, 0.01))  # the configured set, sent once
    stage.host.begin_write(PidGains(2.0, 1.5), stage.now_s)
    events = stage.run(60)
    (done,) = [event for event in events if isinstance(event, WriteDone)]
    assert stage.axis.gains == struct.unpack("<ff", struct.pack("<ff", 0.04, 0.03))
    held = PidGains(*(50.0 * gain for gain in stage.axis.gains))
    assert done.gains == held == done.running.gains
    assert stage.axis.gain_frames == 1 + 3  # nobody acknowledges: it is sent three times
    assert samples_of(events)[-1].revision == done.running.seq


@pytest.mark.parametrize("before", [0, 10, 20])
def test_silence_in_the_middle_of_a_write_without_read_back_ends_with_the_set_sent_again(
    stage: Stage, before: int
) -> None:
    stage.host.begin_write(PidGains(2.0, 1.5), stage.now_s)
    events = stage.run(before)
    send, stage.wire.send = stage.wire.send, lambda _: False  # nothing gets through either way
    events += stage.run(100, silent=True)
    stage.wire.send = send
    events += stage.run(150)
    assert [e.state for e in events if isinstance(e, LinkChanged)] == [LinkState.SILENT, LinkState.UP]
    (done,) = [event for event in events if isinstance(event, WriteDone)]
    assert not stage.host.writing
    assert stage.host.running.gains == done.gains == PidGains(*(50.0 * gain for gain in stage.axis.gains))


def test_without_the_users_word_nothing_is_ever_written() -> None:
    stage = Stage(accept="")
    stage.run(10)
    assert stage.host.connected
    with pytest.raises(WriteRefusedError, match=r'accept = \["no_read_back"\]'):
        stage.host.begin_write(PidGains(2.0, 1.5), stage.now_s)
    stage.run(50)
    assert stage.axis.gain_frames == 0


def test_the_watchdog_is_fed_with_the_setpoint(stage: Stage) -> None:
    stage.host.send_setpoint(5.0, stage.now_s)
    stage.wire.sent.clear()
    stage.run(50)  # a second: every 0.1 s
    fed = [message for message in stage.wire.sent if message.arbitration_id == NODE << 5 | 0x0D]
    assert 9 <= len(fed) <= 11
    assert {struct.unpack("<ff", message.data) for message in fed} == {(5.0, 0.0)}


def test_an_axis_error_is_told_once_and_its_samples_are_not_in_auto(stage: Stage) -> None:
    stage.axis.error, stage.axis.state = 0x800, 1
    events = stage.run(50)
    stops = [event for event in events if isinstance(event, DeviceStopped)]
    assert stops == [DeviceStopped("Axis0_Heartbeat.Axis_Error = 2048")]
    assert samples_of(events)[-1].mode == LoopMode.MANUAL
    stage.axis.error, stage.axis.state = 0, 8
    assert samples_of(stage.run(20))[-1].mode == LoopMode.AUTO


def test_silence_is_told_and_what_was_believed_is_sent_again_after_it(stage: Stage) -> None:
    events = stage.run(40, silent=True)
    assert [event.state for event in events if isinstance(event, LinkChanged)] == [LinkState.SILENT]
    assert not stage.host.connected
    stage.axis.gains = (9.0, 9.0)  # it has booted with other gains
    events = stage.run(10)
    assert [event.state for event in events if isinstance(event, LinkChanged)] == [LinkState.UP]
    assert [event.count for event in events if isinstance(event, SamplesLost)] == [40]
    assert stage.axis.gains == struct.unpack("<ff", struct.pack("<ff", 0.02, 0.01))


def test_nobody_there_is_one_clear_line() -> None:
    stage = Stage()
    with pytest.raises(DeviceSilentError, match="no frame of it within 5 s; is the device running there"):
        stage.run(300, silent=True)


def test_numbers_that_are_none_never_reach_the_wire(stage: Stage) -> None:
    with pytest.raises(WriteRefusedError, match="finite"):
        stage.host.send_setpoint(float("nan"), stage.now_s)
    with pytest.raises(WriteRefusedError, match="kp"):
        stage.host.begin_write(PidGains(1e300, 1.0), stage.now_s)
    with pytest.raises(WriteRefusedError, match="derivative"):
        stage.host.begin_write(PidGains(1.0, 1.0, 1.0), stage.now_s)


def test_frames_of_others_and_damaged_ones_do_nothing(stage: Stage) -> None:
    strange = [
        can.Message(arbitration_id=NODE << 5 | 9, is_extended_id=True, data=bytes(8)),
        can.Message(arbitration_id=4 << 5 | 9, is_extended_id=False, data=struct.pack("<ff", 0.0, 99.0)),
        can.Message(arbitration_id=NODE << 5 | 9, is_extended_id=False, data=b"\x01"),
        can.Message(arbitration_id=NODE << 5 | 9, is_extended_id=False, data=struct.pack("<ff", 0.0, float("nan"))),
        can.Message(is_error_frame=True),
    ]
    assert {sample.pv for sample in samples_of(stage.run(20, strange))} == {0.0}


def test_commands_are_done_when_they_are_sent(stage: Stage) -> None:
    stage.host.send_setpoint(3.0, stage.now_s)
    assert CommandDone("setpoint") in stage.run(1)
    for refused in (lambda: stage.host.send_load(3.0, stage.now_s), lambda: stage.host.store(stage.now_s)):
        with pytest.raises(WriteRefusedError):
            refused()
    with pytest.raises(WriteRefusedError, match="switch it at the device"):
        stage.host.send_mode(auto=False, co=0.0, now_s=stage.now_s)


def test_the_mapping_is_of_the_loops_spans() -> None:
    config = parse_config(ODRIVE.format(accept=""))
    assert config.foreign_device is not None
    mapping = mapping_of(config, config.foreign_device)
    assert (mapping.pv_span, mapping.co_span) == (100.0, 200.0)
