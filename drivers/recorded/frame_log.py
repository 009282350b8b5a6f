"""Recorded bus traffic, read with python-can's own readers: .blf, .asc, .mf4 and candump's .log.

python-can's readers raise whatever their parsing meets; here that becomes one line that says how far the log could be
read. Frames before the damage are given out, so a caller that stops counting there knows where it stands.
"""

import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import can
from can.io.blf import BLFParseError

from retuner.drivers.bus.bus_log import log_parts
from retuner.drivers.recorded.mf4 import mf4_errors, mf4_reader
from retuner.drivers.recorded.recording import RecordingError

READERS: dict[str, Callable[[Any], Iterable[can.Message]]] = {
    ".blf": can.BLFReader,
    ".asc": can.ASCReader,
    ".mf4": mf4_reader,
    ".log": can.CanutilsLogReader,
}
SUFFIXES = tuple(READERS)
"""Formats of bus traffic; .csv and .parquet are tables of samples (recording.py)."""
TEXT = (".asc", ".log")
SIZE_MAX = 1 << 34
"""Largest file in bytes: a month of one loop at 100 samples a second is about as long."""
READING_ERRORS = (
    can.CanError,
    BLFParseError,
    OSError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    EOFError,
    struct.error,
    zlib.error,
)
"""What python-can's readers raise on bytes that they did not expect."""


def is_frame_log(path: Path) -> bool:
    """Whether the suffix is one of a log of bus traffic."""
    return path.suffix.lower() in SUFFIXES


def read_frames(path: Path) -> Iterator[can.Message]:
    """The frames of a log in their order.

    Raises
    ------
    RecordingError
        No such file, a format that cannot be read here, or damage; the line says after how many frames.
    """
    _check(path)
    count = 0
    errors = READING_ERRORS + (mf4_errors() if path.suffix.lower() == ".mf4" else ())
    try:
        with _opened(path) as stream:
            for message in READERS[path.suffix.lower()](stream):
                count += 1
                yield message
    except (ImportError, NotImplementedError):
        raise RecordingError(f"{path}: reading this format needs asammdf; pip install 'retuner[mf4]'") from None
    except errors as error:
        told = f": {error}" if str(error) else ""
        raise RecordingError(f"{path}: damaged after {count} frames{told}; give a whole log") from error


def read_parts(path: Path) -> Iterator[can.Message]:
    """The frames of all parts that are there of a log (bus_log.py), oldest first; errors as read_frames."""
    for part in log_parts(path).paths:
        yield from read_frames(part)


def _opened(path: Path) -> AbstractContextManager[Any]:
    """What the reader of this format reads from; a reader that fails in its constructor would leave its file open."""
    if path.suffix.lower() in TEXT:
        return path.open(encoding="utf-8")
    return path.open("rb")


def _check(path: Path) -> None:
    """Refuse what is no file of a sensible size, or of a format that is not known."""
    try:
        there, size = path.is_file(), path.stat().st_size if path.is_file() else 0
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    if not there:
        raise RecordingError(f"{path}: no such file; give a log of bus traffic ({', '.join(SUFFIXES)})")
    if not is_frame_log(path):
        raise RecordingError(f"{path}: not a format of bus traffic; give {', '.join(SUFFIXES)}")
    if size > SIZE_MAX:
        raise RecordingError(f"{path}: {size} bytes are more than {SIZE_MAX}; cut the log into pieces")
