"""Frames: the shipped DBC, the round trip of every frame, and any bytes whatsoever at the decoder's door."""

import math
import struct
from dataclasses import fields

import can
import cantools.database
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.drivers.protocol import frames
from retuner.drivers.protocol.checksum import commit_crc, crc8, set_crc, to_wire
from retuner.drivers.protocol.codec import COMMAND_BITS, Codec, FrameError, Refusal, Refused, _database, _plans, schema
from retuner.drivers.protocol.frames import NAMES, newer
from retuner.schedule.gains import PidGains

NODE = 5
CODEC = Codec(NODE)
SAMPLES: list[frames.Frame] = [
    frames.Lease(65535, 7, 300, 255),
    frames.Read(1, 65535),
    frames.Abort(65535),
    frames.Stage(2, 63, -1.5, 300),
    frames.Commit(2, 1, 0xFFFFFFFF),
    frames.Store(7, 255),
    frames.Confirm(7, 65535),
    frames.Auth(1, 15, 2**48 - 1),
    frames.Setpoint(255, 120.25, 1),
    frames.Mode(1, 0, 47.125, 2),
    frames.Load(3, -5.0, 3),
    frames.Heartbeat(2**32 - 1, 65535, 63),
    frames.Status(1, 2, 3, 255),
    frames.TelemetryPv(9, 88.5, -0.0001),
    frames.TelemetrySp(9, 90.0, 1, -1, 31, 65535),
    frames.Identity(1, 0xBEEF, 2.0),
    frames.PageItem(2, 1, 15, 0.5, 9),
    frames.PageEnd(2, 1, 3, 9, 12345),
    frames.Ack(5, 9, 18, 9, 2, 8191),
    frames.Challenge(127, 1, 2**48 - 1),
]


def test_check_values_of_the_checksum() -> None:
    assert crc8(b"123456789") == 0x4B  # SAE J1850, published check value
    gains = PidGains(1.0, 0.25, 0.5)
    assert len({set_crc(n, e, s, gains) for n in (1, 2) for e in (0, 1) for s in (0, 1)}) == 8
    assert len({commit_crc(set_crc(1, 2, 3, gains), base, owner) for base in range(99) for owner in (1, 2)}) == 198


def test_the_dbc_is_complete() -> None:
    for layout in _database().messages:
        assert layout.comment, layout.name
        assert {s.name.lower() for s in layout.signals} - {"checksum"} == {f.name for f in fields(NAMES[layout.name])}
        for signal in layout.signals:
            assert signal.minimum is not None
            assert signal.maximum is not None
            assert signal.minimum < signal.maximum
        assert layout.frame_id >> COMMAND_BITS == 1
    assert len(_database().messages) == len(NAMES) == len(_plans()) == len(SAMPLES)


@pytest.mark.parametrize("frame", SAMPLES, ids=lambda frame: type(frame).__name__)
def test_every_frame_comes_back(frame: frames.Frame) -> None:
    message = CODEC.encode(frame)

    assert CODEC.decode(message) == frame
    assert message.arbitration_id >> COMMAND_BITS == NODE
    assert Codec(NODE + 1).decode(message) == Refused(Refusal.FOREIGN)


def test_foreign_tools_read_the_frames_with_the_shipped_dbc() -> None:
    message = Codec(1).encode(frames.TelemetryPv(9, 88.5, 12.5))
    got = _database().decode_message(message.arbitration_id, bytes(message.data))

    assert got == {"COUNTER": 9, "pv": 88.5, "co": 12.5}
    assert cantools.database.load_string(_database().as_dbc_string(), "dbc").messages


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e13, -1e13])
def test_numbers_that_must_not_travel_are_refused_when_sent_and_when_received(value: float) -> None:
    with pytest.raises(FrameError, match=r"STAGE\.value = .*give a number from"):
        CODEC.encode(frames.Stage(0, 1, value, 1))
    message = CODEC.encode(frames.TelemetryPv(1, 0.0, 0.0))
    message.data[1:5] = struct.pack("<f", value)
    assert CODEC.decode(message) == Refused(Refusal.RANGE)


