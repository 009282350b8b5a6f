"""The trend: what goes in comes out, and a run that never ends does not fill the memory."""

import csv
from pathlib import Path

import numpy as np

from retuner import LoopSample, PidGains
from retuner.ledger.trend import COLUMNS, Trend, write_trend

GAINS = PidGains(0.1, 1e-9, 3.0)


def filled(samples: int, most: int = 10**6) -> Trend:
    trend = Trend(most)
    for i in range(samples):
        trend.add(LoopSample(0.5 * i, 50.0, 50 + i / 7, 30.25, 1, -1, 50.0, 3), 1, GAINS)
    return trend


def test_rows_come_back_exactly() -> None:
    trend = filled(100)
    assert len(trend.rows) == 100
    assert trend.rows[-1] == (49.5, 50.0, 50 + 99 / 7, 30.25, 50.0, 1, -1, 1, 3, 0.1, 1e-9, 3.0)
    assert list(trend.columns()) == list(COLUMNS)
    assert np.array_equal(trend.columns()["t"], 0.5 * np.arange(100))
    assert Trend().columns()["t"].shape == (0,)


def test_the_file_reads_back_exactly(tmp_path: Path) -> None:
    trend = filled(20)
    with write_trend(tmp_path / "trend", trend, "csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert tuple(rows[0]) == COLUMNS
    assert [tuple(map(float, row)) for row in rows[1:]] == list(trend.rows)
    assert rows[1][5:9] == ["1", "-1", "1", "3"]


def test_a_trend_without_end_keeps_the_last_rows_whole_and_the_first_ones_coarsely() -> None:
    trend = filled(10_000, most=1000)
    t = trend.columns()["t"]
    assert len(trend.rows) < 1000
    assert trend.rows.thinned > 10
    assert np.array_equal(t[-400:], 0.5 * np.arange(9600, 10_000))
    assert t[0] == 0.0
    assert np.all(np.diff(t) > 0)
    assert np.diff(t).max() > 100
