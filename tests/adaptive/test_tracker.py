"""The Kalman filter over responses: its posterior is the fit's own, evidence accumulates, odd records do no harm."""

import functools
import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from retuner.adaptive.identification.identify import FitSettings, fitted, identify_window
from retuner.adaptive.identification.misfit import Misfit
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.kalman import update
from retuner.adaptive.region_model.region_model import Belief
from retuner.adaptive.region_model.update import Surprise, TrackerSettings, learn, predicted
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.supervision.state_file import belief_in, belief_out
from retuner.schedule.gains import PidGains

STILL = TrackerSettings(walk_per_day=0.0, walk_per_record=0.0, scatter=0.0)
SCATTERED = TrackerSettings()
FIT = FitSettings()
UP, DOWN = PidGains(2.0, 0.05), PidGains(-2.0, -0.05)
"""Gains in force."""


def records(loop: Callable, count: int, k: float = 1.0, first: int = 0) -> list:
    shapes = ({"sp": 1.0}, {"load": 3.0 / k})
    return [loop(k=k, noise=0.02, **shapes[i % 2]).run(seed=i, t0=i * 400.0) for i in range(first, first + count)]


@functools.cache
def learned_from(loop: Callable, count: int, settings: TrackerSettings, gains: PidGains = UP) -> tuple[Belief, ...]:
    """The beliefs after each of the first records; made once, as many tests begin with them."""
    beliefs: list[Belief] = []
    for window in records(loop, count):
        belief = learn(beliefs[-1] if beliefs else None, window, gains, settings, FIT).belief
        assert belief is not None
        beliefs.append(belief)
    return tuple(beliefs)


def test_the_filters_posterior_is_the_fits_own(loop: Callable) -> None:
    _, second = records(loop, 2)
    belief = learned_from(loop, 5, STILL)[0]
    estimate = identify_window(second, 1, belief.logs(), FIT)
    own = estimate.log
    assert own.type == ProcessType.FOPDT
    _, posterior = update(belief.logs()[own.type], estimate)
    sigma = np.sqrt(np.diag(own.p))
    np.testing.assert_allclose(posterior.x / sigma, own.x / sigma, atol=0.03)
    np.testing.assert_allclose(posterior.p, own.p, rtol=1e-6, atol=1e-9)


def test_evidence_accumulates(loop: Callable) -> None:
    beliefs = learned_from(loop, 5, STILL)
    belief, sigma = beliefs[-1], [belief.log.gain_uncertainty() for belief in beliefs]
    assert belief.records == 5
    assert sigma == sorted(sigma, reverse=True)
    assert sigma[-1] < 0.7 * sigma[0]
    truth = np.log([1 / 50.0, 5.0, 50.0])
    assert np.all(np.abs(belief.log.x - truth) < 4 * np.sqrt(np.diag(belief.log.p)))


def test_one_odd_record_is_not_believed_and_a_second_one_is(loop: Callable) -> None:
    belief = learned_from(loop, 5, STILL)[2]
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


@functools.cache
def with_rival(loop: Callable, theta_s: float) -> Belief:
    """Three records of a dead time of 5 s, then a setpoint step that shows another one."""
    belief = learned_from(loop, 3, SCATTERED)[-1]
    odd = learn(belief, loop(theta=theta_s, noise=0.02, sp=1.0).run(seed=9, t0=1200.0), UP, SCATTERED, FIT)
    assert odd.surprise == Surprise.ODD
    assert odd.belief is not None
    assert odd.belief.rival is not None
    return odd.belief


def test_a_record_that_fits_both_but_the_rival_better_confirms_it(loop: Callable) -> None:
    load = loop(theta=2.5, noise=0.05, load=3.0).run(seed=10, t0=1600.0)
    doubted = with_rival(loop, 2.5)
    assert learn(replace(doubted, rival=None), load, UP, SCATTERED, FIT).surprise == Surprise.AGREES
    changed = learn(doubted, load, UP, SCATTERED, FIT)
    assert changed.surprise == Surprise.CHANGED
    assert changed.belief is not None
    assert changed.belief.rival is None
    assert changed.belief.log.model().theta_s == pytest.approx(2.5, rel=0.2)


