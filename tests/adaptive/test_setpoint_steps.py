"""Setpoint steps to and fro under loads: the loop's own response is exact, and no load moves what is fitted to it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from loop_bench import GOOD, Bench, made, scaled, table

from retuner import Mode, PidGains, ProcessType, Retuner, RetunerSettings
from retuner.adaptive.fit.record import Record, RestRatio, rest_ratios
from retuner.adaptive.fit.structure import dynamics_at
from retuner.adaptive.identification.by_setpoint import Fitting, noise_filter, process_behind
from retuner.adaptive.identification.estimate import LogModel, gain_spread
from retuner.adaptive.identification.identify import Fits, FitSettings
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.structure_choice import StructureSettings
from retuner.adaptive.indexes.condition import Condition, record_condition
from retuner.adaptive.loop.sampled import SampledLaw, setpoint_response
from retuner.adaptive.region_model import sequences as of_region
from retuner.adaptive.region_model.sequences import update_by_sequences
from retuner.adaptive.region_model.update import Agreement, TrackerSettings
from retuner.adaptive.signals.noise import coloured_sigma, noise_sigma, quantum_sigma, wander_before
from retuner.adaptive.signals.recogniser import START_BANDS
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import FloatArray, LoopSample, Window
from retuner.adaptive.signals.setpoint_steps import LEAST_LEAD, SetpointSteps, setpoint_steps
from retuner.adaptive.signals.step_sequence import step_sequence
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out, remember, restore
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
        steps = step_sequence(samples)
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


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_load_as_large_as_the_steps_leaves_the_process_and_how_surely_is_told() -> None:
    held = []
    for seed in range(1, 6):
        found = process_behind(sequences(2, WALK, seed=seed), 1, FitSettings(gain_std_limit=0.3))
        log = found.log
        error = float(log.x[0] - TRUE[0])
        held.append(abs(error) <= 2 * log.p[0, 0] ** 0.5)
        assert abs(error) < 0.6
    assert sum(held) >= 4


def test_an_output_that_does_not_follow_its_law_shows_nothing() -> None:
    samples = sequence(made(GOOD), np.zeros(REST + 6 * HOLD))
    steps = step_sequence(samples)
    assert steps is not None
    assert setpoint_steps(samples, steps, GOOD, LAW) is not None
    assert setpoint_steps(samples, steps, scaled(1.5, 1.0), LAW) is None


def test_an_output_at_a_limit_shows_nothing() -> None:
    samples = sequence(made(GOOD), np.zeros(REST + 6 * HOLD))
    samples[REST + 2 * HOLD] = samples[REST + 2 * HOLD]._replace(limited=1)
    steps = step_sequence(samples)
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
        steps = step_sequence(late)
        assert steps is not None
        assert (setpoint_steps(late, steps, GOOD, LAW) is not None) is seen


def test_the_filter_of_a_sinusoid_foretells_it() -> None:
    swing = np.sin(np.arange(400) / 20) + 1e-3 * np.random.default_rng(1).standard_normal(400)
    assert noise_filter([swing], 0.0).std < 0.05
    assert noise_filter([swing], 0.1).std > 0.1  # no structure is as good as that


def test_a_loop_that_would_run_away_explains_no_record() -> None:
    (one,) = sequences(1, WALK)
    found = process_behind([one], 1, FitSettings())
    fitting = Fitting([one], 1, *LAW)
    assert math.isfinite(fitting.deviance(found.log.type, found.log.x))
    for slope in (0.1, 1.0):  # one runs away slowly, the other from sample to sample
        assert math.isinf(fitting.deviance(ProcessType.INTEGRATING, np.log([slope, 30.0])))


@pytest.mark.slow
def test_more_sequences_say_more_and_are_kept_with_the_model() -> None:
    every = sequences(4, WALK)
    few, many = (update_by_sequences(None, tuple(part), 1, TrackerSettings(), FitSettings(), LAW)
                 for part in (every[:1], every))  # fmt: skip
    assert many.agreement is Agreement.AGREES
    assert many.estimate.log.p[0, 0] < few.estimate.log.p[0, 0]
    again = region_model_in(json.loads(json.dumps(region_model_out(many.region_model), allow_nan=False)))
    assert again.sequences == many.region_model.sequences == tuple(every)


@pytest.mark.slow
def test_sequences_under_other_gains_are_fitted_with_the_rest() -> None:
    both = (*sequences(2, WALK, scaled(0.5, 0.5)), *sequences(2, WALK))
    found = process_behind(both, 1, FitSettings())
    assert found.log.x[0] == pytest.approx(TRUE[0], abs=0.5)


@pytest.mark.slow
def test_what_was_known_is_given_up_when_two_sequences_contradict_it() -> None:
    gains, law = scaled(0.5, 0.5), SampledLaw(scaled(0.5, 0.5), 1.0)
    old, new = sequences(2, 0.0, gains), sequences(2, 0.0, gains)
    held = dynamics_at(ProcessType.FOPDT, TRUE).step(np.arange(new[0].reach, dtype=np.float64) - 5.0) / 20
    odd = [replace(one, pv=tuple(one.said(setpoint_response(held, law)).tolist())) for one in new]
    known = update_by_sequences(None, tuple(old), 1, TrackerSettings(), FitSettings(), LAW)
    assert known.region_model is not None
    once = update_by_sequences(known.region_model, (*old, odd[0]), 1, TrackerSettings(), FitSettings(), LAW)
    assert once.agreement is Agreement.CONTRADICTS
    assert once.region_model.log.x == pytest.approx(known.region_model.log.x)
    twice = update_by_sequences(once.region_model, (*old, *odd), 1, TrackerSettings(), FitSettings(), LAW)
    assert twice.region_model.sequences == tuple(odd)
    assert twice.region_model.log.x[0] == pytest.approx(np.log(1 / 20), abs=0.1)


def test_no_more_are_kept_than_a_process_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_region, "MOST_SEQUENCES", 2)
    (one,) = sequences(1, 0.01)
    found = update_by_sequences(None, (one,) * 4, 1, TrackerSettings(), FitSettings(), LAW)
    assert len(found.region_model.sequences) == 2


def test_what_loads_do_by_themselves_is_told_of_the_stretches_of_one_set_of_gains() -> None:
    """A trial counts it as noise: without it the next upset of the load passed for a loop that runs away."""
    calm, full = (sequences(1, walk)[0].wander for walk in (0.01, WALK))
    assert full > 5 * calm
    bench = made(GOOD, seed=1)
    loads = WALK * np.cumsum(np.random.default_rng(1).standard_normal(2000))
    error = [sample.pv for load in loads for sample in bench.samples(1, 0.0, float(load), 10.0)]
    assert full == pytest.approx(float(np.std(error)), rel=0.6)


# ---- What pv and co at rest say of the gain: a load that is invented against it loses, one that came does not

K = 2.0
NO_ZERO = FitSettings(StructureSettings(further=()))


def record(seed: int, *, sp: float = 1.0, load: float = 0.0, load_at: int = 90, inverse: float = 0.0) -> Window:
    """PI on a gain of 2, lags of 12 and 5 s, a dead time of 3 s and perhaps a zero; 1 % noise, the step at 60 s."""
    rng, n, delay = np.random.default_rng(seed), 400, 3
    pv, co, wanted = np.zeros(n), np.zeros(n), np.where(np.arange(n) >= 60, sp, 0.0)
    a, b, integral = 0.0, 0.0, 0.0
    for i in range(n):
        pv[i] = b - inverse * (a - b) / 5.0 + 0.01 * rng.standard_normal()
        integral += 0.25 / 17 * (wanted[i] - pv[i])
        co[i] = 0.25 * (wanted[i] - pv[i]) + integral
        entered = (co[i - delay] if i >= delay else 0.0) + (load if i >= load_at else 0.0)
        a += (K * entered - a) / 12.0
        b += (a - b) / 5.0
    return Window(np.arange(float(n)), wanted, pv, co)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_gain_at_rest_is_measured(seed: int) -> None:
    (found,) = rest_ratios(record(seed))
    assert abs(found.ratio - 1 / K) < 2 * found.std
    assert found.std < 0.1 / K


def test_a_record_without_setpoint_steps_has_no_ratio() -> None:
    assert rest_ratios(record(1, sp=0.0, load=1.0)) == ()
    assert Record.of(record(1)).rests == rest_ratios(record(1))


def test_what_a_contradiction_costs_has_an_end() -> None:
    at_rest = RestRatio(0.5, 0.025, 1.0)
    lag = np.log([1 / 12, 3.0, 24.0])  # k = 2
    assert at_rest.cost(ProcessType.FOPDT, lag, 1) == pytest.approx(0.0, abs=1e-6)
    tripled = np.log([3 / 12, 3.0, 24.0])
    assert 8 < at_rest.cost(ProcessType.FOPDT, tripled, 1) < at_rest.cost(ProcessType.FOPDT, lag, -1) < 15
    assert at_rest.cost(ProcessType.INTEGRATING, np.log([0.1, 3.0]), 1) > 8
    assert RestRatio(0.0, 0.025, 1.0).cost(ProcessType.INTEGRATING, np.log([0.1, 3.0]), 1) == pytest.approx(0.0)


def test_a_load_that_came_is_believed_against_the_rests() -> None:
    found = Fits(record(4, load=-0.4), (1,), FitSettings()).estimate(whatever_loads=True)
    (ratio,) = rest_ratios(record(4, load=-0.4))
    assert ratio.ratio > 1.5 / K  # the load is in it
    assert found.log.model().k == pytest.approx(K, rel=0.15)
    assert any(t == pytest.approx(90.0, abs=6.0) for t in found.load_times_s)


def test_two_lags_that_are_equal_are_known_as_well_as_two_that_are_not() -> None:
    """A derivative of the settings is infinite there: the gain once passed for uncertain by a factor of 2.3."""
    covariance = np.diag([0.02, 0.02, 0.03, 0.03]) ** 2
    logs = [LogModel(np.log([0.4, 1.3, 2.4, 2.4 * c2]), covariance, 1, ProcessType.SOPDT) for c2 in (0.2499, 0.2)]
    stds = [log.gain_uncertainty() for log in logs]
    assert max(stds) < 0.1
    drawn = np.random.default_rng(5).multivariate_normal(logs[0].x, covariance, 400)
    around = [Plausible(LogModel(x, covariance, 1, ProcessType.SOPDT).model(), 0.0) for x in drawn]
    assert 1.0 < stds[0] / gain_spread(around, 0.0) < 2.0
    assert math.isfinite(logs[0].std()["tau2"])
    assert logs[0].std()["tau2"] < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 6])
def test_a_load_invented_for_want_of_a_zero_loses_to_the_rests(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the structure that the process has, a load at the step pays; the gain that it brings is not the one."""
    window = record(seed, inverse=6.0)
    found = Fits(window, (1,), NO_ZERO).estimate()
    assert found.log.model().k == pytest.approx(K, rel=0.1)
    monkeypatch.setattr("retuner.adaptive.identification.candidate._at_rest", lambda _fit: 0.0)
    again = replace(window, t_s=window.t_s + 1.0)  # the fit of one record is kept
    assert Fits(again, (1,), NO_ZERO).estimate().log.model().k > 1.15 * K


