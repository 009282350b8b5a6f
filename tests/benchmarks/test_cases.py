"""Drawn cases: reproducible, sound, and what they are labelled to be."""

import math

import numpy as np
import pytest
from cases import diagnosis, identification, traps
from cases.case import interval
from cases.loop import Controller, Upsets, performance, run
from cases.plant import FAMILIES, HeldPlant, best_pi, best_pid, draw, half_rule, kc_bound, robustness, sampled, simc_of
from scipy import signal

from retuner.adaptive.identification.identify import identify_manual
from retuner.adaptive.loop.margins import margins
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

SEED = 99


def sound(case):
    record = case.record
    Window(record.t, record.sp, record.pv, record.co)  # finite, of one length, time increasing
    slack = 1e-9 * (case.co_max - case.co_min)
    assert record.co.min() >= case.co_min - slack
    assert record.co.max() <= case.co_max + slack
    assert 100 <= len(record.t) <= 2600


def same(one, two):
    return all(
        np.array_equal(a, b)
        for a, b in zip(
            (one.record.t, one.record.sp, one.record.pv, one.record.co),
            (two.record.t, two.record.sp, two.record.pv, two.record.co),
            strict=True,
        )
    )


@pytest.mark.slow
@pytest.mark.parametrize("group", identification.GROUPS)
def test_identification_cases(group):
    index = identification.GROUPS.index(group)
    case = identification.case(SEED, index)
    assert case.group == group
    assert same(case, identification.case(SEED, index))
    sound(case)
    assert (case.gains is None) == (group in identification.MANUAL)
    assert np.ptp(case.record.pv) > 10 * case.noise
    if group == "saturated":
        assert np.mean((case.record.co <= case.co_min) | (case.record.co >= case.co_max)) > 0.005
    if group == "irregular time":
        assert np.ptp(np.diff(case.record.t)) > 0.1 * case.dt_s


def test_another_seed_is_another_case():
    assert not same(identification.case(SEED, 2), identification.case(SEED - 1, 2))


@pytest.mark.parametrize("cause", diagnosis.CAUSES)
def test_the_eight_causes(cause):
    index = diagnosis.CAUSES.index(cause)
    case = diagnosis.case(SEED, index)
    assert case.right == {cause}
    assert same(case, diagnosis.case(SEED, index))
    sound(case)
    found = margins(sampled(case.process, case.dt_s), case.gains)
    assert found.stable
    if cause == "aggressive":
        assert found.ms > 2.2
        assert found.gm < 2.3
    elif cause == "slow_integrating":
        assert found.ms > 2.1
        assert found.gm > 3.9
    elif cause == "sluggish":
        assert found.ms < 1.65
    else:
        assert found.ms < 2.1


@pytest.mark.parametrize("trap", list(traps.TRAPS))
def test_traps(trap):
    index = list(traps.TRAPS).index(trap)
    case = traps.case(SEED, index)
    assert case.group == trap
    assert case.right
    assert same(case, traps.case(SEED, index))
    sound(case)


def test_a_sticking_valve_cycles_through_the_whole_record():
    for index in range(4, 28, 8):
        case = diagnosis.case(SEED, index)
        error = case.record.pv - case.record.sp
        swing = np.ptp(np.percentile(error, [10, 90]))
        assert all(np.ptp(part) > 0.5 * swing for part in np.array_split(error, 3))


def test_the_bound_grows_with_the_noise_and_is_absent_where_it_is_not_modelled():
    from dataclasses import replace

    case = next(c for c in identification.cases(SEED, 40, "setpoint") if c.family in {"first", "second", "integrating"})
    one, two = kc_bound(case), kc_bound(replace(case, noise=2 * case.noise))
    assert 0 < one < 1
    assert two == pytest.approx(2 * one, rel=1e-6)
    assert np.isnan(kc_bound(replace(case, group="ramp drift")))


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"), [(10, 10, 0.7225, 1.0), (95, 100, 0.8882, 0.9785), (0, 5, 0, 0.4345)]
)
def test_intervals_as_published(hits, n, low, high):
    assert interval(hits, n) == pytest.approx((low, high), abs=2e-4)


# ---- Simulated loops against formulas: step responses, half rule, robustness, performance


def step_response(process, h, n=120):
    plant = HeldPlant(process, h)
    return np.arange(n + 1) * h, np.array([0.0, *(plant.move(1.0) for _ in range(n))])


@pytest.mark.parametrize("theta", [0.0, 0.25, 1.0, 1.37, 4.999])
def test_first_order_with_any_dead_time(theta):
    t, y = step_response(LinearProcess(-3.0, (2.0,), (), theta), 0.25)
    late = np.maximum(t - theta, 0)
    assert y == pytest.approx(-3.0 * (1 - np.exp(-late / 2.0)), abs=1e-11)


def test_pair_of_complex_poles():
    zeta, period, theta = 0.4, 1.5, 0.77
    t, y = step_response(LinearProcess(2.0, (), (), theta, 0, ((2 * zeta * period, period**2),)), 0.2)
    late = np.maximum(t - theta, 0)
    root = math.sqrt(1 - zeta**2)
    swing = np.exp(-zeta * late / period) / root * np.sin(root * late / period + math.acos(zeta))
    assert y == pytest.approx(2.0 * (1 - swing), abs=1e-11)


def test_integrator_with_lag():
    t, y = step_response(LinearProcess(0.5, (3.0,), (), 1.3, 1), 0.5)
    late = np.maximum(t - 1.3, 0)
    assert y == pytest.approx(0.5 * (late - 3.0 * (1 - np.exp(-late / 3.0))), abs=1e-10)