def test_what_is_no_data_frame_is_refused() -> None:
    good = CODEC.encode(frames.Heartbeat(1, 2, 3))
    id_, data = good.arbitration_id, good.data
    for message, refusal in [
        (can.Message(arbitration_id=id_, is_extended_id=True, data=data), Refusal.NOT_DATA),
        (can.Message(arbitration_id=id_, is_extended_id=False, is_remote_frame=True, dlc=8), Refusal.NOT_DATA),
        (can.Message(arbitration_id=id_, is_extended_id=False, is_error_frame=True, data=data), Refusal.NOT_DATA),
        (can.Message(arbitration_id=id_, is_extended_id=False, is_fd=True, data=data), Refusal.NOT_DATA),
        (can.Message(arbitration_id=id_, is_extended_id=False, data=data[:7]), Refusal.LENGTH),
        (can.Message(arbitration_id=NODE << 5 | 31, is_extended_id=False, data=data), Refusal.UNKNOWN),
    ]:
        assert CODEC.decode(message) == Refused(refusal)


CHECKED = [
    frame
    for frame in SAMPLES
    if any(s.name == "CHECKSUM" for s in _plans()[CODEC.encode(frame).arbitration_id & 31].layout.signals)
]


@given(st.sampled_from(CHECKED), st.integers(0, 63))
@settings(max_examples=examples(300))
def test_any_single_flipped_bit_fails_the_checksum(frame: frames.Frame, bit: int) -> None:
    message = CODEC.encode(frame)
    message.data[bit // 8 % len(message.data)] ^= 1 << bit % 8

    assert CODEC.decode(message) == Refused(Refusal.CHECKSUM)


@given(id_=st.integers(0, 2047), data=st.binary(max_size=8), extended=st.booleans())
@settings(max_examples=examples(2000))
def test_any_bytes_are_a_frame_or_a_refusal(id_: int, data: bytes, extended: bool) -> None:
    _is_frame_or_refusal(can.Message(arbitration_id=id_, is_extended_id=extended, data=data))


@pytest.mark.uncounted
@given(command=st.sampled_from(sorted(_plans())), data=st.binary(min_size=8, max_size=8), fix=st.booleans())
@settings(max_examples=examples(3000))
def test_any_bytes_under_a_right_id_are_a_frame_or_a_refusal(command: int, data: bytes, fix: bool) -> None:
    plan = _plans()[command]
    payload = bytearray(data[: plan.layout.length])
    id_ = NODE << COMMAND_BITS | command
    if fix and plan.checked:
        payload[-1] = crc8(struct.pack("<H", id_) + payload[:-1])
    _is_frame_or_refusal(can.Message(arbitration_id=id_, is_extended_id=False, data=payload))


def _is_frame_or_refusal(message: can.Message) -> None:
    got = CODEC.decode(message)
    if isinstance(got, Refused):
        return
    numbers = [getattr(got, field.name) for field in fields(got)]
    assert all(math.isfinite(number) for number in numbers)
    assert CODEC.decode(CODEC.encode(got)) == got


@given(st.integers(0, 65535), st.integers(-40000, 40000))
def test_newer_is_an_order_on_the_half_circle(seq: int, ahead: int) -> None:
    other = (seq + ahead) % 65536
    assert newer(other, seq) == (0 < ahead % 65536 < 32768)
    assert not (newer(other, seq) and newer(seq, other))


def test_gains_on_the_wire_are_float32() -> None:
    gains = to_wire(PidGains(0.1, 0.003, 7.7))
    assert gains == to_wire(gains)
    assert gains.kp == 0.10000000149011612
    with pytest.raises(ValueError, match="float32"):
        to_wire(PidGains(1e39, 0.0))
    with pytest.raises(ValueError, match="all zero"):
        to_wire(PidGains(1e-60, 0.0))


@pytest.mark.parametrize("node", [0, 64, -1])
def test_nodes_outside_the_id_are_refused(node: int) -> None:
    with pytest.raises(ValueError, match="from 1 to 63"):
        Codec(node)


def test_schema_is_16_bits_and_stable_within_a_version() -> None:
    assert schema() == schema()
    assert 0 < schema() <= 0xFFFF