# ---- The noise of a loop: honest where it is coloured or its sensor coarse

N = 1200


def noise(memory: float, seed: int, n: int = N) -> FloatArray:
    """Autoregressive noise of standard deviation one. memory : its time constant in samples, 0 for white."""
    rng = np.random.default_rng(seed)
    rho = math.exp(-1 / memory) if memory else 0.0
    found = np.zeros(n)
    found[0] = rng.standard_normal()
    for i in range(1, n):
        found[i] = rho * found[i - 1] + math.sqrt(1 - rho**2) * rng.standard_normal()
    return found


@pytest.mark.parametrize("memory", [1, 2, 4, 8, 16])
def test_noise_with_a_memory_is_told_whole_where_neighbours_show_a_part(memory: float) -> None:
    told = [coloured_sigma(noise(memory, seed), N) for seed in range(20)]
    assert np.median(told) == pytest.approx(1.0, rel=0.3)
    assert np.median([noise_sigma(noise(memory, seed)) for seed in range(20)]) < 0.81


def test_white_noise_is_left_to_the_differences_of_neighbours() -> None:
    told = [coloured_sigma(noise(0, seed), 100) for seed in range(50)]
    assert np.mean(np.array(told) > 0) <= 0.1


@pytest.mark.parametrize("quantum", [0.5, 1.0])
def test_a_coarse_sensor_does_not_hide_noise_with_a_memory(quantum: float) -> None:
    told = [coloured_sigma(np.round(noise(8, seed) / quantum) * quantum, N) for seed in range(20)]
    assert np.median(told) == pytest.approx(1.0, rel=0.4)


