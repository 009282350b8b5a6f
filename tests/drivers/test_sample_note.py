"""Notes of samples in a bus log: the same sample again, to the last digit, and only of the loop that is asked for."""

from pathlib import Path

import can
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.recorded.frame_log import read_frames
from retuner.drivers.recorded.sample_note import Notes, note_id, note_of, sample_of

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
