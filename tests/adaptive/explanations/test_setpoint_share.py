"""How far a record is trusted: by the setpoint's share in what moves it; and processes that stand for all."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_loop import PRIOR, loop_record
from scipy.signal import lfilter

from retuner.adaptive.explanations.process_grid import gain_unit
from retuner.adaptive.explanations.settings_by_odds import likely_processes
from retuner.adaptive.explanations.tuning_odds import TuningLimits, TuningOdds, tuning_odds
from retuner.adaptive.explanations.wandering_load import (
    T_LOADS,
    T_SETPOINT,
    Prepared,
    log_likelihood,
    setpoint_share,
    temper,
)
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

GAINS = PidGains(1.0, 1.0 / 20.0)


def record(step: float) -> tuple[Prepared, FloatArray]:
    sp, pv, co = loop_record((1.0, 4, 20.0), GAINS, seed=5, step=step)
    return Prepared(pv - pv[0], co - co[0], 0.0, 1.0), sp - sp[0]


def odds() -> TuningOdds:
    one, _ = record(1.0)
    return tuning_odds(log_likelihood(one, 1, gain_unit(GAINS, 1.0)), GAINS, 1.0, PRIOR, TuningLimits())


def test_the_share_grows_with_the_setpoint_step_and_is_none_without() -> None:
    shares = [setpoint_share(*record(step), 20.0) for step in (0.0, 1.0, 4.0, 16.0)]
    assert shares[0] == (0.0, 0.0)
    assert shares == sorted(shares)
    assert shares[-1][0] > 0.8
    assert all(seen >= share for share, seen in shares)


def test_samples_that_show_noise_alone_do_not_hide_what_the_setpoint_does() -> None:
    """A level sampled ten times as fast, in as much more noise, is moved by its setpoint as much as before."""
    rng, n = np.random.default_rng(3), 2000
    load = 0.02 * np.cumsum(np.cumsum(rng.standard_normal(n))) / n
    sp = np.repeat([0.0, 3.0], [n // 2, n // 2])
    pv = lfilter([1 / 200.0], [1.0, -1.0 + 1 / 200.0], sp) + load + 0.5 * rng.standard_normal(n)
    co = sp - pv
    fast = Prepared(pv - pv[0], co - co[0], 0.0, 1.0)
    slow, to = (x.reshape(-1, 10).mean(axis=1) for x in (pv, sp))
    after = Prepared(slow - slow[0], (to - slow) - (to - slow)[0], 0.0, 10.0)
    (share, seen), (share_then, seen_then) = setpoint_share(fast, sp, 200.0), setpoint_share(after, to, 20.0)
    assert share < 0.6 * share_then
    assert seen == pytest.approx(seen_then, abs=0.1)


def test_the_share_has_no_unit() -> None:
    one, sp = record(4.0)
    scaled = replace(one, pv=1000.0 * one.pv)
    assert setpoint_share(scaled, 1000.0 * sp, 20.0) == pytest.approx(setpoint_share(one, sp, 20.0), rel=1e-6)


def test_the_temper_lies_between_that_of_loads_and_that_of_setpoints() -> None:
    assert temper(0.0) == pytest.approx(T_LOADS)
    assert temper(1.0) == pytest.approx(T_SETPOINT)
    assert T_SETPOINT < temper(0.5) < T_LOADS


def test_a_few_processes_have_the_ms_of_all() -> None:
    all_of_them = odds()
    few = likely_processes(all_of_them, 250)
    assert float(few.weights.sum()) == pytest.approx(1.0)
    for limit in (1.3, 1.6, 2.0):
        whole = float(all_of_them.weights[all_of_them.robustness.ms > limit].sum())
        assert float(few.weights @ (few.peaks(GAINS) > limit)) == pytest.approx(whole, abs=0.03)
