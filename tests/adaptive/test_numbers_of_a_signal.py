"""Medians and quantiles without numpy.ma are numpy's to the last digit, and a signal is looked at once."""

import subprocess
import sys

import numpy as np
import pytest

from retuner.adaptive.signals.sample import (
    MOST_KEPT,
    FloatArray,
    distinct,
    kept_of_signal,
    least_squares,
    median,
    quantile,
)


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101, 1000])
@pytest.mark.parametrize("decimals", [0, 2, 12])
def test_they_are_numpys_to_the_last_digit(n: int, decimals: int) -> None:
    values = np.round(np.random.default_rng(n).normal(0.0, 30.0, n), decimals)
    assert median(values) == np.median(values)
    assert np.array_equal(distinct(values), np.unique(values))
    for share in (0.0, 0.05, 0.5, 0.9, 0.999, 1.0):
        assert quantile(values, share) == np.quantile(values, share), share
    assert np.isnan(median([]))


@pytest.mark.parametrize(("n", "columns", "signals"), [(5, 3, 0), (256, 2, 1), (300, 4, 2), (1600, 20, 0), (30, 30, 3)])
def test_least_squares_by_rows_are_those_of_all_at_once(n: int, columns: int, signals: int) -> None:
    rng = np.random.default_rng(n)
    a, y = rng.normal(size=(n, columns)), rng.normal(size=(n, signals) if signals else n)
    found = least_squares(a, y)
    assert found.shape == ((columns, signals) if signals else (columns,))
    assert found == pytest.approx(np.linalg.lstsq(a, y, rcond=None)[0], rel=1e-9, abs=1e-10)


def test_least_squares_of_columns_that_say_the_same_are_the_shortest() -> None:
    a = np.stack([np.ones(500), np.ones(500), np.arange(500.0)], axis=1)
    y = np.random.default_rng(1).normal(size=500)
    assert least_squares(a, y) == pytest.approx(np.linalg.lstsq(a, y, rcond=None)[0], rel=1e-9)


def test_what_is_kept_of_a_signal_is_of_its_values_not_of_the_array() -> None:
    asked = []

    @kept_of_signal
    def size(x: FloatArray) -> float:
        asked.append(len(x))
        return float(np.sum(x))

    x = np.arange(5.0)
    assert (size(x), size(x.copy()), size(x[::-1].copy())) == (10.0, 10.0, 10.0)
    x[0] = 7.0  # the array is another signal now
    assert size(x) == 17.0
    assert asked == [5, 5, 5]
    long = np.zeros(MOST_KEPT + 1)
    assert size(long) == size(long) == 0.0
    assert asked[3:] == [len(long), len(long)]  # long ones would take the room


def test_a_diagnosis_loads_neither_numpy_ma_nor_scipy() -> None:
    code = """if True:
        import sys, numpy as np
        from retuner import diagnose
        rng, t = np.random.default_rng(1), np.arange(400.0)
        sp, pv, co, y = np.where(t % 200 < 100, 50.0, 55.0), [], [], 50.0
        for at in sp:
            pv.append(y + 0.02 * rng.normal()); co.append(50.0 + 1.2 * (at - pv[-1])); y += 0.1 * (co[-1] - y)
        diagnose(t, sp, pv, co)
        print([name for name in ("numpy.ma", "scipy", "pandas", "pyarrow") if name in sys.modules])"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
