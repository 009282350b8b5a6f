"""Drawn cases: reproducible, sound, and what they are labelled to be."""

import math

import numpy as np
import pytest
from cases import diagnosis, identification, traps
from cases.case import interval
from cases.loop import Controller, Upsets, performance, run
from cases.plant import FAMILIES, HeldPlant, best_pi, draw, half_rule, robustness, sampled
from scipy import signal

from retuner import LinearProcess, PidGains, ProcessType
from retuner.adaptive.identification.identify import identify_manual
from retuner.adaptive.loop.margins import margins
from retuner.adaptive.signals.sample import Window

SEED = 99


def sound(case):
    record, low, high = case.record, case.loop.low, case.loop.high
    Window(*record)  # finite, of one length, time increasing
    slack = 1e-9 * (high - low)
    assert record.co.min() >= low - slack
    assert record.co.max() <= high + slack
    assert 100 <= len(record.t) <= 2600


def same(one, two):
    return all(np.array_equal(a, b) for a, b in zip(one.record, two.record, strict=True))


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
        assert np.mean((case.record.co <= case.loop.low) | (case.record.co >= case.loop.high)) > 0.005
    if group == "irregular time":
        assert np.ptp(np.diff(case.record.t)) > 0.1 * case.loop.dt_s


@pytest.mark.parametrize("cause", diagnosis.CAUSES)
def test_the_eight_causes(cause):
    index = diagnosis.CAUSES.index(cause)
    case = diagnosis.case(SEED, index)
    assert case.right == {cause}
    assert same(case, diagnosis.case(SEED, index))
    sound(case)
    found = margins(sampled(case.loop.process, case.loop.dt_s), case.gains)
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


def test_inverse_response_of_high_order_with_lags_far_apart():
    process = LinearProcess(1.7, (5.0, 1.0, 0.02), (-0.8,), 0.0)
    t, y = step_response(process, 0.1)
    den = np.polymul(np.polymul([5.0, 1], [1.0, 1]), [0.02, 1])
    _, exact = signal.step(signal.lti(1.7 * np.array([-0.8, 1]), den), T=t)
    assert y == pytest.approx(exact, abs=1e-9)
    assert y.min() < -0.05


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


def test_performance_is_one_for_the_reference_and_knows_the_integrated_load_error():
    process = LinearProcess(1.0, (8.0,), (), 1.0)
    best = best_pi(process, 0.05)
    assert performance(process, best, best, 1.0, 0.05) == pytest.approx(1.0)
    slower = PidGains(best.kp / 2, best.ki / 2)
    n = 4000
    load = run(process, Controller(slower), 0.05, Upsets(np.zeros(n), load=np.ones(n)))
    assert np.sum(load.sp - load.pv) * 0.05 == pytest.approx(-1 / slower.ki, rel=1e-3)
    assert math.isinf(performance(process, PidGains(best.kp * 5, best.ki * 5), best, 1.0, 0.05))


@pytest.mark.slow
def test_a_start_in_motion_that_leaves_no_process_does_not_outvote_one_from_rest():
    record = identification.case(9821, 52, None).record  # the other sign, with a dead time of most of the record
    found = identify_manual(Window(*record))
    assert found.identifiable
    assert found.log.type is ProcessType.INTEGRATING
