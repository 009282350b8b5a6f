"""Telemetry to samples: wrap, loss, repetition, order, stray halves and restarts."""

import math
import random
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner import LoopSample, PidGains
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.device import DeviceRestarted, VariableChanged
from retuner.drivers.host.page_reader import ReadBack
from retuner.drivers.host.running_set import ALONE, DISPROVED_MAX, Belief, RunningBelief
from retuner.drivers.protocol.checksum import page_crc, sample_crc, set_crc
from retuner.drivers.protocol.codec import DbcError
from retuner.drivers.protocol.frames import Heartbeat, Page, TelemetryPv, TelemetrySp
from retuner.drivers.recorded.frame_log import READING_ERRORS, SUFFIXES, Overhearing, read_frames
from retuner.drivers.recorded.recording import RecordingError
from retuner.drivers.recorded.sample_note import Notes, note_id, note_of, sample_of
from retuner.drivers.telemetry.device_counter import Said
from retuner.drivers.telemetry.sample_assembly import AssembledSample, SampleJoiner
from retuner.drivers.telemetry.signal_source import ScheduleInputs, SignalTap, find_signal, plant_message


def halves(number: int, revision: int = 1) -> tuple[TelemetryPv, TelemetrySp]:
    pv = TelemetryPv(number % 256, float(number), 50.0)
    sp = TelemetrySp(number % 256, 7.0, 1, 0, revision, 0)
    return pv, replace(sp, crc=sample_crc(1, pv, sp))


def feed(joiner: SampleJoiner, number: int) -> list[AssembledSample]:
    return [joined for half in halves(number) if (joined := joiner.take(half)) is not None]


def test_nothing_before_the_first_reference() -> None:
    joiner = SampleJoiner(2.0)
    assert feed(joiner, 3) == []
    joiner.set_reference(3)
    assert [j.sample.t_s for j in feed(joiner, 4)] == [8.0]


def test_counter_wraps() -> None:
    joiner = SampleJoiner(0.5)
    joiner.set_reference(250)
    got = []
    for n in range(251, 2000):
        got += feed(joiner, n)
        if n % 100 == 0:
            joiner.set_reference(n)
    assert [j.sample.t_s for j in got] == [0.5 * n for n in range(251, 2000)]
    assert [j.sample.pv for j in got] == [float(n) for n in range(251, 2000)]
    assert {j.lost for j in got} == {0}


@pytest.mark.uncounted
@given(seed=st.integers(0, 10**6), loss=st.floats(0.0, 0.6))
@settings(max_examples=examples(100))
def test_whatever_arrives_the_samples_are_true_and_the_loss_is_counted(seed: int, loss: float) -> None:
    rng = random.Random(seed)
    joiner = SampleJoiner(1.0)
    joiner.set_reference(0)
    arriving = [
        (2 * n + i + rng.choice((0, 0, 0, 3, 7)), rng.random(), half)
        for n in range(1, 600)
        for i, half in enumerate([*halves(n), *([n] if n % 5 == 0 else [])])
        for _ in range(rng.choices((0, 1, 2), (loss, 1 - loss, 0.1))[0])
    ]
    got = []
    for _, _, arrived in sorted(arriving, key=lambda a: a[:2]):
        if isinstance(arrived, int):
            joiner.set_reference(arrived)
        elif (joined := joiner.take(arrived)) is not None:
            got.append(joined)
    numbers = [round(j.sample.t_s) for j in got]

    assert all(j.sample.pv == j.sample.t_s for j in got)
    assert numbers == sorted(set(numbers))
    assert sum(j.lost for j in got[1:]) == numbers[-1] - numbers[0] - (len(numbers) - 1)


def test_a_stray_half_is_not_joined_with_a_later_sample() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1)
    joiner.take(halves(60, revision=9)[1])
    got = [j for n in range(2, 80) for j in feed(joiner, n)]
    assert {j.sample.revision for j in got} == {1}
    assert len(got) == 78


def test_a_stray_sample_further_ahead_than_the_heartbeats_have_said_counts_for_nothing() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1)
    feed(joiner, 2)
    assert feed(joiner, 102) == []
    got = [j for n in range(3, 30) for j in feed(joiner, n)]
    assert [(j.sample.t_s, j.lost) for j in got] == [(float(n), 0) for n in range(3, 30)]


