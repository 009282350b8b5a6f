"""Controllers that could not be reached: no gains in the description, wide numbers, reads that a data frame asks for,
gains that a device lacks, telemetry that cannot come as fast as it is wanted."""

import struct
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from retuner.adaptive.signals.sample import LoopSample
from retuner.config.bench_plants import known_plant
from retuner.config.described import advice_only, foreign_settings, make_access
from retuner.config.loading import UnusableError, parse_config, parse_session, with_signals
from retuner.drivers.bus.link_settings import LinkSettings, LinkState
from retuner.drivers.canopen.eds_file import EdsFile, read_eds
from retuner.drivers.canopen.sdo_queue import SdoQueue, pace_s
from retuner.drivers.device import CommandDone, Event, SamplesLost, WriteDone, WriteRefusedError
from retuner.drivers.profiles.foreign_device import ForeignDevice, SampleGrid
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.schedule.gains import IdealGains, PidGains
from retuner.session.assembly import make_far_side

PROFILES = Path(__file__).parents[2] / "drivers" / "profiles"
LOOP = """schema = 1
loop = { name = "wheel", pv_unit = "rpm", pv_min = -1000.0, pv_max = 1000.0, co_min_pct = -100.0, sample_time_s = 0.05 }
schedule = { variable = "sp", region = [{ name = "all", kc = 0.02, tau_i_s = 1.0 }] }
bus = { node = 5 }
[device]
"""
PLANT = """
[device.plant]
kind = "linear"
k = 8.0
lags_s = [0.8]
theta_s = 0.1
start_pv = 100.0
start_co_pct = 20.0
"""
# of the kind of a balancing robot's base: speeds from one node, torques that another one wants, and no gains at all
BODY_DBC = """VERSION ""
BU_: Body Host
BO_ 529 WHEELS: 8 Body
 SG_ SPEED : 7|16@0- (1,0) [-1000|1000] "" Host
 SG_ COUNTER : 51|4@0+ (1,0) [0|15] "" Host
BO_ 608 TORQUE: 6 Host
 SG_ WANTED : 7|16@0- (1,0) [-1000|1000] "" Body
"""
BODY = """kind = "dbc"
dbc = "{dbc}"
pv = {{ message = "WHEELS", signal = "SPEED" }}
co = {{ message = "TORQUE", signal = "WANTED", scale = 0.1 }}
sp_start = 100.0
"""
# of the kind of a motor driver that is asked by a data frame: command 0x30 reads the gains, 0x31 writes them
DRIVER_DBC = """VERSION ""
BU_: Drive Host
BO_ 320 COMMAND: 8 Host
 SG_ CODE M : 0|8@1+ (1,0) [0|255] "" Drive
 SG_ KP_NEW m49 : 16|8@1+ (1,0) [0|255] "" Drive
 SG_ KI_NEW m49 : 24|8@1+ (1,0) [0|255] "" Drive
 SG_ UNUSED m48 : 8|8@1+ (1,0) [0|255] "" Drive
 SG_ NOTHING m156 : 8|8@1+ (1,0) [0|255] "" Drive
BO_ 576 REPLY: 8 Drive
 SG_ CODE M : 0|8@1+ (1,0) [0|255] "" Host
 SG_ KP m48 : 16|8@1+ (1,0) [0|255] "" Host
 SG_ KI m48 : 24|8@1+ (1,0) [0|255] "" Host
 SG_ CURRENT m156 : 16|16@1- (1,0) [-2048|2048] "" Host
 SG_ SPEED m156 : 32|16@1- (1,0) [-32768|32767] "" Host
"""
DRIVER = """kind = "dbc"
dbc = "{dbc}"
sp_start = 100.0
pv = {{ message = "REPLY", signal = "SPEED", ask = {{ message = "COMMAND", values = {{ CODE = 156 }} }} }}
[device.co]
message = "REPLY"
signal = "CURRENT"
scale = 0.1
ask = {{ message = "COMMAND", values = {{ CODE = 156 }} }}
[device.gains.kp]
message = "COMMAND"
signal = "KP_NEW"
scale = 0.001
read_message = "REPLY"
read_signal = "KP"
read_ask = {{ message = "COMMAND", values = {{ CODE = 48 }} }}
[device.gains.ki]
message = "COMMAND"
signal = "KI_NEW"
scale = 0.001
read_message = "REPLY"
read_signal = "KI"
read_ask = {{ message = "COMMAND", values = {{ CODE = 48 }} }}
"""