def test_a_record_that_cannot_tell_leaves_the_rival_until_one_can(loop: Callable) -> None:
    half_way = loop(theta=3.7, noise=0.08, load=3.0).run(seed=10, t0=1600.0)
    undecided = learn(with_rival(loop, 2.5), half_way, UP, SCATTERED, FIT)
    assert undecided.surprise == Surprise.AGREES
    assert undecided.belief is not None
    assert undecided.belief.rival is not None
    step = loop(theta=2.5, noise=0.02, sp=1.0).run(seed=11, t0=2000.0)
    changed = learn(undecided.belief, step, UP, SCATTERED, FIT)
    assert changed.surprise == Surprise.CHANGED


def test_a_record_that_speaks_clearly_against_the_rival_forgets_it(loop: Callable) -> None:
    same = loop(noise=0.02, sp=-1.0).run(seed=12, t0=1600.0)
    back = learn(with_rival(loop, 2.5), same, UP, SCATTERED, FIT)
    assert back.surprise == Surprise.AGREES
    assert back.belief is not None
    assert back.belief.rival is None


def test_time_opens_the_uncertainty(loop: Callable) -> None:
    belief = learned_from(loop, 5, STILL)[0]
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
    belief = learned_from(loop, 5, STILL)[0]
    mirrored = type(window)(window.t_s, window.sp, window.pv, -window.co)
    learned = learn(Belief(belief.known, 3, 0.0), mirrored, DOWN, STILL, FIT)
    assert learned.surprise == Surprise.FIRST


def test_the_posterior_is_the_joint_fit_of_all_records(loop: Callable) -> None:
    windows = records(loop, 3)
    belief = learned_from(loop, 5, STILL)[2]

    def misfit_of(window: Window) -> Misfit:
        found = min(
            (c for c in fitted(window, (1,), FIT) if c.fit.misfit.type == ProcessType.FOPDT), key=lambda c: c.criterion
        )
        loads.append(found.fit.p[3:])
        return found.fit.misfit

    loads: list[FloatArray] = []
    misfits = [misfit_of(window) for window in windows]
    sizes = np.cumsum([3, *(len(times) for times in loads)])

    def residuals(p: FloatArray) -> FloatArray:
        parts = zip(misfits, sizes, sizes[1:], strict=False)
        return np.concatenate([m.residuals(np.concatenate([p[:3], p[a:b]])) for m, a, b in parts])

    joint = least_squares(residuals, np.concatenate([belief.log.x, *loads]), x_scale="jac").x[:3]
    assert belief.log.type == ProcessType.FOPDT
    np.testing.assert_allclose((belief.log.x - joint) / np.sqrt(np.diag(belief.log.p)), 0.0, atol=0.35)


def test_records_that_do_not_settle_the_process_alone_settle_it_together(loop: Callable) -> None:
    weak = [loop(noise=0.25, n=400, kc=1.0, at=40.0, sp=1.0).run(seed=i, t0=i * 400.0) for i in range(12)]
    belief, alone = None, []
    for window in weak:
        learned = learn(belief, window, UP, STILL, FIT)
        belief = learned.belief or belief
        alone.append(identify_window(window, 1, None, FIT).identifiable)
        if belief is not None and belief.identifiable:
            break
    assert not any(alone)
    assert belief is not None
    assert belief.identifiable
    assert belief.records > 1
    truth = np.log([1 / 50.0, 5.0])
    assert np.all(np.abs(belief.log.x[:2] - truth) < 4 * np.sqrt(np.diag(belief.log.p)[:2]))


def test_an_odd_record_that_means_danger_is_believed_at_once_and_taken_back(loop: Callable) -> None:
    tight = PidGains(5.0, 0.125)
    belief = learned_from(loop, 3, STILL, tight)[-1]
    odd, same = records(loop, 1, k=2.0, first=4)[0], records(loop, 1, first=6)[0]
    opened = learn(belief, odd, tight, STILL, FIT)
    assert opened.surprise == Surprise.OPENED
    assert opened.belief is not None
    assert opened.belief.log.model().k == pytest.approx(2.0, rel=0.15)
    back = learn(opened.belief, same, tight, STILL, FIT)
    assert back.surprise == Surprise.CHANGED
    assert back.belief is not None
    assert back.belief.log.model().k == pytest.approx(1.0, rel=0.15)