def test_heartbeats_that_stay_away_end_the_telemetry_until_the_next_one() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1)
    assert [j.sample.t_s for n in range(2, 900) for j in feed(joiner, n)] == [float(n) for n in range(2, 102)]
    joiner.set_reference(900)  # far ahead: the next one has to agree
    assert feed(joiner, 901) == []
    joiner.set_reference(905)
    (joined,) = feed(joiner, 906)
    assert (joined.sample.t_s, joined.lost) == (906.0, 906 - 102)


def test_one_heartbeat_far_ahead_or_behind_moves_nothing() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1000)
    said = []
    for n in range(1001, 1060):
        said += [joiner.set_reference(stray) for stray in (70_000 + n, 3) if n % 7 == 0]
        (joined,) = feed(joiner, n)
        assert (joined.sample.t_s, joined.lost) == (n, 0)
        if n % 5 == 0:
            said.append(joiner.set_reference(n))
    assert Said.CONTRADICTS in said


def test_contact_lost_for_longer_than_the_counter_needs_a_new_reference() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1)
    feed(joiner, 2)
    joiner.forget()
    assert feed(joiner, 1000) == []
    joiner.set_reference(1000)
    (joined,) = feed(joiner, 1001)
    assert (joined.sample.t_s, joined.lost) == (1001.0, 998)


def test_time_goes_on_over_a_restart() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(500)
    feed(joiner, 501)
    joiner.restart(3, 20)
    (joined,) = feed(joiner, 4)
    assert (joined.sample.t_s, joined.lost) == (522.0, 1)


def test_an_unknown_variable_is_refused() -> None:
    with pytest.raises(ValueError, match='variable = "mv"; give'):
        SampleJoiner(1.0, "mv")


# ---- A scheduling variable from another signal on the bus: found in its DBC, the last value, unknown when it is
# stale

FOREIGN = """VERSION ""
BU_: Meter
BO_ 1000 FLOW_METER: 4 Meter
 SG_ flow : 0|16@1+ (0.1,-10) [0|200] "l/min" Meter
 SG_ temp : 23|16@0- (0.01,0) [0|0] "degC" Meter
BO_ 1001 MUXED: 3 Meter
 SG_ page M : 0|8@1+ (1,0) [0|0] "" Meter
 SG_ one m1 : 8|16@1+ (1,0) [0|0] "" Meter
 SG_ two m2 : 8|16@1+ (1,0) [0|0] "" Meter
"""


@pytest.fixture
def dbc(tmp_path: Path) -> str:
    path = tmp_path / "meter.dbc"
    path.write_text(FOREIGN)
    return str(path)


def frame(raw: int, temp: int = 0, id_: int = 1000, **how: bool) -> can.Message:
    return can.Message(
        arbitration_id=id_, is_extended_id=False, data=struct.pack("<H", raw) + struct.pack(">h", temp), **how
    )


def tapped(dbc: str, signal: str = "flow", message: str = "FLOW_METER", stale_after_s: float = 5.0) -> SignalTap:
    return SignalTap((None, find_signal(dbc, message, signal, stale_after_s)))


def x2_at(tap: SignalTap, t_s: float) -> float:
    filled = tap.fill(LoopSample(t_s, 1.0, 2.0, 3.0, x=4.0))
    assert filled[:7] == (t_s, 1.0, 2.0, 3.0, 1, 0, 4.0)
    return filled.x2


def test_the_value_is_scaled_and_kept_until_the_next(dbc: str) -> None:
    tap = tapped(dbc)
    assert math.isnan(x2_at(tap, 0.0))
    assert tap.take(frame(600))
    assert [x2_at(tap, t) for t in (1.0, 2.0)] == [50.0, 50.0]
    tap.take(frame(700))
    assert x2_at(tap, 3.0) == 60.0
    assert tap.news() == []
    big_endian = tapped(dbc, "temp")
    big_endian.take(frame(0, -1234))
    assert x2_at(big_endian, 0.0) == pytest.approx(-12.34)


def test_stale_is_unknown_and_told_once_each_way(dbc: str) -> None:
    tap = tapped(dbc)
    tap.take(frame(600))
    assert [math.isnan(x2_at(tap, float(t))) for t in range(8)] == [False] * 6 + [True] * 2
    told = tap.news()
    assert [(n.name, n.known) for n in told] == [("FLOW_METER.flow", False)]
    assert told[0].reason == "silent for more than 5 s; the region stays, and its model is not updated until then"
    tap.take(frame(610))
    assert x2_at(tap, 8.0) == 51.0
    assert tap.news() == [VariableChanged("FLOW_METER.flow", known=True, reason="heard again")]
    assert tap.news() == []