class Bench:
    """Host and virtual device of a configuration, a sample a turn; the device answers at once."""

    settings, state = LinkSettings(), LinkState.UP

    def __init__(self, text: str) -> None:
        self.config = parse_config(text)
        foreign, plant = self.config.foreign_device, known_plant(self.config)
        assert foreign is not None
        assert plant is not None
        self.device = make_far_side(self.config, plant)
        self.access = make_access(self.config, foreign)
        self.waiting: list[can.Message] = []
        self.sent: list[can.Message] = []
        told = foreign_settings(self.config, foreign, ScheduleInputs(), 1.0)
        self.host = ForeignDevice(self, self.access, told)
        self.now_s = 0.0

    def send(self, message: can.Message) -> bool:
        self.sent.append(message)
        self.waiting += self.device.receive(message)
        return True

    def note(self, message: can.Message) -> None:
        """Nothing is kept."""

    def receive_all(self) -> list[can.Message]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def run(self, samples: int, every: int = 1) -> Iterator[Event]:
        step_s = self.config.loop.sample_time_s
        for n in range(samples):
            self.now_s += step_s
            frames = self.device.step()
            self.waiting += frames if n % every == 0 else []
            yield from self.host.poll(self.now_s)


def written(folder: Path, dbc: str, device: str) -> str:
    path = folder / "device.dbc"
    path.write_text(dbc)
    return LOOP + device.format(dbc=path) + PLANT


def test_a_file_without_gains_is_watched_and_never_written(tmp_path: Path) -> None:
    text = written(tmp_path, BODY_DBC, BODY)
    bench = Bench(text)
    samples = [event for event in bench.run(40) if isinstance(event, LoopSample)]
    assert len(samples) > 30
    assert samples[-1].pv == pytest.approx(100.0, abs=1.0)
    assert samples[-1].co == pytest.approx(20.0, abs=0.1)
    assert bench.host.running.gains == bench.config.gains()[0]
    with pytest.raises(WriteRefusedError, match="its description has no gains"):
        bench.host.begin_write(PidGains(0.03, 0.03), bench.now_s)
    assert bench.sent == []
    assert "set them by hand" in advice_only(bench.config)


def test_what_it_stands_at_needs_no_place_for_a_setpoint(tmp_path: Path) -> None:
    bench = Bench(written(tmp_path, BODY_DBC, BODY))
    list(bench.run(5))
    bench.host.send_setpoint(100.0, bench.now_s)
    assert CommandDone("setpoint") in list(bench.run(1))
    with pytest.raises(WriteRefusedError, match="has no entry for setpoint"):
        bench.host.send_setpoint(120.0, bench.now_s)


def test_a_data_frame_asks_for_telemetry_and_gains(tmp_path: Path) -> None:
    bench = Bench(written(tmp_path, DRIVER_DBC, DRIVER))
    samples = [event for event in bench.run(40) if isinstance(event, LoopSample)]
    assert len(samples) > 30
    assert not any(message.is_remote_frame for message in bench.sent)
    assert {bytes(message.data)[0] for message in bench.sent} == {48, 156}
    assert bench.host.running.gains == PidGains(0.02, 0.02)
    bench.sent.clear()
    bench.host.begin_write(PidGains(0.031, 0.017), bench.now_s)
    (done,) = [event for event in bench.run(10) if isinstance(event, WriteDone)]
    assert done.gains == PidGains(0.031, 0.017)
    assert bytes([49, 0, 31, 17, 0, 0, 0, 0]) in {bytes(message.data) for message in bench.sent}
    bench.sent.clear()
    bench.device.receive = lambda _: []  # type: ignore[method-assign]
    for _ in range(40):  # polled often, as in real time, and not answered: one question a sample, not one a poll
        bench.now_s += bench.config.loop.sample_time_s / 4
        bench.host.poll(bench.now_s)
    assert 8 <= sum(message.data[0] == 156 for message in bench.sent) <= 14


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("CODE = 48", "KODE = 48"), "no signal 'KODE'; there is"),
        (("{ CODE = 48 }", "{ CODE = 480 }"), "COMMAND"),
        (('read_ask = {{ message = "COMMAND"', 'read_ask = {{ message = "COMAND"'), "no message 'COMAND'"),
    ],
)
def test_a_wrong_question_is_told_by_its_key(tmp_path: Path, change: tuple[str, str], told: str) -> None:
    text = written(tmp_path, DRIVER_DBC, DRIVER.replace(*change))
    with pytest.raises(UnusableError) as wrong:
        with_signals(parse_session(text), text)
    assert told in wrong.value.findings[0].message
    assert wrong.value.findings[0].key.startswith("device.gains.kp")


def real64(folder: Path) -> Path:
    """The EDS of CiA 404 with numbers of 8 bytes, of which no PDO carries two: telemetry is read by SDO."""
    text = (PROFILES / "cia404.eds").read_text().replace("DataType=0x0008", "DataType=0x0011")
    path = folder / "wide.eds"
    path.write_text(text.replace("DefaultValue=$NODEID+0x180", "DefaultValue=$NODEID+0x80000180"))
    return path