def test_what_is_slower_than_asked_for_is_no_noise() -> None:
    slow = np.linspace(0, 1, N) ** 2 * 50 + noise(0, 3)
    assert coloured_sigma(slow, 16) == 0.0


def loop(pv: FloatArray, sp_at: int) -> list[LoopSample]:
    """At rest, with the setpoint stepped late."""
    return [LoopSample(float(i), 40.0 if i >= sp_at else 0.0, float(y), 50.0) for i, y in enumerate(pv)]


def step_at(t_s: float, band: float) -> Response:
    return Response(t_s, float(N - 1), (), Ending.QUIET, True, band)


def test_what_wanders_before_a_step_is_told_and_a_motion_there_is_not_taken_for_it() -> None:
    pv, band = noise(8, 4), 4 * noise_sigma(noise(8, 4))
    assert START_BANDS * band < 3.0  # the band is so narrow that the noise leaves it
    assert wander_before(loop(pv, 800), step_at(800.0, band)) == pytest.approx(1.0, rel=0.35)
    moved = pv + np.where(np.arange(N) < 700, 30.0 * np.sin(np.arange(N) / 9), 0.0)
    assert wander_before(loop(moved, 800), step_at(800.0, band)) < 2.0
    assert wander_before(loop(pv, 30), step_at(30.0, band)) == 0.0  # too short to tell


