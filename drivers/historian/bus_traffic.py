"""Bus traffic as tables: the signals that a DBC describes, each with the times of its frames.

    frames of a log -> payloads by identifier -> bits of each signal -> value = scale x raw + offset

A signal is called as the DBC calls it where that names a loop (FIC101_PV); else by its message and itself (FIC101.PV of
a message FIC101 with a signal PV). Of a log that ends in damage what stands before it is taken, and told.
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import can
import numpy as np
from cantools.database.can import Message, Signal

from retuner.adaptive.signals.sample import FloatArray
from retuner.drivers.dbc.dbc_file import bits_of, read_dbc_file
from retuner.drivers.device import DeviceError
from retuner.drivers.historian.assumption import Assumption
from retuner.drivers.historian.data_frames import RowNumbers
from retuner.drivers.historian.raw_table import RawTable
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.historian.tags import named
from retuner.drivers.recorded.frame_log import read_frames
from retuner.drivers.recorded.recording import RecordingError
from retuner.schedule.late_dataclass import dataclass

Identifier = tuple[int, bool]  # number of a frame, and whether it is an extended one
TIME = "t [s]"


@dataclass(frozen=True, slots=True)
class Frames:
    """The frames of one identifier: times in seconds, shape (n,); payloads, shape (n, bytes), zeros after the end."""

    t_s: FloatArray
    payload: np.ndarray
    lengths: np.ndarray


def traffic_names(path: Path, form: RecordForm) -> list[str]:
    """The signals that a log holds, as its DBC calls them.

    Raises RecordingError: the log or a DBC cannot be read, or no DBC is given.
    """
    messages = _messages(path, form)
    there = dict.fromkeys((m.arbitration_id, m.is_extended_id) for m in _whole_frames(path, []))
    return [name for key in there if key in messages for name in _names(messages[key]).values()]


def tables_of_traffic(path: Path, form: RecordForm) -> list[RawTable]:
    """A table of each signal that names a loop's or is wanted by name, times beside it.

    Raises RecordingError: the log or a DBC cannot be read, or no DBC is given.
    """
    messages, told = _messages(path, form), list[Assumption]()
    tables = []
    times: dict[Identifier, list[float]] = {}
    data: dict[Identifier, list[bytes]] = {}
    for frame in _whole_frames(path, told):
        key = frame.arbitration_id, frame.is_extended_id
        if key in messages:
            times.setdefault(key, []).append(frame.timestamp)
            data.setdefault(key, []).append(bytes(frame.data))
    for key in list(data):
        some = data.pop(key)  # some bytes for each frame of the log
        lengths = np.array([len(one) for one in some])
        width = max(messages[key].length, int(lengths.max()))
        payload = np.frombuffer(b"".join(one.ljust(width, b"\0") for one in some), np.uint8).reshape(-1, width)
        frames = Frames(np.array(times.pop(key)), payload, lengths)
        for signal, name in _names(messages[key]).items():
            called = form.called(name)
            asked = next((n for n in (called, name, signal) if n in form.others), "")
            if asked or named(called).role:
                rows, values = _values(messages[key], messages[key].get_signal_by_name(signal), frames)
                columns = (frames.t_s[rows], values)
                tables.append(
                    RawTable(str(path), (TIME, asked or called), columns, RowNumbers(len(values)), tuple(told))
                )
    if not tables:
        raise RecordingError(f"{path}: none of its frames holds a loop's signal by this DBC; name some with --record")
    return tables


def _messages(path: Path, form: RecordForm) -> dict[Identifier, Message]:
    """The messages that the DBCs describe; the first that describes one counts."""
    if not form.dbc:
        raise RecordingError(f"{path}: bus traffic is read with a DBC; give the file with --dbc")
    found: dict[Identifier, Message] = {}
    for name in form.dbc:
        for message in _described(name):
            found.setdefault((message.frame_id, message.is_extended_frame), message)
    return found


@lru_cache(maxsize=16)
def _described(name: str) -> tuple[Message, ...]:
    try:
        return tuple(read_dbc_file(Path(name)).messages)
    except DeviceError as error:
        raise RecordingError(str(error)) from error


def _names(message: Message) -> dict[str, str]:
    tagged = {signal.name for signal in message.signals if named(signal.name).role and named(signal.name).tag}
    return {s.name: s.name if s.name in tagged else f"{message.name}.{s.name}" for s in message.signals}


def _whole_frames(path: Path, told: list[Assumption]) -> Iterator[can.Message]:
    """Frames with data up to the end, or up to where the log is damaged; that is told."""
    count = 0
    try:
        for frame in read_frames(path):
            count += 1
            if not (frame.is_error_frame or frame.is_remote_frame):
                yield frame
    except RecordingError as error:
        if not count:
            raise
        told.append(Assumption(f"{error}: what stands before it was taken"))


def _values(message: Message, signal: Signal, frames: Frames) -> tuple[np.ndarray, FloatArray]:
    """Rows that carry a signal, and its values in its unit: whole frames, of a multiplexed one its own pages."""
    rows = frames.lengths > max(bits_of(signal)) // 8
    if signal.multiplexer_ids:
        selector = message.get_signal_by_name(str(signal.multiplexer_signal))
        rows &= np.isin(_raw(selector, frames.payload), signal.multiplexer_ids)
    raw = _raw(signal, frames.payload[rows])
    return rows, np.asarray(raw * float(signal.scale) + float(signal.offset), dtype=np.float64)


def _raw(signal: Signal, payload: np.ndarray) -> FloatArray:
    places = np.array(bits_of(signal))
    first, last = places.min() // 8, places.max() // 8 + 1
    bits = np.unpackbits(payload[:, first:last], axis=1, bitorder="little")[:, places - 8 * first]
    if signal.is_float:
        kind = {16: np.float16, 32: np.float32, 64: np.float64}[signal.length]
        return np.ascontiguousarray(np.packbits(bits, axis=1, bitorder="little")).view(kind).ravel().astype(np.float64)
    weights = 2.0 ** np.arange(signal.length)
    if signal.is_signed:
        weights[-1] *= -1
    return np.asarray(bits @ weights, dtype=np.float64)