def test_never_heard_is_unknown_at_once_and_told_when_it_is_late(dbc: str) -> None:
    tap = tapped(dbc)
    assert all(math.isnan(x2_at(tap, t)) for t in (100.0, 105.0))
    assert tap.news() == []
    x2_at(tap, 105.5)
    assert "never heard for more than 5 s" in tap.news()[0].reason


@pytest.mark.parametrize(
    "damaged",
    [
        frame(65535),  # 6543 l/min is beyond the DBC's range
        frame(0),  # -10
        can.Message(arbitration_id=1000, is_extended_id=False, data=b"\x01"),
        can.Message(arbitration_id=1000, is_extended_id=False, data=b""),
    ],
)
def test_what_is_no_value_changes_nothing(dbc: str, damaged: can.Message) -> None:
    tap = tapped(dbc)
    tap.take(frame(600))
    x2_at(tap, 0.0)
    for t in range(1, 9):
        tap.take(damaged)
        x2 = x2_at(tap, float(t))
        assert x2 == 50.0 if t <= 5 else math.isnan(x2)


@pytest.mark.parametrize(
    "other",
    [
        frame(600, id_=999),
        can.Message(arbitration_id=1000, is_extended_id=True, data=bytes(4)),
        can.Message(arbitration_id=1000, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(arbitration_id=1000, is_extended_id=False, is_error_frame=True, data=bytes(4)),
    ],
)
def test_other_frames_are_not_taken(dbc: str, other: can.Message) -> None:
    tap = tapped(dbc)
    assert not tap.take(other)
    assert math.isnan(x2_at(tap, 0.0))


def test_a_multiplexed_signal_counts_when_it_is_there(dbc: str) -> None:
    tap = tapped(dbc, "two", "MUXED")
    tap.take(can.Message(arbitration_id=1001, is_extended_id=False, data=struct.pack("<BH", 1, 7)))
    assert math.isnan(x2_at(tap, 0.0))
    tap.take(can.Message(arbitration_id=1001, is_extended_id=False, data=struct.pack("<BH", 2, 9)))
    assert x2_at(tap, 1.0) == 9.0


@settings(max_examples=examples(50))
@given(st.binary(max_size=8), st.integers(0, 0x7FF) | st.just(1000))
def test_any_frame_gives_a_finite_value_or_none(data: bytes, id_: int) -> None:
    tap = SignalTap((find_signal("", "PLANT", "aux", 5.0), None))
    tap.take(can.Message(arbitration_id=id_, is_extended_id=False, data=data))
    tap.take(can.Message(arbitration_id=65537, is_extended_id=True, data=data))
    x = tap.fill(LoopSample(0.0, 0.0, 0.0, 0.0)).x
    assert not math.isinf(x)


@given(st.floats(-1e9, 1e9, width=32), st.integers(1, 63))
def test_the_virtual_devices_own_signal(aux: float, node: int) -> None:
    tap = SignalTap((find_signal("", "PLANT", "aux", 5.0, node),))
    assert tap.take(plant_message(node, aux))
    assert not tap.take(plant_message(node % 63 + 1, 1.0))
    assert tap.fill(LoopSample(0.0, 0.0, 0.0, 0.0)).x == aux


@pytest.mark.parametrize(
    ("message", "signal", "told"),
    [
        ("FLOW", "flow", "no message 'FLOW'; there is FLOW_METER, MUXED"),
        ("FLOW_METER", "level", "message 'FLOW_METER' has no signal 'level'; there is flow, temp"),
    ],
)
def test_what_a_dbc_has_not_is_named(dbc: str, message: str, signal: str, told: str) -> None:
    with pytest.raises(DbcError, match=told):
        find_signal(dbc, message, signal, 5.0)


def test_files_that_are_no_dbc(tmp_path: Path) -> None:
    with pytest.raises(DbcError, match="cannot be read: No such file"):
        find_signal(str(tmp_path / "none.dbc"), "A", "b", 5.0)
    (tmp_path / "x.dbc").write_bytes(b"\x00\xffgarbage")
    with pytest.raises(DbcError, match="cannot be used as a DBC"):
        find_signal(str(tmp_path / "x.dbc"), "A", "b", 5.0)
    with pytest.raises(ValueError, match="stale_after_s = 0"):
        find_signal("", "PLANT", "aux", 0.0)


def test_inputs_that_do_not_go_together() -> None:
    source = find_signal("", "PLANT", "aux", 5.0)
    for wrong in (("can", ""), ("", "sp"), ("pw", ""), ("sp", "can")):
        with pytest.raises(ValueError, match="variable"):
            ScheduleInputs(*wrong)
    with pytest.raises(ValueError, match="only with it"):
        ScheduleInputs("sp", "", (source,))
    with pytest.raises(ValueError, match='variable = "can"'):
        SampleJoiner(1.0, "can")
    assert ScheduleInputs("sp", "can", (None, source)).signals[1] is source


# Notes of samples in a bus log: the same sample again, to the last digit, and only of the loop that is asked for.


NUMBERS = st.floats(allow_nan=False)
SAMPLES = st.builds(
    LoopSample, NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.integers(0, 1), st.integers(-1, 1), NUMBERS,
    st.integers(0, 65535), NUMBERS,
)  # fmt: skip


def sent(message: can.Message) -> can.Message:
    message.is_rx = False
    return message


@given(SAMPLES)
def test_a_note_is_the_sample(sample: LoopSample) -> None:
    assert sample_of(sent(note_of(sample, note_id("a"))), note_id("a")) == sample


def test_a_note_is_of_one_loop_and_was_never_received() -> None:
    note = note_of(LoopSample(1.0, 2.0, 3.0, 4.0), note_id("a"))
    assert sample_of(sent(note), note_id("b")) is None
    assert Notes("b").take(note) is None
    note.is_rx = True
    assert sample_of(note, note_id("a")) is None  # somebody on the bus says so


def test_frames_of_another_form_are_no_notes() -> None:
    short = can.Message(arbitration_id=note_id("a"), is_extended_id=True, is_fd=True, data=bytes(48), is_rx=False)
    classic = can.Message(arbitration_id=note_id("a"), is_extended_id=True, data=bytes(8), is_rx=False)
    assert sample_of(short, note_id("a")) is sample_of(classic, note_id("a")) is None


def test_a_note_goes_through_a_log_and_not_over_the_bus(tmp_path: Path) -> None:
    sample = LoopSample(0.1 + 0.2, 1 / 3, -2.5e-7, 99.9, 0, -1, float("inf"), 65535, 7.0)
    settings, clock = LinkSettings(channel="notes"), SimulatedClock()
    with can.Bus(interface="virtual", channel="notes") as ear, CanLink(settings, clock, tmp_path / "bus.blf") as link:
        link.note(note_of(sample, note_id("a")))
        assert ear.recv(0.0) is None
    with CanLink(settings, clock) as link:
        link.note(note_of(sample, note_id("a")))  # no log: nothing to do
    (read,) = (Notes("a").take(message) for message in read_frames(tmp_path / "bus.blf"))
    assert read.sample == sample


# The log of a host, overheard, gives the samples that the host had: bit for bit, through loss, restart and writes


def read(log: Path) -> tuple[int, str]:
    """Frames that could be read, and what was told at the end."""
    count = 0
    try:
        for _ in read_frames(log):
            count += 1
    except RecordingError as error:
        return count, str(error)
    return count, ""


def overheard(log: Path, lost_contact_after: tuple[int, ...] = (), *, as_host: bool = True) -> list[LoopSample]:
    """Samples of a log; contact was lost after these numbers of them."""
    heard = Overhearing(1, 1.0, "pv", as_host=as_host)
    samples: list[LoopSample] = []
    for message in read_frames(log):
        joined = heard.take(message)
        if joined is not None:
            samples.append(joined.sample)
            if len(samples) in lost_contact_after:
                heard.contact_lost()
    return samples


@pytest.fixture
def logged(make_bench: Callable[..., Any], tmp_path: Path) -> Callable[[], tuple[Any, Path]]:
    """A bench with a log whose host schedules by pv."""
    from retuner.drivers.host.can_settings import CanDeviceSettings

    log = tmp_path / "bus.blf"
    return lambda: (
        make_bench(log=log, host=CanDeviceSettings(sample_time_s=1.0, variable="pv"), sample_time_s=1.0),
        log,
    )


def test_the_samples_are_those_of_the_host_bit_for_bit(logged) -> None:
    bench, log = logged()
    bench.run(40)
    bench.host.send_setpoint(60.0, bench.now_s)
    bench.run(300)
    bench.host.begin_write(PidGains(1.5, 0.125, 0.75), bench.now_s)
    bench.run(60)
    live = bench.samples(bench.events)
    bench.close()
    again = overheard(log)
    assert again == live
    assert len(again) > 390
    assert {sample.revision for sample in again} == {0, 1}


def test_a_restart_and_lost_frames_change_nothing_in_that(logged) -> None:
    bench, log = logged()
    bench.run(40)
    bench.silence(3)
    bench.run(20)
    bench.device.restart()
    bench.run(200)
    live = bench.samples(bench.events)
    bench.close()
    assert overheard(log) == live


def test_the_gap_at_a_restart_is_the_hosts_where_it_is_known(logged) -> None:
    """A host whose clock runs faster than the log's stamps measures other gaps than the stamps show."""
    bench, log = logged()
    bench.run(40)
    bench.silence(7)
    bench.device.restart()
    bench.run(100)
    gaps = [event.gap for event in bench.events if isinstance(event, DeviceRestarted)]
    live = bench.samples(bench.events)
    bench.close()
    assert len(gaps) == 1

    def faster(heard: Overhearing) -> list[LoopSample]:
        samples = []
        for message in read_frames(log):
            message.timestamp /= 50.0
            joined = heard.take(message)
            samples += [joined.sample] if joined else []
        return samples

    assert faster(Overhearing(1, 1.0, "pv", gaps=gaps)) == live
    assert faster(Overhearing(1, 1.0, "pv")) != live


def test_where_contact_was_lost_the_host_began_anew(logged) -> None:
    bench, log = logged()
    bench.run(30)
    before = len(bench.samples(bench.events))
    bench.silence(60)
    assert not bench.host.connected
    bench.run(60)
    live = bench.samples(bench.events)
    bench.close()
    assert overheard(log, (before,)) == live
    assert len(live) > before + 40


def test_a_bystander_hears_from_the_first_heartbeat_on(logged) -> None:
    bench, log = logged()
    bench.run(100)
    live = bench.samples(bench.events)
    bench.close()
    heard = overheard(log, as_host=False)
    assert heard[-1] == live[-1]
    assert len(heard) >= len(live)


@pytest.mark.parametrize("suffix", [".asc", ".log", ".blf"])
def test_every_format_gives_the_same_samples(logged, tmp_path: Path, suffix: str) -> None:
    bench, log = logged()
    bench.run(60)
    bench.close()
    other = tmp_path / f"again{suffix}"
    with can.Logger(other) as writer:
        for message in read_frames(log):
            writer.on_message_received(message)
    assert overheard(other, as_host=False) == overheard(log, as_host=False)


@given(st.binary(max_size=400), st.sampled_from([s for s in SUFFIXES if s != ".mf4"]))
def test_bytes_that_are_no_log_are_one_line(tmp_path_factory: pytest.TempPathFactory, raw: bytes, suffix: str) -> None:
    path = tmp_path_factory.getbasetemp() / f"junk{suffix}"
    path.write_bytes(raw)
    frames, told = read(path)
    assert frames == 0
    assert "\n" not in told


@given(st.integers(0, 4000), st.integers(0, 255))
def test_a_log_with_a_changed_byte_gives_frames_or_one_line(tmp_path_factory, at, value):
    path = tmp_path_factory.getbasetemp() / "changed.blf"
    with can.Logger(path) as writer:
        for i in range(40):
            writer.on_message_received(can.Message(i, arbitration_id=40, data=[i] * 8, is_extended_id=False))
    raw = bytearray(path.read_bytes())
    raw[at % len(raw)] = value
    path.write_bytes(raw)
    frames, told = read(path)
    assert frames <= 40
    assert not told or f"damaged after {frames} frames" in told


@pytest.mark.parametrize(
    ("name", "told"), [("none.blf", "no such file"), ("trend.csv", "not a format"), ("folder.blf", "no such file")]
)
def test_what_is_no_log_is_refused(tmp_path: Path, name: str, told: str) -> None:
    (tmp_path / "trend.csv").write_text("t,pv\n")
    (tmp_path / "folder.blf").mkdir()
    with pytest.raises(RecordingError, match=told):
        next(read_frames(tmp_path / name))


def test_no_error_of_the_readers_is_everything() -> None:
    assert Exception not in READING_ERRORS


# What a host may believe: read-backs that fit an epoch, restarts, and a device that seems to go back in time


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
