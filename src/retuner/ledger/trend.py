"""The trend of a run: every sample with the region and the gains that were in force."""

from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from retuner.adaptive.signals.sample import FloatArray, LoopSample
from retuner.errors import UserError
from retuner.files import write_whole
from retuner.schedule.gains import PidGains

NO_PYARROW = 'output.trend = "parquet" needs pyarrow; pip install "retuner[parquet]", or set it to "csv"'
COLUMNS = ("t", "sp", "pv", "co", "x", "mode", "limited", "region", "sequence", "kp", "ki", "kd")
"""t in s, sp and pv in pv units, co in percent, region as index, sequence of the gain set, parallel gains."""
COLUMNS_2 = (*COLUMNS, "x2")  # columns where there are two scheduling variables
WHOLE = frozenset({"mode", "limited", "region", "sequence"})
ROWS_MAX = 2_000_000  # Rows of a trend that are kept: 190 MB, 46 days at a sample every 2 s, 5.5 hours at 100 a second


class Rows:
    """Rows of numbers in one flat array: 8 bytes a number, a fifth of what tuples take.

    width : numbers in a row.
    most : rows to keep. When they are reached, every second row of the older half goes: a run that never ends keeps its
        last hours whole and the time before ever more coarsely.
    """

    def __init__(self, width: int, most: int = ROWS_MAX) -> None:
        self._values = array("d")
        self._width = width
        self._most = max(most, 4)
        self.thinned = 0

    def __len__(self) -> int:
        return len(self._values) // self._width

    def __getitem__(self, i: int) -> tuple[float, ...]:
        first = range(len(self))[i] * self._width
        return tuple(self._values[first : first + self._width])

    def __iter__(self) -> Iterator[tuple[float, ...]]:
        return (self[i] for i in range(len(self)))

    def append(self, row: tuple[float, ...]) -> None:
        """Add a row."""
        self._values.extend(row)
        if len(self._values) >= self._most * self._width:
            # Drop every second row of the older half
            table = self.table()
            half = len(table) // 2
            self._values = array("d", np.concatenate((table[:half:2], table[half:])).tobytes())
            self.thinned += 1

    def table(self) -> FloatArray:
        """All rows, shape (n, columns)."""
        return np.array(self._values, dtype=np.float64).reshape(-1, self._width)


class Trend:
    """Rows of COLUMNS, or of COLUMNS_2, in the order of time.

    most : rows to keep, see Rows. two : whether there are two scheduling variables.
    """

    def __init__(self, most: int = ROWS_MAX, *, two: bool = False) -> None:
        self.names = COLUMNS_2 if two else COLUMNS
        self.rows = Rows(len(self.names), most)

    def add(self, sample: LoopSample, region: int, gains: PidGains) -> None:
        """Take one sample."""
        s = sample
        row = (s.t_s, s.sp, s.pv, s.co, s.x, s.mode, s.limited, region, s.revision, gains.kp, gains.ki, gains.kd, s.x2)
        self.rows.append(row[: len(self.names)])

    def columns(self) -> dict[str, FloatArray]:
        """Arrays by column name, each of shape (n,)."""
        table = self.rows.table()
        return {name: table[:, i] for i, name in enumerate(self.names)}


def write_trend(stem: Path, trend: Trend, kind: str) -> Path:
    """Write a trend as stem.csv or stem.parquet, whole or not at all; returns the path.

    Raises UserError: parquet is wanted and pyarrow is not installed. OSError: see write_whole.
    """
    path = stem.with_suffix(f".{kind}")
    if kind == "parquet":
        # The trend as the bytes of a Parquet file
        try:
            import pyarrow as pa  # noqa: PLC0415  an extra, loaded when wanted
            from pyarrow import parquet  # noqa: PLC0415
        except ImportError:
            raise UserError(NO_PYARROW) from None
        sink = pa.BufferOutputStream()
        parquet.write_table(pa.table(trend.columns()), sink)
        write_whole(path, bytes(sink.getvalue()))
    else:
        whole = [name in WHOLE for name in trend.names]  # each number reads back the same
        texts = (
            (str(int(x)) if is_whole else repr(x) for x, is_whole in zip(row, whole, strict=True)) for row in trend.rows
        )
        lines = map(",".join, texts)
        write_whole(path, "\n".join((",".join(trend.names), *lines)) + "\n")
    return path
