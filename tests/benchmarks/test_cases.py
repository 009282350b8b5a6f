"""Drawn cases: reproducible, sound, and what they are labelled to be."""

import numpy as np
import pytest
from cases import diagnosis, identification, traps
from cases.best import sampled
from cases.bound import kc_bound
from cases.counting import interval

from retuner.adaptive.loop.margins import margins
from retuner.adaptive.signals.sample import Window

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
