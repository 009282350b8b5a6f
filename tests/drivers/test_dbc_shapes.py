"""DBCs of other shapes than the ODrive's: big-endian, multiplexed, extended, doubled names, guarded, damaged."""

import itertools
import struct
from collections.abc import Sequence
from pathlib import Path

import can
import pytest
from answering_wire import Wire

from retuner import LinearProcess, LoopMode, LoopSample, PidGains
from retuner.config.described import foreign_settings, make_access, mapping_of
from retuner.config.loading import parse_config
from retuner.drivers.dbc.dbc_access import DbcAccess
from retuner.drivers.dbc.dbc_file import DbcFile, carried, defaults, read_dbc_file
from retuner.drivers.dbc.frame_guard import ALGORITHMS
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
from retuner.drivers.profiles.controller_access import Heard, ProfileError
from retuner.drivers.profiles.foreign_device import ForeignDevice
from retuner.drivers.profiles.mapping import DeviceMapping, GainAt, Protection, SignalOf
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.schedule.pid import law, start, step
from retuner.schedule.vendor_units import Quantity

DBC = """VERSION ""
NS_ :
BS_:
BU_: host drive
BO_ 2566844929 Motion: 8 drive
 SG_ Speed : 7|16@0- (0.001,0) [-30|30] "" host
 SG_ Current : 23|16@0- (0.01,5) [0|0] "A" host

BO_ 2566844930 Parameter: 8 host
 SG_ Id M : 0|8@1+ (1,0) [0|0] "" drive
 SG_ P m1 : 8|16@1+ (0.001,0) [0|10] "" drive
 SG_ I m2 : 8|32@1- (1,0) [0|0] "" drive
 SG_ D m3 : 15|16@0+ (0.5,0) [0|0] "" drive

BO_ 2566844931 Report: 8 drive
 SG_ Id M : 0|8@1+ (1,0) [0|0] "" host
 SG_ P m1 : 8|16@1+ (0.001,0) [0|10] "" host
 SG_ I m2 : 8|32@1- (1,0) [0|0] "" host
 SG_ D m3 : 15|16@0+ (0.5,0) [0|0] "" host

BO_ 300 Target: 8 host
 SG_ Speed : 0|16@1- (0.001,0) [-30|30] "" drive
 SG_ Enable : 16|1@1+ (1,0) [0|1] "" drive
 SG_ Count : 52|4@1+ (1,0) [0|15] "" drive
 SG_ Crc : 56|8@1+ (1,0) [0|255] "" drive

BO_ 301 Twin: 8 drive
 SG_ A : 0|8@1+ (1,0) [0|0] "" host

BO_ 302 Twin: 8 drive
 SG_ A : 0|8@1+ (1,0) [0|0] "" host

BO_ 303 Broken: 2 drive
 SG_ A : 0|16@1+ (1,0) [0|0] "" host
 SG_ B : 8|16@1+ (1,0) [0|0] "" host

SIG_VALTYPE_ 2566844930 I : 1;
SIG_VALTYPE_ 2566844931 I : 1;
"""
SPEED, CURRENT = SignalOf("Motion", "Speed"), SignalOf("Motion", "Current", 2.0)
EXTENDED = 2566844929 & 0x1FFFFFFF


def gain(quantity: Quantity, name: str) -> GainAt:
    return GainAt(quantity, SignalOf("Parameter", name), SignalOf("Report", name), 1.0)


MAPPING = DeviceMapping(
    SPEED,
    CURRENT,
    (gain(Quantity.KP, "P"), gain(Quantity.KI, "I"), gain(Quantity.KD, "D")),
    setpoint=SignalOf("Target", "Speed"),
    protected=(Protection("Target", "Count", "Crc", "crc8_sae_j1850", 0x1234),),
    fixed={"Target.Enable": 1.0},
)


@pytest.fixture
def file(tmp_path: Path) -> DbcFile:
    path = tmp_path / "drive.dbc"
    path.write_text(DBC)
    return DbcFile(read_dbc_file(path), path.name)


def sent(access: DbcAccess) -> list[can.Message]:
    return list(access.due(0.0))


def test_big_endian_scaled_and_offset_numbers_of_an_extended_message(file: DbcFile) -> None:
    access = DbcAccess(file, MAPPING)
    data = struct.pack(">hh", -1234, 300) + bytes(4)
    told = access.take(can.Message(arbitration_id=EXTENDED, is_extended_id=True, data=data))
    heard = {one.name: one.value for one in told if isinstance(one, Heard)}
    assert heard == {"pv": pytest.approx(-1.234), "co": pytest.approx(2.0 * (3.0 + 5.0))}
    assert access.take(can.Message(arbitration_id=EXTENDED & 0x7FF, is_extended_id=False, data=data)) == ()


