"""Setpoint steps to and fro under loads: the loop's own response is exact, and no load moves what is fitted to it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from loop_bench import GOOD, Bench, made, scaled

from retuner.adaptive.fit.structure import dynamics_at
from retuner.adaptive.identification.by_setpoint import Fitting, noise_filter, process_behind
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.loop.sampled import SampledLaw, setpoint_response
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model import sequences as of_region
from retuner.adaptive.region_model.sequences import update_by_sequences
from retuner.adaptive.region_model.update import Agreement, TrackerSettings
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.signals.setpoint_steps import LEAST_LEAD, SetpointSteps, setpoint_steps
from retuner.adaptive.signals.to_and_fro import to_and_fro
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import law, start, step

HOLD, SIZE, REST = 60, 0.5, 150
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


def sequences(count: int, walk: float, gains: PidGains = GOOD, seed: int = 1) -> list[SetpointSteps]:
    bench = made(gains, seed=seed)
    walks = walk * np.cumsum(np.random.default_rng(seed).standard_normal(count * (REST + 6 * HOLD)))
    found = []
    for load in walks.reshape(count, -1):
        samples = sequence(bench, load)
        steps = to_and_fro(samples)
        assert steps is not None
        one = setpoint_steps(samples, steps, gains, LAW)
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


def test_pv_without_loads_is_what_its_steps_make_of_the_loops_response() -> None:
    (one,) = sequences(1, 0.0)
    held = dynamics_at(ProcessType.FOPDT, TRUE).step(np.arange(one.reach, dtype=np.float64) - 5.0) / 50
    assert np.array(one.pv) == pytest.approx(one.said(setpoint_response(held, SampledLaw(GOOD, 1.0))), abs=0.05)


@pytest.mark.uncounted
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


def test_an_output_that_does_not_follow_its_law_shows_nothing() -> None:
    samples = sequence(made(GOOD), np.zeros(REST + 6 * HOLD))
    steps = to_and_fro(samples)
    assert steps is not None
    assert setpoint_steps(samples, steps, GOOD, LAW) is not None
    assert setpoint_steps(samples, steps, scaled(1.5, 1.0), LAW) is None


def test_an_output_at_a_limit_shows_nothing() -> None:
    samples = sequence(made(GOOD), np.zeros(REST + 6 * HOLD))
    samples[REST + 2 * HOLD] = samples[REST + 2 * HOLD]._replace(limited=1)
    steps = to_and_fro(samples)
    assert steps is not None
    assert setpoint_steps(samples, steps, GOOD, LAW) is None


def test_what_is_no_record_of_steps_is_refused() -> None:
    (one,) = sequences(1, 0.0)
    late = tuple(step._replace(at=step.at + len(one.pv)) for step in one.steps)
    for wrong in ({"pv": ()}, {"steps": ()}, {"steps": one.steps[::-1]}, {"steps": late}):
        with pytest.raises(ValueError, match="too few before or after them"):
            replace(one, **wrong)
    for dt_s in (0.0, float("nan")):
        with pytest.raises(ValueError, match="record of setpoint steps is not finite"):
            replace(one, dt_s=dt_s)


def test_loads_are_to_be_seen_by_themselves_before_the_steps() -> None:
    samples = sequence(made(GOOD), np.zeros(REST + 6 * HOLD))
    for left, seen in ((LEAST_LEAD - 1, False), (LEAST_LEAD, True)):
        late = samples[REST - left :]
        steps = to_and_fro(late)
        assert steps is not None
        assert (setpoint_steps(late, steps, GOOD, LAW) is not None) is seen


def test_the_filter_of_a_sinusoid_foretells_it() -> None:
    swing = np.sin(np.arange(400) / 20) + 1e-3 * np.random.default_rng(1).standard_normal(400)
    assert noise_filter([swing], 0.0).std < 0.05
    assert noise_filter([swing], 0.1).std > 0.1  # no structure is as good as that


def test_a_loop_that_would_run_away_explains_no_record() -> None:
    (one,) = sequences(1, WALK)
    found = process_behind([one], 1, FitSettings())
    assert found is not None
    fitting = Fitting([one], 1, *LAW)
    assert math.isfinite(fitting.deviance(found.log.type, found.log.x))
    for slope in (0.1, 1.0):  # one runs away slowly, the other from sample to sample
        assert math.isinf(fitting.deviance(ProcessType.INTEGRATING, np.log([slope, 30.0])))


def test_more_sequences_say_more_and_are_kept_with_the_model() -> None:
    every = sequences(4, WALK)
    few, many = (update_by_sequences(None, tuple(part), 1, TrackerSettings(), FitSettings(), LAW)
                 for part in (every[:1], every))  # fmt: skip
    assert few is not None
    assert many is not None
    assert many.agreement is Agreement.AGREES
    assert many.estimate.log.p[0, 0] < few.estimate.log.p[0, 0]
    assert many.region_model is not None
    again = region_model_in(json.loads(json.dumps(region_model_out(many.region_model), allow_nan=False)))
    assert again.sequences == many.region_model.sequences == tuple(every)


def test_sequences_under_other_gains_are_fitted_with_the_rest() -> None:
    both = (*sequences(2, WALK, scaled(0.5, 0.5)), *sequences(2, WALK))
    found = process_behind(both, 1, FitSettings())
    assert found is not None
    assert found.log.x[0] == pytest.approx(TRUE[0], abs=0.5)


def test_what_was_known_is_given_up_when_two_sequences_contradict_it() -> None:
    gains, law = scaled(0.5, 0.5), SampledLaw(scaled(0.5, 0.5), 1.0)
    old, new = sequences(2, 0.0, gains), sequences(2, 0.0, gains)
    held = dynamics_at(ProcessType.FOPDT, TRUE).step(np.arange(new[0].reach, dtype=np.float64) - 5.0) / 20
    odd = [replace(one, pv=tuple(one.said(setpoint_response(held, law)).tolist())) for one in new]
    known = update_by_sequences(None, tuple(old), 1, TrackerSettings(), FitSettings(), LAW)
    assert known is not None
    assert known.region_model is not None
    once = update_by_sequences(known.region_model, (*old, odd[0]), 1, TrackerSettings(), FitSettings(), LAW)
    assert once is not None
    assert once.region_model is not None
    assert once.agreement is Agreement.CONTRADICTS
    assert once.region_model.log.x == pytest.approx(known.region_model.log.x)
    twice = update_by_sequences(once.region_model, (*old, *odd), 1, TrackerSettings(), FitSettings(), LAW)
    assert twice is not None
    assert twice.region_model is not None
    assert twice.region_model.sequences == tuple(odd)
    assert twice.region_model.log.x[0] == pytest.approx(np.log(1 / 20), abs=0.1)


def test_no_more_are_kept_than_a_process_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_region, "MOST_SEQUENCES", 2)
    (one,) = sequences(1, 0.01)
    found = update_by_sequences(None, (one,) * 4, 1, TrackerSettings(), FitSettings(), LAW)
    assert found is not None
    assert found.region_model is not None
    assert len(found.region_model.sequences) == 2


def test_what_loads_do_by_themselves_is_told_of_the_stretches_of_one_set_of_gains() -> None:
    """A trial counts it as noise: without it the next upset of the load passed for a loop that runs away."""
    calm, full = (sequences(1, walk)[0].wander for walk in (0.01, WALK))
    assert full > 5 * calm
    bench = made(GOOD, seed=1)
    loads = WALK * np.cumsum(np.random.default_rng(1).standard_normal(2000))
    error = [sample.pv for load in loads for sample in bench.samples(1, 0.0, float(load), 10.0)]
    assert full == pytest.approx(float(np.std(error)), rel=0.6)