def test_levels_of_a_sensor_are_a_quantum_even_where_the_end_of_its_range_cuts_one_off() -> None:
    pv = np.clip(np.round((3.0 * np.sin(np.arange(N) / 60) + 0.3 * noise(0, 5)) / 2.0) * 2.0, -5.0, 2.7)
    assert len(np.unique(pv)) <= 5
    assert noise_sigma(pv) >= 2.0 / math.sqrt(12.0)
    smooth = np.concatenate([np.zeros(N - 40), np.linspace(0.0, 1.0, 40) ** 1.7])  # levels of a motion, seen once each
    assert noise_sigma(smooth) == 0.0


# ---- What coarse signals look like: a pv in the steps of its sensor, a co that stands still in automatic

STEP = 0.1


def coarse() -> Bench:
    return Bench(Retuner(table(scaled(0.4, 0.4)), RetunerSettings(1.0, 10.0, Mode.AUTO)), noise=0.001, step=STEP)


def rise(n: int) -> FloatArray:
    return 1 - np.exp(-np.arange(n) / 8.0)


def test_a_short_response_shows_the_steps_of_its_sensor_though_few_values_come_twice() -> None:
    pv = np.round(rise(30) / 0.03) * 0.03
    assert len(np.unique(pv)) > len(pv) / 2
    assert quantum_sigma(pv) == pytest.approx(0.03 / math.sqrt(12))


@pytest.mark.parametrize("pv", [rise(30), np.arange(30.0), np.random.default_rng(0).standard_normal(30)])
def test_what_is_not_rounded_has_no_steps(pv: FloatArray) -> None:
    assert quantum_sigma(pv) == 0.0


def test_a_sensor_between_two_of_its_steps_is_at_rest_and_its_steps_survive_a_restart() -> None:
    bench = coarse()
    bench.run(1500, sp=1.04)
    assert bench.run(3000, sp=1.04) == []
    finder = bench.retuner.state().finder
    assert finder.rounding == pytest.approx(STEP / math.sqrt(12))
    again = restore(remember(bench.retuner), bench.retuner.settings)
    assert again.state().finder == finder


def test_a_coarse_sensor_is_learned_from_and_its_single_steps_are_no_responses() -> None:
    bench = coarse()
    assert [told.code for told in bench.exercise(2)] == ["accepted"]
    assert bench.retuner.region_models[0].identifiable
    assert bench.retuner.table.gains_of(0).kp > 1.5 * scaled(0.4, 0.4).kp


def test_a_co_that_stands_still_is_manual_only_where_nobody_says_that_it_is_automatic() -> None:
    t = np.arange(400.0)
    co = np.where(t < 300, 50.0, 50.0 + np.minimum((t - 300) / 10, 4))
    pv = np.where(t < 250, 0.0, 1.0) * np.sin(t / 30) + 0.01 * np.random.default_rng(1).standard_normal(400)
    window = Window(t, np.zeros(400), pv, co)
    assert record_condition(window).condition is Condition.MANUAL
    assert record_condition(window, in_auto=True).condition is not Condition.MANUAL