def test_multiplexed_gains_are_a_message_each_with_their_selector(file: DbcFile) -> None:
    access = DbcAccess(file, MAPPING)
    assert not access.units.atomic
    numbers = access.units.numbers(PidGains(1.23449, 0.1, 7.3))
    assert numbers == {"kp": pytest.approx(1.234), "ki": struct.unpack("<f", struct.pack("<f", 0.1))[0], "kd": 7.5}
    access.put(numbers)
    p, i, d = sent(access)
    assert p.data[0] == 1
    assert struct.unpack_from("<H", p.data, 1)[0] == 1234
    assert i.data[0] == 2
    assert struct.unpack_from("<f", i.data, 1)[0] == numbers["ki"]
    assert d.data[0] == 3
    assert struct.unpack_from(">H", d.data, 1)[0] == 15
    assert all(message.is_extended_id for message in (p, i, d))


def test_read_back_is_what_was_written_bit_for_bit(file: DbcFile) -> None:
    access = DbcAccess(file, MAPPING)
    numbers = access.units.numbers(PidGains(1.23449, 0.1, 7.3))
    access.put(numbers)
    read: dict[str, float] = {}
    for message in sent(access):
        report = can.Message(arbitration_id=EXTENDED + 2, is_extended_id=True, data=message.data)
        read |= {one.name: one.value for one in access.take(report) if isinstance(one, Heard)}
    assert read == numbers


def test_a_guarded_message_counts_and_carries_its_checksum(file: DbcFile) -> None:
    access = DbcAccess(file, MAPPING)
    frames = []
    for _ in range(17):
        access.put({"setpoint": 2.5})
        frames += sent(access)
    assert [frame.data[6] >> 4 for frame in frames] == [*range(16), 0]
    for frame in frames:
        assert struct.unpack_from("<hB", frame.data)[:2] == (2500, 1)
        assert frame.data[7] == ALGORITHMS["crc8_sae_j1850"](bytes(frame.data[:7]) + b"\x34\x12")


def test_numbers_out_of_the_dbcs_range_are_refused(file: DbcFile) -> None:
    access = DbcAccess(file, MAPPING)
    with pytest.raises(ValueError, match="setpoint: 31 is outside -30 to 30"):
        access.put({"setpoint": 31.0})
    with pytest.raises(ValueError, match="kp: 11 is outside 0 to 10"):
        access.units.numbers(PidGains(11.0, 0.1))


@pytest.mark.parametrize(
    ("name", "check"),
    [
        ("crc8", 0xF4),
        ("crc8_sae_j1850", 0x4B),
        ("crc8_autosar", 0xDF),
        ("crc16_ccitt", 0x29B1),
        ("crc16_xmodem", 0x31C3),
        ("sum8", 0xDD),
        ("xor8", 0x31),
    ],
)
def test_checksums_have_their_catalogued_check_values(name: str, check: int) -> None:
    assert ALGORITHMS[name](b"123456789") == check


WRONG = [
    (SignalOf("Twin", "A"), r"2 messages 'Twin'; name one by its identifier: 0x12d, 0x12e"),
    (SignalOf("Broken", "A"), "drive.dbc: The signal B does not fit in message Broken"),
    (SignalOf("0x7FF", "A"), "no message '0x7FF'"),
    (SignalOf("Motion", "speed"), "has no signal 'speed'; there is Speed, Current"),
]


@pytest.mark.parametrize(("at", "told"), WRONG)
def test_what_cannot_be_found_is_told(file: DbcFile, at: SignalOf, told: str) -> None:
    with pytest.raises(ProfileError, match=told):
        DbcAccess(file, DeviceMapping(at, CURRENT, MAPPING.gains))


# Shapes that are found in files of others (cantools' own tests, opendbc); each of these once ended in a traceback.
ODD = """VERSION ""
NS_ :
BS_:
BU_: host drive
BO_ 10 Paged: 8 drive
 SG_ Page M : 0|8@1+ (1,0) [0|50] "" host
 SG_ Always : 8|16@1+ (1,0) [0|0] "" host
 SG_ Some m8 : 24|16@1+ (1,0) [0|0] "" host

BO_ 11 Shifted: 8 host
 SG_ Far : 7|8@0+ (1,100) [0|0] "" drive
 SG_ Low : 15|8@0+ (1,0) [-5|300] "" drive
 SG_ Target : 23|16@0- (0.000095875,0) [-3.1416|3.13964] "" drive
"""


