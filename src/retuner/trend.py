"""The trend of a run: every sample with the region and the gains that were in force."""

import importlib.util
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from retuner.adaptive.sample import FloatArray, LoopSample
from retuner.errors import UserError
from retuner.files import write_whole
from retuner.schedule.gains import PidGains

NO_PYARROW = 'output.trend = "parquet" needs pyarrow; pip install "retuner[parquet]", or set it to "csv"'
COLUMNS = ("t", "sp", "pv", "co", "x", "mode", "limited", "region", "sequence", "kp", "ki", "kd")
"""t in s, sp and pv in pv units, co in percent, region as index, sequence of the gain set, parallel gains."""


@dataclass(slots=True)
class Trend:
    """Rows of COLUMNS, in the order of time."""

    rows: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, sample: LoopSample, region: int, gains: PidGains) -> None:
        """Take one sample."""
        s = sample
        self.rows.append((s.t_s, s.sp, s.pv, s.co, s.x, s.mode, s.limited, region, s.revision,
                          gains.kp, gains.ki, gains.kd))  # fmt: skip

    def columns(self) -> dict[str, FloatArray]:
        """Arrays by column name, each of shape (n,)."""
        table = np.array(self.rows, dtype=np.float64).reshape(len(self.rows), len(COLUMNS))
        return {name: table[:, i] for i, name in enumerate(COLUMNS)}


def require_writer(kind: str) -> None:
    """Refuse a kind of trend that cannot be written here, before a run whose trend it would be.

    Raises
    ------
    UserError
        Parquet is wanted and pyarrow is not installed.
    """
    if kind == "parquet" and importlib.util.find_spec("pyarrow") is None:
        raise UserError(NO_PYARROW)


def write_trend(stem: Path, trend: Trend, kind: str) -> Path:
    """Write a trend as stem.csv or stem.parquet, whole or not at all; returns the path.

    Raises
    ------
    UserError
        Parquet is wanted and pyarrow is not installed.
    """
    path = stem.with_suffix(f".{kind}")
    if kind == "parquet":
        write_whole(path, _parquet(trend))
    else:
        lines = (",".join(repr(value) for value in row) for row in trend.rows)
        write_whole(path, "\n".join((",".join(COLUMNS), *lines)) + "\n")
    return path


def _parquet(trend: Trend) -> bytes:
    """The trend as the bytes of a Parquet file."""
    try:
        import pyarrow as pa  # noqa: PLC0415  an extra, loaded when wanted
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise UserError(NO_PYARROW) from None
    sink = pa.BufferOutputStream()
    parquet.write_table(pa.table(trend.columns()), sink)
    return bytes(sink.getvalue())
