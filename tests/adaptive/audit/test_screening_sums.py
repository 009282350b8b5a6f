"""What is counted over a whole record: the compiled pass and numpy count the same; swings at every pace are found."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.audit.lasting_swing import lasting_swing
from retuner.adaptive.audit.loop_screen import screen_loop
from retuner.adaptive.audit.record_sums import Measure, RecordSums, counted, record_sums
from retuner.adaptive.fit import engine
from retuner.adaptive.signals.sample import FloatArray, Window


def drawn_record(seed: int, n: int) -> Window:
    """Any clock, with gaps; signals that wander, stand still, repeat and stand at limits."""
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.choice([1.0, 1.0, 1.0, 1.3, 40.0], n)) * 10 ** rng.uniform(-2, 2)
    values, held = rng.normal(size=n), rng.integers(1, n + 1)
    sp = values[np.arange(n) // held] * 10 ** rng.uniform(-3, 3)
    pv = sp + np.round(np.cumsum(rng.normal(size=n)), int(rng.integers(0, 4))) + rng.choice([0.0, 1e3])
    co = np.clip(np.repeat(np.cumsum(rng.normal(size=n)), rng.integers(1, 9))[:n], -2.0, 3.0)
    return Window(t_s, sp, pv, co)


def numbers(sums: RecordSums) -> FloatArray:
    plain = [x for name in sums.__slots__ if isinstance(x := getattr(sums, name), float)]
    return np.concatenate([plain, astuple(sums.low), astuple(sums.high), sums.covariance])


@given(st.integers(0, 2**32), st.integers(3, 5000), st.integers(1, 16), st.sampled_from([0.0, 0.4]))
def test_the_compiled_pass_counts_what_numpy_counts(seed: int, n: int, width: int, band: float) -> None:
    pytest.importorskip("retuner.adaptive.fit.compiled", reason="the compiled engine was not built: no compiler")
    record = drawn_record(seed, n)
    by = Measure(5 * record.sample_time_s, band, 20.0, min(width, n))
    scale = float(np.max(np.abs(record.pv))) ** 2 + 1.0

    np.testing.assert_allclose(numbers(record_sums(record, by)), numbers(counted(record, by)), 1e-9, 1e-12 * scale)


@pytest.mark.uncounted
def test_a_whole_screen_is_the_same_by_both_engines() -> None:
    record = drawn_record(4, 30_000)
    found = []
    for name in ("auto", "numpy"):
        with engine.using(name):
            found.append(screen_loop(record).to_dict())

    assert found[0] == {k: pytest.approx(v, rel=1e-6) if isinstance(v, float) else v for k, v in found[1].items()}


@pytest.mark.parametrize("period", [9.0, 60.0, 700.0, 6_000.0])
def test_a_swing_is_found_at_its_pace(period: float) -> None:
    n, rng = 60_000, np.random.default_rng(1)
    drift = np.cumsum(rng.normal(size=n)) * 0.003
    swing = lasting_swing(np.sin(2 * np.pi * np.arange(n) / period) + 0.4 * rng.normal(size=n) + drift, drift)

    wave, share = swing
    assert wave.period == pytest.approx(period, rel=0.03)
    assert share > 0.5


def test_noise_and_drift_do_not_swing() -> None:
    rng = np.random.default_rng(2)
    for signal in (rng.normal(size=40_000), np.cumsum(rng.normal(size=40_000)), np.zeros(40_000)):
        assert lasting_swing(signal, np.zeros(40_000)) is None


def test_a_limit_that_binds_costs_on_one_side() -> None:
    n, rng = 6000, np.random.default_rng(3)
    bound = (np.arange(n) // 1000) % 2 == 1
    co = np.where(bound, 100.0, 60 + np.cumsum(rng.normal(size=n)) * 0.1)
    record = Window(np.arange(n) * 10.0, np.zeros(n), rng.normal(size=n) * 0.1 - 2.0 * bound, co)
    screen = screen_loop(record)

    assert screen.at_limits == pytest.approx(0.5, abs=0.01)
    assert screen.loss_at_limits > 0.9
    assert screen.one_sided > 0.9
    free = screen_loop(replace(record, co=np.cumsum(rng.normal(size=n))))
    assert (free.at_limits, free.loss_at_limits) == (0.0, 0.0)


@given(st.integers(3, 130), st.integers(0, 5))
def test_a_record_of_any_length_is_screened(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wave = np.sin(np.arange(n) * rng.uniform(0.05, 3.0))
    co = rng.choice([wave, rng.normal(size=n), np.zeros(n), np.arange(n) % 2.0])
    screen = screen_loop(Window(10.0 * np.arange(n), np.zeros(n), wave + 0.1 * rng.normal(size=n), co))

    assert screen.samples == n
    assert 0 <= screen.swinging <= 1
