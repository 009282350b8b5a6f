"""The Kalman filter over responses: its posterior is the fit's own, evidence accumulates, odd records do no harm."""

from collections.abc import Callable

import numpy as np
import pytest

from retuner.adaptive.belief import Belief
from retuner.adaptive.identify import FitSettings, identify_window
from retuner.adaptive.process import ProcessType
from retuner.adaptive.region_filter import update
from retuner.adaptive.tracker import Surprise, TrackerSettings, learn, predicted
from retuner.schedule.gains import PidGains

STILL = TrackerSettings(walk_per_day=0.0, walk_per_record=0.0, scatter=0.0)
FIT = FitSettings()
UP, DOWN = PidGains(2.0, 0.05), PidGains(-2.0, -0.05)
"""Gains in force."""


def records(loop: Callable, count: int, k: float = 1.0, first: int = 0) -> list:
    shapes = ({"sp": 1.0}, {"load": 3.0 / k})
    return [loop(k=k, noise=0.02, **shapes[i % 2]).run(seed=i, t0=i * 400.0) for i in range(first, first + count)]


def test_the_filters_posterior_is_the_fits_own(loop: Callable) -> None:
    first, second = records(loop, 2)
    belief = learn(None, first, UP, STILL, FIT).belief
    assert belief is not None
    estimate = identify_window(second, 1, belief.logs(), FIT)
    own = estimate.log
    assert own.type == ProcessType.FOPDT
    _, posterior = update(belief.logs()[own.type], estimate)
    sigma = np.sqrt(np.diag(own.p))
    np.testing.assert_allclose(posterior.x / sigma, own.x / sigma, atol=0.03)
    np.testing.assert_allclose(posterior.p, own.p, rtol=1e-6, atol=1e-9)


def test_evidence_accumulates(loop: Callable) -> None:
    belief, sigma = None, []
    for window in records(loop, 5):
        learned = learn(belief, window, UP, STILL, FIT)
        belief = learned.belief
        assert belief is not None
        sigma.append(belief.log.gain_uncertainty())
    assert belief is not None
    assert belief.records == 5
    assert sigma == sorted(sigma, reverse=True)
    assert sigma[-1] < 0.7 * sigma[0]
    truth = np.log([1 / 50.0, 5.0, 50.0])
    assert np.all(np.abs(belief.log.x - truth) < 4 * np.sqrt(np.diag(belief.log.p)))


def test_one_odd_record_is_not_believed_and_a_second_one_is(loop: Callable) -> None:
    belief = None
    for window in records(loop, 3):
        belief = learn(belief, window, UP, STILL, FIT).belief
    assert belief is not None
    odd, confirming = records(loop, 2, k=2.0, first=3)
    doubted = learn(belief, odd, UP, STILL, FIT)
    assert doubted.surprise == Surprise.ODD
    assert doubted.belief is not None
    np.testing.assert_array_equal(doubted.belief.log.x, belief.log.x)
    back = learn(doubted.belief, records(loop, 1, first=6)[0], UP, STILL, FIT)
    assert back.surprise == Surprise.AGREES
    changed = learn(doubted.belief, confirming, UP, STILL, FIT)
    assert changed.surprise == Surprise.CHANGED
    assert changed.belief is not None
    assert changed.belief.log.model().k == pytest.approx(2.0, rel=0.1)


def test_time_opens_the_uncertainty(loop: Callable) -> None:
    belief = learn(None, records(loop, 1)[0], UP, STILL, FIT).belief
    assert belief is not None
    walk = TrackerSettings(walk_per_day=0.1, walk_per_record=0.0, scatter=0.05)
    later = predicted(belief, belief.t_s + 4 * 86400, walk)
    np.testing.assert_allclose(later.p, belief.log.p + (0.04 + 0.0025) * np.eye(len(belief.log.x)), rtol=1e-9)
    np.testing.assert_array_equal(later.x, belief.log.x)


def test_a_first_record_that_says_nothing_leaves_nothing_known(loop: Callable) -> None:
    learned = learn(None, loop(noise=0.02).run(1), UP, STILL, FIT)
    assert learned.belief is None
    assert not learned.estimate.identifiable


def test_a_belief_of_the_other_sign_is_dropped(loop: Callable) -> None:
    window = records(loop, 1)[0]
    belief = learn(None, window, UP, STILL, FIT).belief
    assert belief is not None
    mirrored = type(window)(window.t_s, window.sp, window.pv, -window.co)
    learned = learn(Belief(belief.known, 3, 0.0), mirrored, DOWN, STILL, FIT)
    assert learned.surprise == Surprise.FIRST