def test_a_wrong_first_record_does_not_lock_the_region(loop: Callable) -> None:
    belief = learn(None, records(loop, 1, k=3.0)[0], UP, STILL, FIT).belief
    said = []
    for window in records(loop, 2, first=1):
        learned = learn(belief, window, UP, STILL, FIT)
        belief = learned.belief
        said.append(learned.surprise)
    assert said == [Surprise.ODD, Surprise.CHANGED]
    assert belief is not None
    assert belief.log.model().k == pytest.approx(1.0, rel=0.1)


def test_what_settled_nothing_gives_way_at_once_to_a_record_that_does(loop: Callable) -> None:
    wrong = learn(None, records(loop, 1, k=3.0)[0], UP, STILL, FIT).belief
    assert wrong is not None
    learned = learn(replace(wrong, identifiable=False), records(loop, 1, first=2)[0], UP, STILL, FIT)
    assert learned.surprise == Surprise.FIRST
    assert learned.belief is not None
    assert learned.belief.records == 1
    assert learned.belief.log.model().k == pytest.approx(1.0, rel=0.1)


def test_a_single_record_gives_way_to_one_that_knows_far_better(loop: Callable) -> None:
    vague = learn(None, loop(k=3.0, noise=0.1, sp=0.3).run(seed=1), UP, SCATTERED, FIT).belief
    assert vague is not None
    assert vague.identifiable
    clear = loop(noise=0.01, sp=1.0).run(seed=2, t0=400.0)
    found = learn(vague, clear, UP, SCATTERED, FIT)
    assert found.surprise == Surprise.FIRST
    assert found.belief is not None
    assert found.belief.log.model().k == pytest.approx(1.0, rel=0.05)
    assert found.belief.rival == vague.known
    odd = replace(vague.points[0], t_s=vague.t_s + 50.0, log=found.belief.log)  # not in the belief
    assert learn(replace(vague, points=(*vague.points, odd)), clear, UP, SCATTERED, FIT).surprise == Surprise.FIRST
    assert learn(replace(vague, points=()), clear, UP, SCATTERED, FIT).surprise == Surprise.ODD
    assert learn(replace(vague, records=2), clear, UP, SCATTERED, FIT).surprise == Surprise.ODD
    assert learn(vague, clear, UP, replace(SCATTERED, clearer=100.0), FIT).surprise == Surprise.ODD


def test_slow_fouling_is_followed(loop: Callable) -> None:
    belief, steps = None, 10
    for i in range(steps):
        k = 2.0 ** (-i / 30)
        window = loop(k=k, noise=0.02, **({"sp": 1.0} if i % 2 == 0 else {"load": 3.0})).run(seed=i, t0=i * 400.0)
        learned = learn(belief, window, UP, TrackerSettings(), FIT)
        assert learned.surprise in {Surprise.FIRST, Surprise.AGREES}
        belief = learned.belief
    assert belief is not None
    assert abs(belief.log.x[0] - np.log(k / 50.0)) < 0.2


def test_the_last_records_are_remembered_by_what_they_said_alone(loop: Callable) -> None:
    belief = None
    for window in records(loop, 2):
        belief = learn(belief, window, UP, STILL, FIT, (1.5, 2.5)).belief
    assert belief is not None
    assert [(p.x, p.x2) for p in belief.points] == [(1.5, 2.5)] * 2
    assert belief.points[1].t_s > belief.points[0].t_s
    assert all(p.log.model().k == pytest.approx(1.0, rel=0.2) for p in belief.points)
    assert belief.plausible[0].excess == 0.0
    again = belief_in(json.loads(json.dumps(belief_out(belief), allow_nan=False)))
    assert belief_out(again) == belief_out(belief)
