"""Recorded bus traffic, read with python-can's own readers: .blf, .asc, .mf4 and candump's .log.

python-can's readers raise whatever their parsing meets; here that becomes one line that says how far the log could be
read. Frames before the damage are given out, so a caller that stops counting there knows where it stands.
"""

import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import can
from can.io.blf import BLFParseError

from retuner.drivers.bus.bus_opening import log_parts
from retuner.drivers.device import RunningSet
from retuner.drivers.host.can_device import mismatch
from retuner.drivers.host.page_reader import PageReader, ReadBack
from retuner.drivers.host.running_set import Belief, RunningBelief
from retuner.drivers.protocol import frames
from retuner.drivers.protocol.codec import Codec, Refused
from retuner.drivers.recorded.mf4 import mf4_errors, mf4_reader
from retuner.drivers.recorded.recording import RecordingError, size_of
from retuner.drivers.telemetry.device_counter import Said
from retuner.drivers.telemetry.sample_assembly import AssembledSample, SampleJoiner
from retuner.drivers.telemetry.signal_source import ScheduleInputs

READERS: dict[str, Callable[[Any], Iterable[can.Message]]] = {
    ".blf": can.BLFReader,
    ".asc": can.ASCReader,
    ".mf4": mf4_reader,
    ".log": can.CanutilsLogReader,
}
SUFFIXES = tuple(READERS)  # Formats of bus traffic; .csv and .parquet are tables of samples (recording.py)
TEXT = (".asc", ".log")
SIZE_MAX = 1 << 34  # Largest file in bytes: a month of one loop at 100 samples a second is about as long
READING_ERRORS = (
    can.CanError, BLFParseError, OSError, ValueError, TypeError, KeyError, IndexError, AttributeError,
    OverflowError, EOFError, struct.error, zlib.error,
)  # fmt: skip
"""What python-can's readers raise on bytes that they did not expect."""


def is_frame_log(path: Path) -> bool:
    """Whether the suffix is one of a log of bus traffic."""
    return path.suffix.lower() in SUFFIXES


def read_frames(path: Path) -> Iterator[can.Message]:
    """The frames of a log in their order.

    Raises RecordingError: no such file, a format that cannot be read here, or damage; the line says after how many
    frames.
    """
    size = size_of(path, f"a log of bus traffic ({', '.join(SUFFIXES)})")
    if not is_frame_log(path):
        raise RecordingError(f"{path}: not a format of bus traffic; give {', '.join(SUFFIXES)}")
    if size > SIZE_MAX:
        raise RecordingError(f"{path}: {size} bytes are more than {SIZE_MAX}; cut the log into pieces")
    count = 0
    errors = READING_ERRORS + (mf4_errors() if path.suffix.lower() == ".mf4" else ())
    try:
        with path.open(encoding="utf-8") if path.suffix.lower() in TEXT else path.open("rb") as stream:
            for message in READERS[path.suffix.lower()](stream):
                count += 1
                yield message
    except (ImportError, NotImplementedError):
        raise RecordingError(f"{path}: reading this format needs asammdf; pip install 'retuner[mf4]'") from None
    except errors as error:
        told = f": {error}" if str(error) else ""
        raise RecordingError(f"{path}: damaged after {count} frames{told}; give a whole log") from error


def read_parts(path: Path) -> Iterator[can.Message]:
    """The frames of all parts that are there of a log (bus_opening.py), oldest first; errors as read_frames."""
    for part in log_parts(path).paths:
        yield from read_frames(part)


# ---- The samples of one controller out of recorded bus traffic: what a host heard then, or could have heard.
#
# The same codec, read-back, belief and joiner as in can_device.py, driven by the recorded frames alone: nothing is
# asked, so the questions of the host that was there are overheard. Two ways to listen:
#   - as the host that recorded the log (its own frames are marked as sent): telemetry counts from the same frame on as
#     it did then, once the identity and the running set had been read back; where contact was lost is for the caller
#     to say;
#   - as a bystander, with a log from anywhere: telemetry counts as soon as a heartbeat has told the full counter.


class Overhearing:
    """One node's traffic, frame by frame.

    node : of the controller. sample_time_s : of the controller, s. variable : what goes into LoopSample.x.
    as_host : listen as the host that recorded the log, see the head of this file. gaps : samples over which time went
    on at each restart of the device, as the host had it; without them the log's own times tell. after_s : as CanDevice.

    Raises ValueError: no such node or variable.
    """

    def __init__(
        self,
        node: int,
        sample_time_s: float,
        variable: str | ScheduleInputs = "sp",
        *,
        as_host: bool = True,
        gaps: Iterable[int] = (),
        after_s: float | None = None,
    ) -> None:
        self._codec = Codec(node)
        self._reader = PageReader()
        self._belief = RunningBelief(node)
        self._joiner = SampleJoiner(sample_time_s, variable, node, after_s)
        self._sample_time_s, self._as_host = sample_time_s, as_host
        self._identified = self._connected = not as_host
        self._sample_s = 0.0
        self._gaps = iter(gaps)
        self.frames = 0
        """Frames of this node so far, whatever their direction."""

    @property
    def running(self) -> RunningSet | None:
        """The set that runs, as far as read-backs have told."""
        return self._belief.running

    def contact_lost(self) -> None:
        """The host heard nothing for too long here: it began anew."""
        self._belief.doubt()
        self._joiner.forget()
        self._identified = self._connected = False

    def take(self, message: can.Message) -> AssembledSample | None:
        """Note a frame; the sample that it completes, with the number of samples lost before it."""
        frame = self._codec.decode(message)
        if isinstance(frame, Refused):
            self._joiner.tap.take(message)
            return None
        self.frames += 1
        match frame:
            case frames.TelemetryPv() | frames.TelemetrySp():
                if not self._connected:
                    return None
                joined = self._joiner.take(frame)
                if joined is not None:
                    self._sample_s = message.timestamp
                return joined
            case frames.Heartbeat():
                known = self._belief.on_heartbeat(frame)
                if not self._as_host:  # it cannot ask
                    self._belief.identify()
                # The full counter, in the epoch that is known; to a bystander who knows of none, in any
                counts = known or (not self._as_host and self._belief.epoch is None)
                if counts and self._joiner.set_reference(frame.sample) is Said.CONTRADICTS:
                    self._belief.contradicted()
            case frames.Identity():
                # Who is there: the right device, or another one
                if not mismatch(frame, self._sample_time_s):
                    self._identified = True
                    self._belief.identify()
            case frames.PageItem() | frames.PageEnd():
                self._page(self._reader.take(frame), message.timestamp)
            case frames.Read() | frames.Stage() if not (self._as_host and message.is_rx):
                # The host asks for a page, or begins to write
                if isinstance(frame, frames.Read):
                    self._reader.overheard(frame)
                else:
                    self._joiner.ordered = frame.seq
            case _:
                pass
        return None

    def _page(self, page: ReadBack | None, now_s: float) -> None:
        """What runs, when a whole page of it was read back."""
        if page is None or page.page != frames.Page.RUNNING:
            return
        verdict, running = self._belief.on_page(page), self._belief.running
        if verdict is Belief.NOTHING or running is None:
            return
        if verdict is Belief.FIRST and self._as_host:
            self._joiner.set_reference(self._belief.boot_sample)
        if verdict is Belief.RESTARTED:
            gap = next(self._gaps, None)
            if gap is None:
                self._joiner.restart_after(self._belief.boot_sample, now_s - self._sample_s)
            else:
                self._joiner.restart(self._belief.boot_sample, gap)
        self._connected = self._connected or self._identified
        self._joiner.running = running.seq
