"""Telemetry to samples: wrap, loss, repetition, order, stray halves and restarts."""

import math
import random
import struct
from dataclasses import replace
from pathlib import Path

import can
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.device import VariableChanged
from retuner.drivers.protocol.checksum import sample_crc
from retuner.drivers.protocol.codec import DbcError
from retuner.drivers.protocol.frames import TelemetryPv, TelemetrySp
from retuner.drivers.recorded.frame_log import read_frames
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


@settings(deadline=None, max_examples=examples(50))
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
