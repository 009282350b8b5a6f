"""Averages of setpoint steps to and fro: the loop's own response is exact, and no load moves what is fitted to it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from loop_bench import GOOD, Bench, made, scaled

from retuner.adaptive.fit.structure import dynamics_at
from retuner.adaptive.identification.averaged import process_behind
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.loop.sampled import SampledLaw, setpoint_response
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model import averages
from retuner.adaptive.region_model.averages import update_by_averages
from retuner.adaptive.region_model.update import Agreement, TrackerSettings
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.signals.to_and_fro import Averaged, averaged, to_and_fro
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import law, start, step

HOLD, SIZE, REST = 120, 0.5, 60
LAW = (1.0, 0.0)
WALK = 0.2  # of the load at every sample: pv is moved as much as by the steps
TRUE = np.log([1 / 50, 5.0, 50.0])  # slope gain, dead time, lag of the bench


def sequence(bench: Bench, load: np.ndarray) -> list[LoopSample]:
    """One to and fro, with the rest before and after it."""
    loads, seen = iter(load.tolist()), []
    for sp, n in ((0.0, REST), *((s * SIZE, HOLD) for s in (1, -1, 1, -1, 1)), (0.0, HOLD)):
        for _ in range(n):
            seen += list(bench.samples(1, sp, next(loads), 10.0))
    return seen


def sequences(count: int, walk: float, gains: PidGains = GOOD, seed: int = 1) -> list[Averaged]:
    bench = made(gains, seed=seed)
    walks = walk * np.cumsum(np.random.default_rng(seed).standard_normal(count * (REST + 6 * HOLD)))
    found = []
    for load in walks.reshape(count, -1):
        samples = sequence(bench, load)
        steps = to_and_fro(samples)
        assert steps is not None
        one = averaged(samples, steps, gains, LAW)
        assert one is not None
        found.append(one)
    return found


@pytest.mark.parametrize(("kd", "filter_s", "b"), [(0.0, 0.0, 1.0), (8.0, 2.0, 0.6)])
def test_the_response_is_that_of_the_control_law_sample_by_sample(kd: float, filter_s: float, b: float) -> None:
    gains, n = PidGains(GOOD.kp, GOOD.ki, kd), 300
    held = dynamics_at(ProcessType.FOPDT, TRUE).step(np.arange(n, dtype=np.float64) - 5.3) / 50
    pid = law(gains, b=b, tau_f_s=filter_s, co_min=-1e9, co_max=1e9)
    begun = start(pid, 0.0, 0.0, 0.0)
    state, moves, pv = (*begun[:4], begun[4]), [0.0] * n, np.zeros(n)
    last = 0.0
    for k in range(n):
        pv[k] = sum(moves[j] * held[k - j] for j in range(k))
        state, co = step(pid, state, 1.0, float(pv[k]), 1.0)
        moves[k], last = co - last, co
    found = setpoint_response(held, SampledLaw(gains, 1.0, b, filter_s))
    assert found == pytest.approx(pv, abs=1e-8)


def test_an_average_without_loads_is_what_its_steps_make_of_the_loops_response() -> None:
    (one,) = sequences(1, 0.0)
    held = dynamics_at(ProcessType.FOPDT, TRUE).step(np.arange(one.reach, dtype=np.float64) - 5.0) / 50
    assert np.array(one.pv) == pytest.approx(one.said(setpoint_response(held, SampledLaw(GOOD, 1.0))), abs=0.03)


def test_a_load_as_large_as_the_steps_leaves_the_process_and_how_surely_is_told() -> None:
    held = []
    for seed in range(1, 6):
        found = process_behind(sequences(2, WALK, seed=seed), 1, FitSettings(gain_std_limit=0.3))
        assert found is not None
        log = found.log
        error = float(log.x[0] - TRUE[0])
        held.append(abs(error) <= 2 * log.p[0, 0] ** 0.5)
        assert abs(error) < 0.6
    assert sum(held) >= 4


def test_an_output_that_does_not_follow_its_law_is_not_averaged() -> None:
    samples = sequence(made(GOOD), np.zeros(REST + 6 * HOLD))
    steps = to_and_fro(samples)
    assert steps is not None
    assert averaged(samples, steps, GOOD, LAW) is not None
    assert averaged(samples, steps, scaled(1.5, 1.0), LAW) is None


def test_an_output_at_a_limit_is_not_averaged() -> None:
    samples = sequence(made(GOOD), np.zeros(REST + 6 * HOLD))
    samples[REST + 2 * HOLD] = samples[REST + 2 * HOLD]._replace(limited=1)
    steps = to_and_fro(samples)
    assert steps is not None
    assert averaged(samples, steps, GOOD, LAW) is None


def test_what_is_no_average_is_refused() -> None:
    (one,) = sequences(1, 0.0)
    with pytest.raises(ValueError, match="none to average"):
        replace(one, pv=())
    with pytest.raises(ValueError, match="averaged response needs the scatter"):
        replace(one, scatter=(0.0,) * 9)
    for wrong in (0.0, float("nan")):
        with pytest.raises(ValueError, match="averaged response is not finite"):
            replace(one, dt_s=wrong)


def test_more_sequences_say_more_and_are_kept_with_the_model() -> None:
    every = sequences(4, WALK)
    few, many = (update_by_averages(None, tuple(part), 1, TrackerSettings(), FitSettings(), LAW)
                 for part in (every[:1], every))  # fmt: skip
    assert few is not None
    assert many is not None
    assert many.agreement is Agreement.AGREES
    assert many.estimate.log.p[0, 0] < few.estimate.log.p[0, 0]
    assert many.region_model is not None
    again = region_model_in(json.loads(json.dumps(region_model_out(many.region_model), allow_nan=False)))
    assert again.averages == many.region_model.averages == tuple(every)


def test_sequences_under_other_gains_are_fitted_with_the_rest() -> None:
    both = (*sequences(2, WALK, scaled(0.5, 0.5)), *sequences(2, WALK))
    found = process_behind(both, 1, FitSettings())
    assert found is not None
    assert found.log.x[0] == pytest.approx(TRUE[0], abs=0.5)


def test_of_a_process_that_has_changed_the_newest_stands_alone() -> None:
    old, new = sequences(2, 0.0, scaled(0.5, 0.5)), sequences(1, 0.0, scaled(0.5, 0.5))
    stretched = replace(new[0], pv=tuple(np.interp(np.arange(HOLD) / 2, np.arange(HOLD), new[0].pv).tolist()))
    found = update_by_averages(None, (*old, stretched), 1, TrackerSettings(), FitSettings(), LAW)
    assert found is not None
    assert found.agreement is Agreement.FIRST
    assert found.region_model is not None
    assert found.region_model.averages == (stretched,)


def test_no_more_are_kept_than_a_process_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(averages, "MOST_SEQUENCES", 2)
    (one,) = sequences(1, 0.01)
    found = update_by_averages(None, (one,) * 4, 1, TrackerSettings(), FitSettings(), LAW)
    assert found is not None
    assert found.region_model is not None
    assert len(found.region_model.averages) == 2


def test_what_loads_do_by_themselves_is_told_of_the_stretches_of_one_set_of_gains() -> None:
    """A trial counts it as noise: without it the next upset of the load passed for a loop that runs away."""
    calm, full = (sequences(1, walk)[0].wander for walk in (0.01, WALK))
    assert full > 5 * calm
    bench = made(GOOD, seed=1)
    loads = WALK * np.cumsum(np.random.default_rng(1).standard_normal(2000))
    error = [sample.pv for load in loads for sample in bench.samples(1, 0.0, float(load), 10.0)]
    assert full == pytest.approx(float(np.std(error)), rel=0.6)