WIDE = """profile = "cia404"
kind = "canopen"
eds = "{eds}"
"""


def test_numbers_of_8_bytes_go_and_come_in_segments(tmp_path: Path) -> None:
    text = LOOP + WIDE.format(eds=real64(tmp_path)) + "gains = { kd = false, tv = false }\n" + PLANT
    bench = Bench(text.replace("kc = 0.02", "kc = 0.020000000123"))
    samples = [event for event in bench.run(60) if isinstance(event, LoopSample)]
    assert len(samples) > 40
    assert bench.host.running.gains.kp == pytest.approx(0.020000000123, rel=1e-14)  # a float32 holds 7 digits of it
    bench.host.choose_way = lambda *_: (1, 0)
    new = IdealGains(0.031, 0.7).to_parallel()
    bench.host.begin_write(new, bench.now_s)
    (done,) = [event for event in bench.run(30) if isinstance(event, WriteDone)]
    assert done.gains.kp == pytest.approx(new.kp, rel=1e-14)
    assert done.gains.ki == pytest.approx(new.ki, rel=1e-14)
    segments = [m for m in bench.sent if m.arbitration_id == 0x605 and m.data[0] & 0xE0 == 0x00]
    assert len(segments) == 4  # 8 bytes are a segment of 7 and one of 1, for each of two gains
    assert segments[0].data[1:8] == struct.pack("<d", new.kp and 0.7)[:7]


def test_an_answer_that_is_taken_late_is_gone_on_with(tmp_path: Path) -> None:
    """In simulated time it is taken a sample later: a setpoint of 8 bytes began, and never went on."""
    variable = EdsFile(read_eds(real64(tmp_path), 5), "wide.eds", 5).variable("6402:1", (), read=False)
    queue = SdoQueue(5, reply_s=0.02)
    queue.ask("setpoint", variable, struct.pack("<d", 150.0))
    (begin,) = queue.due(1.0)
    queue.take(can.Message(arbitration_id=0x585, data=b"\x60" + begin.data[1:4] + bytes(4)))
    (segment,) = queue.due(2.0)
    assert segment.data[1:8] == struct.pack("<d", 150.0)[:7]


@pytest.mark.parametrize("gone", ["tv = false", 'without = ["tv"]'])
def test_a_gain_that_the_device_lacks_is_taken_out_of_the_profile(gone: str) -> None:
    config = parse_config(LOOP + f'kind = "canopen"\nprofile = "cia404"\ngains = {{ {gone} }}\n' + PLANT)
    foreign = config.foreign_device
    assert foreign is not None
    assert make_access(config, foreign).units.names == ("xp", "tn")


def test_check_says_which_line_takes_a_gain_away(tmp_path: Path) -> None:
    eds = (PROFILES / "cia404.eds").read_text().replace("[6454", "[6464")
    (tmp_path / "its.eds").write_text(eds)
    text = LOOP + WIDE.format(eds=tmp_path / "its.eds") + PLANT
    with pytest.raises(UnusableError) as wrong:
        with_signals(parse_session(text), text)
    assert "if the device has no such gain: tv = false under [device.gains]" in wrong.value.findings[0].message


def test_how_fast_sdo_can_be_asked_is_worked_out(tmp_path: Path) -> None:
    config = parse_config(LOOP + WIDE.format(eds=real64(tmp_path)) + PLANT)
    foreign = config.foreign_device
    assert foreign is not None
    access = make_access(config, foreign)
    wire_s, whole_s = pace_s([access._read[name].variable for name in ("pv", "co")])  # type: ignore[attr-defined]
    assert wire_s == pytest.approx(2 * 3 * 2 * 135 / 500e3)  # two numbers, three exchanges each, two frames an exchange
    assert whole_s == pytest.approx(wire_s + 2 * 3 * 5e-3)
    told = access.polled(0.01)  # type: ignore[attr-defined]
    assert "co, mode, pv: read by SDO for each sample" in told
    assert "sample_time_s = 0.01 s is shorter: map them into a PDO, or sample more slowly" in told
    assert "shorter" not in access.polled(1.0)  # type: ignore[attr-defined]


def test_a_lost_half_of_all_samples_is_named_once(tmp_path: Path) -> None:
    bench = Bench(written(tmp_path, BODY_DBC, BODY))
    lost = [event for event in bench.run(80, every=2) if isinstance(event, SamplesLost)]
    (named,) = [event.reason for event in lost if event.reason]
    assert named.startswith("half of all samples are lost: one comes every 0.1 s, sample_time_s is 0.05 s")
    assert lost.index(next(event for event in lost if event.reason)) <= 8  # within 16 samples
    grid = SampleGrid(1.0)
    assert all(grid.place(float(n)) is not None and not grid.half_lost() for n in range(60))