@pytest.fixture
def odd(tmp_path: Path) -> DbcFile:
    (tmp_path / "odd.dbc").write_text(ODD)
    return DbcFile(read_dbc_file(tmp_path / "odd.dbc"), "odd.dbc")


def test_a_number_is_not_what_says_which_signals_there_are(odd: DbcFile) -> None:
    with pytest.raises(ProfileError, match="says which signals message 'Paged' carries"):
        odd.place("Paged", "Page", ("co",))
    assert odd.signal("Paged", "Page", ("fixed",)).signal.is_multiplexer


def test_a_message_with_pages_is_sent_with_one_that_there_is(odd: DbcFile) -> None:
    layout = odd.layout("Paged", ())
    assert defaults(layout, None, {}) == {"Page": 8.0, "Always": 0.0, "Some": 0.0}
    assert layout.encode(defaults(layout, None, {}))[0] == 8
    assert defaults(layout, None, {"Paged.Page": 3.0}) == {"Page": 3.0, "Always": 0.0}


def test_what_is_not_written_stays_inside_its_bits(odd: DbcFile) -> None:
    layout = odd.layout("Shifted", ())
    assert defaults(layout, None, {})["Far"] == 100.0
    layout.encode(defaults(layout, None, {}))  # 0 of Far would be a negative number in its bits
    assert carried(layout.get_signal_by_name("Low")) == (0.0, 255.0)


def test_an_end_that_lies_between_two_steps_can_be_written(odd: DbcFile) -> None:
    holds = odd.place("Shifted", "Target", ()).holds()
    assert 3.1395 < holds.nearest(3.13964) <= 3.13964
    assert -3.1416 <= holds.nearest(-3.1416) < -3.1415
    with pytest.raises(ValueError, match="outside"):
        holds.nearest(3.1398)


def test_a_doubled_name_is_found_by_its_identifier(file: DbcFile) -> None:
    access = DbcAccess(file, DeviceMapping(SignalOf("0x12e", "A"), CURRENT, MAPPING.gains))
    told = access.take(can.Message(arbitration_id=302, is_extended_id=False, data=b"\7" * 8))
    assert Heard("pv", 7.0) in told


def test_a_checksum_that_cannot_be_is_refused(file: DbcFile) -> None:
    for algorithm, told in (("crc99", "no algorithm 'crc99'; there is sum8"), ("crc16_ccitt", "needs 16 that begin")):
        mapping = DeviceMapping(
            SPEED, CURRENT, MAPPING.gains, protected=(Protection("Target", "Count", "Crc", algorithm),)
        )
        with pytest.raises(ProfileError, match=told):
            DbcAccess(file, mapping)


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"\x00\xff" * 500,
        b"hello",
        DBC[: len(DBC) // 2].encode(),
        DBC.replace("SG_", "SG").encode(),
        DBC.replace("7|16", "7|999").encode(),
        DBC.replace("(0.001,0)", "(0,0)").encode(),
        DBC.replace("(0.001,0)", "(1e999,0)").encode(),
        DBC.replace("BO_ 2566844929", "BO_ -3").encode(),
    ],
)
def test_a_damaged_dbc_is_one_line_or_works(damage: bytes, tmp_path: Path) -> None:
    path = tmp_path / "damaged.dbc"
    path.write_bytes(damage)
    told = ""
    try:
        access = DbcAccess(DbcFile(read_dbc_file(path), path.name), MAPPING)
        access.put({"setpoint": 1.0})
    except ProfileError as error:
        told = str(error)
    assert "\n" not in told
    assert told.startswith((str(path), "damaged.dbc: ")) or DBC.encode()[:3000] == damage[:3000]


# A controller behind its DBC, against an ODrive that knows nothing of DBCs: bytes by struct, as in its manual.


NODE, SAMPLE_S = 3, 0.02
ODRIVE = """
schema = 1
loop = {{ name = "axis", pv_unit = "rev/s", pv_min = -50.0, pv_max = 50.0, co_min_pct = -100.0, sample_time_s = 0.02 }}
schedule = {{ region = [{{ name = "all", kc = 1.0, tau_i_s = 2.0 }}] }}
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
def test_silence_in_the_middle_of_a_write_without_read_back_ends_with_the_set_sent_again(stage, before):
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
    with pytest.raises(DeviceSilentError, match="within 5 s of the loop's time; is the device running there"):
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
