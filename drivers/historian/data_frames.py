"""Tables that are no text: frames of pandas, polars and arrow, none of which need be installed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np

from retuner.drivers.historian.raw_table import Column, RawTable
from retuner.drivers.recorded.recording import RecordingError


class RowNumbers(Sequence[str]):
    """The rows of a table as a message tells them, counted from 1; made when one is asked for."""

    def __init__(self, rows: int, first: int = 0) -> None:
        self._rows = range(first, first + rows)

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, row: int) -> str: ...
    @overload
    def __getitem__(self, row: slice) -> list[str]: ...
    def __getitem__(self, row: int | slice) -> str | list[str]:
        if isinstance(row, slice):
            return [f": row {i + 1}" for i in self._rows[row]]
        return f": row {self._rows[row] + 1}"


def is_frame(source: object) -> bool:
    """Whether this is a data frame: it has columns by name."""
    return not isinstance(source, (str, Path)) and (hasattr(source, "columns") or hasattr(source, "column_names"))


def table_of_frame(frame: object) -> RawTable:
    """A frame of pandas (its index counts as a column where it has times or a name), polars or arrow.

    Raises RecordingError: a column can be made neither numbers nor times nor text.
    """
    given: Any = frame  # of whichever library: nothing is imported to name its type
    if hasattr(given, "reset_index"):
        index = given.index
        if index.name is not None or np.asarray(index).dtype.kind == "M" or hasattr(index, "tz"):
            given = given.reset_index(names="t") if index.name is None else given.reset_index()
    names = list(getattr(given, "column_names", None) or given.columns)
    columns = [column_of(str(name), given[name]) for name in names]
    return RawTable("the frame", tuple(map(str, names)), tuple(columns), RowNumbers(len(columns[0]) if columns else 0))


def column_of(name: str, series: object, *, copy: bool = True) -> Column:
    """One column. copy : whoever holds the series may change it."""
    combined = getattr(series, "to_numpy", None)
    values = np.asarray(combined() if combined is not None else series)
    if values.dtype.kind in "iuf":
        return values.astype(np.float64, copy=copy)
    if values.dtype.kind == "M":
        return values
    if values.dtype.kind == "O":
        some = [v for v in values if v is not None]
        if some and all(hasattr(v, "timestamp") for v in some):
            return np.array(
                ["NaT" if v is None else np.datetime64(int(v.timestamp() * 1e6), "us") for v in values],
                dtype="datetime64[ns]",
            )
        if some and not any(isinstance(v, (str, bool)) for v in some):
            try:
                return np.array([np.nan if v is None else float(v) for v in values])
            except (TypeError, ValueError):
                raise RecordingError(f"column {name}: {some[0]!r} is neither a number nor a time nor text") from None
        return ["" if v is None else str(v) for v in values]
    return [str(value) for value in values]