def test_inverse_response_of_high_order_with_lags_far_apart():
    process = LinearProcess(1.7, (5.0, 1.0, 0.02), (-0.8,), 0.0)
    t, y = step_response(process, 0.1)
    den = np.polymul(np.polymul([5.0, 1], [1.0, 1]), [0.02, 1])
    _, exact = signal.step(signal.lti(1.7 * np.array([-0.8, 1]), den), T=t)
    assert y == pytest.approx(exact, abs=1e-9)
    assert y.min() < -0.05


def test_as_many_leads_as_lags_are_refused():
    with pytest.raises(ValueError, match="no room"):
        HeldPlant(LinearProcess(1.0, (2.0,), (-1.0,)), 0.1)


@pytest.mark.parametrize(
    ("lags", "leads", "theta", "order", "expected"),
    [
        ((1.0, 0.2), (), 0.0, 1, (0.1, 1.1, 0.0)),
        ((2, 1, 0.4, 0.2, 0.05, 0.05, 0.05), (-0.3,), 0.0, 2, (0.3 + 0.2 + 0.2 + 0.15, 2.0, 1.2)),
        ((1.0,) * 4, (), 0.0, 1, (2.5, 1.5, 0.0)),
        ((5, 3, 0.5), (-0.1,), 0.0, 1, (2.1, 6.5, 0.0)),
        ((12, 3, 0.2, 0.05), (-1,), 1.0, 1, (3.75, 13.5, 0.0)),
        ((12, 3, 0.2, 0.05), (-1,), 1.0, 2, (2.15, 12.0, 3.1)),
        ((20, 5, 5), (-10,), 10.0, 1, (27.5, 22.5, 0.0)),
    ],
)
def test_half_rule(lags, leads, theta, order, expected):
    model = half_rule(LinearProcess(1.0, tuple(map(float, lags)), tuple(map(float, leads)), theta), order)
    assert (model.theta_s, model.tau1_s, model.tau2_s) == pytest.approx(expected)


def test_half_rule_gives_an_integrating_process_its_lags_as_dead_time():
    process = LinearProcess(0.1, (2.0, 1.0), (), 0.5, 1)
    assert half_rule(process) == ProcessModel(ProcessType.INTEGRATING, 0.1, 0.0, 0.0, 3.5)
    assert half_rule(process, 2) == ProcessModel(ProcessType.INTEGRATING_LAG, 0.1, 0.0, 2.5, 1.0)


@pytest.mark.parametrize(("lags", "integrators", "ms", "gm"), [((5.0,), 0, 1.59, 3.14), ((), 1, 1.70, 2.96)])
def test_robustness_of_simc_as_published(lags, integrators, ms, gm):
    process = LinearProcess(2.0, lags, (), 1.0, integrators)
    found = robustness(process, best_pi(process, 0.0))
    assert (found.ms, found.gm) == (pytest.approx(ms, abs=0.01), pytest.approx(gm, abs=0.01))


@pytest.mark.parametrize("family", FAMILIES)
def test_robustness_agrees_with_retuner_on_every_family(family):
    rng = np.random.default_rng(7)
    for factor in (0.3, 1.0, 2.5, 8.0):
        process = draw(rng, family)
        best = best_pi(process, 0.0)
        gains = PidGains(best.kp * factor, best.ki * factor)
        ours, theirs = robustness(process, gains), margins(process, gains)
        assert ours.stable == theirs.stable
        if ours.stable:
            assert ours.ms == pytest.approx(theirs.ms, rel=3e-3)


def test_complex_poles_are_tuned_to_an_ms_of_no_more_than_1_8():
    process = LinearProcess(1.0, (), (), 1.0, 0, ((0.8, 1.0),))
    assert robustness(process, simc_of(half_rule(process), 2.0)).ms > 1.85
    assert robustness(process, best_pi(process, 0.0)).ms == pytest.approx(1.78, abs=0.03)


def test_performance_is_one_for_the_reference_and_knows_the_integrated_load_error():
    process = LinearProcess(1.0, (8.0,), (), 1.0)
    best = best_pi(process, 0.05)
    assert performance(process, best, best, 1.0, 0.05) == pytest.approx(1.0)
    slower = PidGains(best.kp / 2, best.ki / 2)
    n = 4000
    load = run(process, Controller(slower), 0.05, Upsets(np.zeros(n), load=np.ones(n)))
    assert np.sum(load.sp - load.pv) * 0.05 == pytest.approx(-1 / slower.ki, rel=1e-3)
    assert math.isinf(performance(process, PidGains(best.kp * 5, best.ki * 5), best, 1.0, 0.05))


def test_pid_only_where_there_is_a_second_lag():
    assert best_pid(LinearProcess(1.0, (3.0,), (), 1.0), 0.1) is None
    found = best_pid(LinearProcess(1.0, (3.0, 2.0), (), 1.0), 0.0)
    assert found is not None
    assert found.kd == pytest.approx(1.5 * 2.0)  # kc = 3 / (1 + 1), kd = kc tau_d


@pytest.mark.slow
def test_a_start_in_motion_that_leaves_no_process_does_not_outvote_one_from_rest():
    record = identification.case(9821, 52, None).record  # the other sign, with a dead time of most of the record
    found = identify_manual(Window(record.t, record.sp, record.pv, record.co))
    assert found.identifiable
    assert found.log.type is ProcessType.INTEGRATING
