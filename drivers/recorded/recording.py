"""Recorded loops: files with time, setpoint, process value and controller output, read strictly.

A number is what ASCII digits, a point and an exponent make; Python's float() would also take 1_000, nan and Arabic
digits. A row has as many fields as the header, and a quote does not reach over the end of its line. Every refusal names
file, line and column.
"""

import csv
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from retuner.adaptive.signals.sample import FloatArray, Window, in_units
from retuner.schedule.late_dataclass import dataclass, field

ROLES = ("t", "sp", "pv", "co")
DELIMITERS = ",;\t"
SIZE_MAX = 1 << 30  # Largest file in bytes; a year at one sample a second is about as long
NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+")
DEAD = 1e-9  # A signal that varies by less than this share of its magnitude is constant; single precision resolves 1e-7


class RecordingError(ValueError):
    """A recording that cannot be used; one line: file, line and column, what is wrong, what to do."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One recorded loop.

    source : where it comes from, for messages.
    t_s, pv, co : time in seconds, process value and controller output in their own units, shape (n,) each.
    sp : setpoint, shape (n,), or None when the record has none (an open-loop test).

    Raises RecordingError: fewer than three samples, shapes that differ, a value that is not finite or beyond LARGEST,
    or time that does not increase.
    """

    source: str
    t_s: FloatArray
    pv: FloatArray
    co: FloatArray
    sp: FloatArray | None = None
    _window: Window = field(init=False, repr=False, compare=False)

    @property
    def summary(self) -> str:
        """Where it comes from, how long it is, and between what pv and co move."""
        n, span_s = len(self.t_s), float(self.t_s[-1] - self.t_s[0])
        ends = (
            f"{name} {values.min():.4g} to {values.max():.4g}" for name, values in (("pv", self.pv), ("co", self.co))
        )
        setpoint = "no setpoint" if self.sp is None else f"sp {self.sp.min():.4g} to {self.sp.max():.4g}"
        return f"{self.source}: {n} samples over {span_s:.6g} s, {setpoint}, {', '.join(ends)}"

    def __repr__(self) -> str:
        return f"Recording({self.summary})"

    def __post_init__(self) -> None:
        sp = self.sp
        if sp is None:
            sp = np.full(len(self.pv), self.pv[0] if len(self.pv) else 0.0)
        try:
            object.__setattr__(self, "_window", in_units(Window(self.t_s, sp, self.pv, self.co)))
        except ValueError as error:
            raise RecordingError(f"{self.source}: {error}") from error

    def window(self) -> Window:
        """The whole record for a fit; where it has no setpoint, the first pv stands in."""
        return self._window


def require_setpoint(recording: Recording) -> None:
    """Refuse a record without a setpoint where a controller was at work. Raises RecordingError: it has none."""
    if recording.sp is None:
        raise RecordingError(
            f'{recording.source}: no column "sp"; name it with --columns sp=NAME or give its value with --sp; '
            "identify takes --open-loop if there was no controller"
        )


def require_excitation(recording: Recording) -> None:
    """Refuse a record from which no process can be identified because nothing moved.

    Raises RecordingError: co or pv is constant (a dead signal).
    """
    for name, values in (("co", recording.co), ("pv", recording.pv)):
        low, high = float(values.min()), float(values.max())
        if high - low <= DEAD * max(abs(low), abs(high)):
            raise RecordingError(
                f"{recording.source}: {name} is {low:g} in all {len(values)} samples, so there is nothing to identify; "
                "choose a record in which co and pv move"
            )


def read_columns(path: Path, names: list[str], wanted: list[str]) -> dict[str, FloatArray]:
    """Columns of a CSV or Parquet file by their names in it, shape (n,) each; the first one is the time.

    names : columns to read where they are there. wanted : those of them that must be there.

    Raises RecordingError: the file cannot be read or is malformed: see the head of this file.
    """
    _check_size(path)
    return (_read_parquet if path.suffix == ".parquet" else _read_csv)(path, names, wanted)


def column_names(path: Path) -> frozenset[str]:
    """Names of the columns of a CSV or Parquet file; a CSV's are the fields of its first line.

    Raises RecordingError: the file cannot be read.
    """
    _check_size(path)
    if path.suffix == ".parquet":
        with open_parquet(path) as file:
            return frozenset(file.schema_arrow.names)
    number, text = next(_rows(path), (1, ""))
    return frozenset(field.strip() for field in fields_of(path, number, text, max(DELIMITERS, key=text.count)))


def size_of(path: Path, give: str = "a CSV or Parquet file") -> int:
    """Bytes of a file. Raises RecordingError: it cannot be read, or is not there; give : what to name instead."""
    try:
        if path.is_file():
            return path.stat().st_size
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    raise RecordingError(f"{path}: no such file; give {give}")


