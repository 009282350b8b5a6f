"""The samples of a recorded session: its trend, or, while it goes on or after it was killed, what its bus log holds."""

import itertools
from pathlib import Path

import numpy as np

from retuner.drivers.bus.bus_log import log_parts
from retuner.drivers.recorded.bus_log_samples import Overhearing
from retuner.drivers.recorded.frame_log import read_parts
from retuner.drivers.recorded.recording import RecordingError
from retuner.errors import UserError
from retuner.ledger.trend import COLUMNS, COLUMNS_2, NO_PYARROW
from retuner.report.scores import Columns
from retuner.session.outputs import BUS_LOG, TREND
from retuner.session.recorded_session import RecordedSession

FROM_LOG = ("t", "sp", "pv", "co", "region")
"""Columns that a bus log gives; the region is not in it and reads 0."""


def recorded_columns(session: RecordedSession) -> Columns:
    """The samples by column.

    Raises
    ------
    UserError
        There is neither a trend nor a bus log with samples, or the trend is none of ours.
    """
    csv, parquet = (session.folder / TREND).with_suffix(".csv"), (session.folder / TREND).with_suffix(".parquet")
    if csv.is_file():
        return _csv(csv)
    if parquet.is_file():
        return _parquet(parquet)
    try:
        # The samples of the bus log; without its beginning, in which the host got to know the device, as a
        # bystander
        config = session.config
        whole = not log_parts(session.bus_log).gone
        heard = Overhearing(config.bus.node, config.loop.sample_time_s, as_host=whole)
        joined = (heard.take(message) for message in read_parts(session.bus_log))
        rows = [(s.sample.t_s, s.sample.sp, s.sample.pv, s.sample.co, 0.0) for s in joined if s is not None]
        if not rows:
            raise UserError(f"{session.bus_log}: holds no samples of the loop")
        table = np.array(list(itertools.chain.from_iterable(rows)), dtype=np.float64).reshape(-1, len(FROM_LOG))
        return {name: table[:, i] for i, name in enumerate(FROM_LOG)}
    except RecordingError as error:
        raise UserError(f"{session.folder}: has no trend, and its bus log cannot be used: {error}") from None


def _csv(path: Path) -> Columns:
    with path.open(encoding="utf-8") as file:
        head = file.readline().strip()
        names = next((known for known in (COLUMNS, COLUMNS_2) if head == ",".join(known)), None)
        if names is None:
            raise UserError(f"{path}: line 1: is not the head of a trend that a run has left")
        lines = file.readlines()
    for number, line in enumerate(lines, start=2):
        if line.count(",") != len(names) - 1:
            there = f"{line.count(',') + 1} of {len(names)} columns"
            raise UserError(
                f"{path}:{number}: is damaged, {there}; without this file the report is made from {BUS_LOG}"
            )
    try:
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
    except ValueError as error:
        raise UserError(f"{path}: is damaged: {error}") from None
    return _checked(path, {name: table[:, i] for i, name in enumerate(names)} if table.size else {})


def _parquet(path: Path) -> Columns:
    try:
        from pyarrow import ArrowException, parquet  # noqa: PLC0415  an extra, loaded when wanted
    except ImportError:
        raise UserError(f"{path}: {NO_PYARROW}") from None
    try:
        table = parquet.read_table(path)
    except (ArrowException, OSError) as error:
        raise UserError(f"{path}: is damaged: {error}") from None
    return _checked(path, {name: table[name].to_numpy().astype(np.float64) for name in table.column_names})


def _checked(path: Path, columns: Columns) -> Columns:
    if not set(FROM_LOG) <= columns.keys():
        raise UserError(f"{path}: holds no samples of a run")
    for name in FROM_LOG:
        if not np.all(np.isfinite(columns[name])):
            raise UserError(f"{path}: column {name} holds a value that is not a finite number")
    return columns