def _check_size(path: Path) -> None:
    size = size_of(path)
    if size > SIZE_MAX:
        raise RecordingError(f"{path}: {size} bytes are more than {SIZE_MAX}; cut the record into pieces")


def _missing(path: Path, line: str, name: str, header: list[str]) -> RecordingError:
    there = ", ".join(header) or "nothing"
    return RecordingError(f'{path}{line}: no column "{name}"; there is {there}; name it as in --columns pv=NAME')


def _read_csv(path: Path, names: list[str], wanted: list[str]) -> dict[str, FloatArray]:
    rows = _rows(path)
    number, text = next(rows, (1, ""))
    delimiter = max(DELIMITERS, key=text.count)
    header = [field.strip() for field in fields_of(path, number, text, delimiter)]
    for name in wanted:
        if name not in header:
            raise _missing(path, f":{number}", name, header)
    places = {name: header.index(name) for name in names if name in header}
    for name in places:
        if header.count(name) > 1:
            raise RecordingError(f'{path}:{number}: two columns are called "{name}"; rename one')
    values: dict[str, list[float]] = {name: [] for name in places}
    last_t = -math.inf
    for number, text in rows:
        fields = fields_of(path, number, text, delimiter)
        if len(fields) != len(header):
            hint = "; a decimal comma needs ; between fields" if len(fields) == 2 * len(header) else ""
            raise RecordingError(f"{path}:{number}: {len(fields)} fields, the header has {len(header)}{hint}")
        for name, place in places.items():
            values[name].append(_number(path, number, name, fields[place]))
        t = values[names[0]][-1]
        if t <= last_t:
            raise RecordingError(f"{path}:{number}: {names[0]} = {t:g} follows {last_t:g}; time must increase")
        last_t = t
    return {name: np.array(column, dtype=np.float64) for name, column in values.items()}


def _rows(path: Path) -> Iterator[tuple[int, str]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            for number, line in enumerate(stream, start=1):
                text = line.rstrip("\r\n")
                if "\0" in text:
                    raise RecordingError(f"{path}:{number}: a NUL byte: not a text file")
                if text.strip():
                    yield number, text
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"{path}: not UTF-8 text ({error.reason} at byte {error.start}); save it as UTF-8"
        ) from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


def fields_of(path: Path, number: int, text: str, delimiter: str, *, spaced: bool = False) -> list[str]:
    """The fields of a line, which may be quoted. spaced : blanks may stand before a quote."""
    if '"' not in text:
        return text.split(delimiter)
    try:
        return next(csv.reader([text], delimiter=delimiter, strict=True, skipinitialspace=spaced))
    except csv.Error as error:
        raise RecordingError(f"{path}:{number}: quoting: {error}; close the quote on its line") from error


def _number(path: Path, number: int, name: str, field: str) -> float:
    text = field.strip(" ")
    if NUMBER.fullmatch(text):
        value = float(text)
        if math.isfinite(value):
            return value
    shown = repr(text[:40])
    if DECIMAL_COMMA.fullmatch(text):
        raise RecordingError(f"{path}:{number}: {name} = {shown} has a decimal comma; write a point")
    what = "is empty" if not text else "is not a finite number"
    raise RecordingError(f"{path}:{number}: {name} = {shown} {what}; give plain numbers such as 12.5 or 1e-3")


def _read_parquet(path: Path, names: list[str], wanted: list[str]) -> dict[str, FloatArray]:
    """Columns as floats: no nulls, no text, no truth values, no infinities."""
    with open_parquet(path) as file:
        header = list(file.schema_arrow.names)
        for name in wanted:
            if name not in header:
                raise _missing(path, "", name, header)
        table = file.read(columns=[name for name in names if name in header])
    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    for name, values in columns.items():
        for row, value in enumerate(values, start=1):
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise RecordingError(f"{path}: row {row}: {name} = {value!r} is not a finite number")
    return {name: np.array(values, dtype=np.float64) for name, values in columns.items()}


@contextmanager
def open_parquet(path: Path) -> Iterator[Any]:
    """An open Parquet file. Raises RecordingError: it cannot be read, or pyarrow is not installed."""
    try:
        import pyarrow as pa  # noqa: PLC0415  an extra, loaded when wanted
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError:
        raise RecordingError(f'{path}: reading Parquet needs pyarrow; pip install "retuner[parquet]"') from None
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; give a record as text or Parquet")
    try:
        with pq.ParquetFile(path, memory_map=True) as file:
            yield file
    except (OSError, pa.ArrowException) as error:
        raise RecordingError(f"{path}: not a Parquet file that can be read: {str(error).splitlines()[0]}") from error
