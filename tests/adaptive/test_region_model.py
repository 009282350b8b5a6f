"""The Kalman filter over responses: its posterior is the fit's own, evidence accumulates, wrong records do no harm."""

import functools
import json
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from retuner import PidGains, ProcessType
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.search import load_times
from retuner.adaptive.identification.identify import FitSettings, fitted, identify_window
from retuner.adaptive.region_model import update as region_update
from retuner.adaptive.region_model.kalman import update
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Agreement, TrackerSettings, predicted, update_region_model
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out

STILL = TrackerSettings(walk_per_day=0.0, walk_per_record=0.0, scatter=0.0)
SCATTERED = TrackerSettings()
FIT = FitSettings()
UP, DOWN = PidGains(2.0, 0.05), PidGains(-2.0, -0.05)  # Gains in force


def records(loop: Callable, count: int, k: float = 1.0, first: int = 0) -> list:
    shapes = ({"sp": 1.0}, {"load": 3.0 / k})
    return [loop(k=k, noise=0.02, **shapes[i % 2]).run(seed=i, t0=i * 400.0) for i in range(first, first + count)]


@functools.cache
def learned_from(
    loop: Callable, count: int, settings: TrackerSettings, gains: PidGains = UP
) -> tuple[RegionModel, ...]:
    """The region models after each of the first records; made once, as many tests begin with them."""
    region_models: list[RegionModel] = []
    for window in records(loop, count):
        region_model = update_region_model(
            region_models[-1] if region_models else None, window, gains, settings, FIT
        ).region_model
        assert region_model is not None
        region_models.append(region_model)
    return tuple(region_models)


def test_the_filters_posterior_is_the_fits_own(loop: Callable) -> None:
    _, second = records(loop, 2)
    region_model = learned_from(loop, 5, STILL)[0]
    logs = {known.log.type: known.log for known in region_model.known}
    estimate = identify_window(second, 1, logs, FIT)
    own = estimate.log
    assert own.type == ProcessType.FOPDT
    _, posterior = update(logs[own.type], estimate)
    sigma = np.sqrt(np.diag(own.p))
    np.testing.assert_allclose(posterior.x / sigma, own.x / sigma, atol=0.03)
    np.testing.assert_allclose(posterior.p, own.p, rtol=1e-6, atol=1e-9)


def test_evidence_accumulates(loop: Callable) -> None:
    region_models = learned_from(loop, 5, STILL)
    region_model, sigma = region_models[-1], [region_model.log.gain_uncertainty() for region_model in region_models]
    assert region_model.records == 5
    assert sigma == sorted(sigma, reverse=True)
    assert sigma[-1] < 0.7 * sigma[0]
    truth = np.log([1 / 50.0, 5.0, 50.0])
    assert np.all(np.abs(region_model.log.x - truth) < 4 * np.sqrt(np.diag(region_model.log.p)))


def test_one_odd_record_is_not_believed_and_a_second_one_is(loop: Callable) -> None:
    region_model = learned_from(loop, 5, STILL)[2]
    contradicting, confirming = records(loop, 2, k=2.0, first=3)
    doubted = update_region_model(region_model, contradicting, UP, STILL, FIT)
    assert doubted.agreement == Agreement.CONTRADICTS
    np.testing.assert_array_equal(doubted.region_model.log.x, region_model.log.x)
    back = update_region_model(doubted.region_model, records(loop, 1, first=6)[0], UP, STILL, FIT)
    assert back.agreement == Agreement.AGREES
    changed = update_region_model(doubted.region_model, confirming, UP, STILL, FIT)
    assert changed.agreement == Agreement.CHANGED
    assert changed.region_model.log.model().k == pytest.approx(2.0, rel=0.1)


@functools.cache
def with_alternative(loop: Callable, theta_s: float) -> RegionModel:
    """Three records of a dead time of 5 s, then a setpoint step that shows another one."""
    region_model = learned_from(loop, 3, SCATTERED)[-1]
    contradicting = update_region_model(
        region_model, loop(theta=theta_s, noise=0.02, sp=1.0).run(seed=9, t0=1200.0), UP, SCATTERED, FIT
    )
    assert contradicting.agreement == Agreement.CONTRADICTS
    assert contradicting.region_model.alternative is not None
    return contradicting.region_model


def test_a_record_that_fits_both_but_the_rival_better_confirms_it(loop: Callable) -> None:
    load = loop(theta=2.5, noise=0.05, load=3.0).run(seed=10, t0=1600.0)
    doubted = with_alternative(loop, 2.5)
    assert (
        update_region_model(replace(doubted, alternative=None), load, UP, SCATTERED, FIT).agreement == Agreement.AGREES
    )
    changed = update_region_model(doubted, load, UP, SCATTERED, FIT)
    assert changed.agreement == Agreement.CHANGED
    assert changed.region_model.alternative is None
    assert changed.region_model.log.model().theta_s == pytest.approx(2.5, rel=0.2)


def test_a_record_that_cannot_tell_leaves_the_rival_until_one_can(loop: Callable) -> None:
    half_way = loop(theta=3.7, noise=0.08, load=3.0).run(seed=10, t0=1600.0)
    undecided = update_region_model(with_alternative(loop, 2.5), half_way, UP, SCATTERED, FIT)
    assert undecided.agreement == Agreement.AGREES
    assert undecided.region_model.alternative is not None
    step = loop(theta=2.5, noise=0.02, sp=1.0).run(seed=11, t0=2000.0)
    changed = update_region_model(undecided.region_model, step, UP, SCATTERED, FIT)
    assert changed.agreement == Agreement.CHANGED


def test_a_record_that_speaks_clearly_against_the_rival_forgets_it(loop: Callable) -> None:
    same = loop(noise=0.02, sp=-1.0).run(seed=12, t0=1600.0)
    back = update_region_model(with_alternative(loop, 2.5), same, UP, SCATTERED, FIT)
    assert back.agreement == Agreement.AGREES
    assert back.region_model.alternative is None


def test_time_opens_the_uncertainty(loop: Callable) -> None:
    region_model = learned_from(loop, 5, STILL)[0]
    walk = TrackerSettings(walk_per_day=0.1, walk_per_record=0.0, scatter=0.05)
    later = predicted(region_model, region_model.t_s + 4 * 86400, walk)
    np.testing.assert_allclose(
        later.p, region_model.log.p + (0.04 + 0.0025) * np.eye(len(region_model.log.x)), rtol=1e-9
    )
    np.testing.assert_array_equal(later.x, region_model.log.x)


def test_a_first_record_that_says_nothing_leaves_nothing_known(loop: Callable) -> None:
    learned = update_region_model(None, loop(noise=0.02).run(1), UP, STILL, FIT)
    assert learned.region_model is None
    assert not learned.estimate.identifiable


def test_a_belief_of_the_other_sign_is_dropped(loop: Callable) -> None:
    window = records(loop, 1)[0]
    region_model = learned_from(loop, 5, STILL)[0]
    mirrored = type(window)(window.t_s, window.sp, window.pv, -window.co)
    learned = update_region_model(RegionModel(region_model.known, 3, 0.0), mirrored, DOWN, STILL, FIT)
    assert learned.agreement == Agreement.FIRST


def test_the_posterior_is_the_joint_fit_of_all_records(loop: Callable) -> None:
    windows = records(loop, 3)
    region_model = learned_from(loop, 5, STILL)[2]

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
        return np.concatenate([m.solve(np.concatenate([p[:3], p[a:b]])).r for m, a, b in parts])

    joint = least_squares(residuals, np.concatenate([region_model.log.x, *loads]), x_scale="jac").x[:3]
    assert region_model.log.type == ProcessType.FOPDT
    np.testing.assert_allclose((region_model.log.x - joint) / np.sqrt(np.diag(region_model.log.p)), 0.0, atol=0.35)


@pytest.mark.slow
@pytest.mark.uncounted
def test_records_that_do_not_settle_the_process_alone_settle_it_together(loop: Callable) -> None:
    weak = [loop(noise=0.25, n=400, kc=1.0, at=40.0, sp=1.0).run(seed=i, t0=i * 400.0) for i in range(12)]
    region_model, alone = None, []
    for window in weak:
        learned = update_region_model(region_model, window, UP, STILL, FIT)
        region_model = learned.region_model or region_model
        alone.append(identify_window(window, 1, None, FIT).identifiable)
        if region_model is not None and region_model.identifiable:
            break
    assert not any(alone)
    assert region_model.identifiable
    assert region_model.records > 1
    truth = np.log([1 / 50.0, 5.0])
    assert np.all(np.abs(region_model.log.x[:2] - truth) < 4 * np.sqrt(np.diag(region_model.log.p)[:2]))


def test_an_odd_record_that_means_danger_is_believed_at_once_and_taken_back(loop: Callable) -> None:
    tight = PidGains(5.0, 0.125)
    region_model = learned_from(loop, 3, STILL, tight)[-1]
    contradicting, same = records(loop, 1, k=2.0, first=4)[0], records(loop, 1, first=6)[0]
    opened = update_region_model(region_model, contradicting, tight, STILL, FIT)
    assert opened.agreement == Agreement.OPENED
    assert opened.region_model.log.model().k == pytest.approx(2.0, rel=0.15)
    back = update_region_model(opened.region_model, same, tight, STILL, FIT)
    assert back.agreement == Agreement.CHANGED
    assert back.region_model.log.model().k == pytest.approx(1.0, rel=0.15)


def test_a_wrong_first_record_does_not_lock_the_region(loop: Callable) -> None:
    region_model = update_region_model(None, records(loop, 1, k=3.0)[0], UP, STILL, FIT).region_model
    said = []
    for window in records(loop, 2, first=1):
        learned = update_region_model(region_model, window, UP, STILL, FIT)
        region_model = learned.region_model
        said.append(learned.agreement)
    assert said == [Agreement.CONTRADICTS, Agreement.CHANGED]
    assert region_model.log.model().k == pytest.approx(1.0, rel=0.1)


def test_what_settled_nothing_gives_way_at_once_to_a_record_that_does(loop: Callable) -> None:
    wrong = update_region_model(None, records(loop, 1, k=3.0)[0], UP, STILL, FIT).region_model
    assert wrong is not None
    learned = update_region_model(replace(wrong, identifiable=False), records(loop, 1, first=2)[0], UP, STILL, FIT)
    assert learned.agreement == Agreement.FIRST
    assert learned.region_model.records == 1
    assert learned.region_model.log.model().k == pytest.approx(1.0, rel=0.1)


def test_a_single_record_gives_way_to_one_that_knows_far_better(loop: Callable) -> None:
    vague = update_region_model(None, loop(k=3.0, noise=0.1, sp=0.3).run(seed=1), UP, SCATTERED, FIT).region_model
    assert vague.identifiable
    clear = loop(noise=0.01, sp=1.0).run(seed=2, t0=400.0)
    found = update_region_model(vague, clear, UP, SCATTERED, FIT)
    assert found.agreement == Agreement.FIRST
    assert found.region_model.log.model().k == pytest.approx(1.0, rel=0.05)
    assert found.region_model.alternative == vague.known
    contradicting = replace(
        vague.points[0], t_s=vague.t_s + 50.0, log=found.region_model.log
    )  # not in the region model
    assert (
        update_region_model(replace(vague, points=(*vague.points, contradicting)), clear, UP, SCATTERED, FIT).agreement
        == Agreement.FIRST
    )
    assert update_region_model(replace(vague, points=()), clear, UP, SCATTERED, FIT).agreement == Agreement.CONTRADICTS
    assert update_region_model(replace(vague, records=2), clear, UP, SCATTERED, FIT).agreement == Agreement.CONTRADICTS
    assert (
        update_region_model(vague, clear, UP, replace(SCATTERED, clearer=100.0), FIT).agreement == Agreement.CONTRADICTS
    )


@pytest.mark.slow
def test_slow_fouling_is_followed(loop: Callable) -> None:
    region_model, steps = None, 10
    for i in range(steps):
        k = 2.0 ** (-i / 30)
        window = loop(k=k, noise=0.02, **({"sp": 1.0} if i % 2 == 0 else {"load": 3.0})).run(seed=i, t0=i * 400.0)
        learned = update_region_model(region_model, window, UP, TrackerSettings(), FIT)
        assert learned.agreement in {Agreement.FIRST, Agreement.AGREES}
        region_model = learned.region_model
    assert abs(region_model.log.x[0] - np.log(k / 50.0)) < 0.2


def test_the_last_records_are_remembered_by_what_they_said_alone(loop: Callable) -> None:
    region_model = None
    for window in records(loop, 2):
        region_model = update_region_model(region_model, window, UP, STILL, FIT, (1.5, 2.5)).region_model
    assert [(p.x, p.x2) for p in region_model.points] == [(1.5, 2.5)] * 2
    assert region_model.points[1].t_s > region_model.points[0].t_s
    assert all(p.log.model().k == pytest.approx(1.0, rel=0.2) for p in region_model.points)
    assert region_model.plausible[0].excess == 0.0
    again = region_model_in(json.loads(json.dumps(region_model_out(region_model), allow_nan=False)))
    assert region_model_out(again) == region_model_out(region_model)


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.6, 1.0])
@pytest.mark.parametrize("lead", [0, 20])
@pytest.mark.parametrize("seed", range(6))
def test_a_small_load_does_not_move_what_is_known(loop: Callable, size: float, lead: int, seed: int) -> None:
    """Its window begins with it, or 10 s before. A state that was not rest and another gain explain it nearly as well:
    of six such records three moved k by a quarter.
    """
    whole = loop(load=size, noise=0.02).run(seed=seed, t0=4000.0)
    own = slice(80 - lead, 80 - lead + 240)
    window = Window(whole.t_s[own], whole.sp[own], whole.pv[own], whole.co[own])
    learned = update_region_model(learned_from(loop, 5, SCATTERED)[-1], window, UP, SCATTERED, FIT)
    assert learned.agreement is Agreement.AGREES
    assert learned.region_model.log.model().k == pytest.approx(1.0, rel=0.06)
    assert [round(at_s) for at_s in learned.estimate.load_times_s] == pytest.approx([4040], abs=6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_load_is_free_only_where_nothing_else_moves_a_loop_at_rest(loop: Callable, seed: int) -> None:
    """By themselves these records need no load, so the one that they get beside the known process is no surprise."""
    known = learned_from(loop, 5, SCATTERED)[-1]
    whole = loop(load=0.6, noise=0.02).run(seed=seed, t0=4000.0)
    window = whole.part(slice(80, 320))
    assert fitted(window, (1,), FIT)[0].fit.misfit.loads == 0
    assert update_region_model(known, window, UP, SCATTERED, FIT).innovation < 5.0
    ramp = np.clip((whole.t_s - 4040.0) / 100.0, 0.0, 1.0)
    moved = Window(whole.t_s, whole.sp + ramp, whole.pv, whole.co)
    record: Any = SimpleNamespace(window=moved, found=fitted(whole, (1,), FIT))
    assert region_update._loads_at_least(record) == 0
    record.window = whole
    assert region_update._loads_at_least(record) == 1
    record.window = whole.part(slice(120, 360))
    assert region_update._loads_at_least(record) == 0


def test_loads_are_looked_for_beside_a_known_process(loop: Callable) -> None:
    window = loop(load=1.0, noise=0.02).run(seed=3)
    misfit = fitted(window, (1,), FIT)[0].fit.misfit
    known = np.log([1 / 50.0, 5.0, 50.0])
    plain = replace(misfit, type=ProcessType.FOPDT, loads=0, ramp=False, ar=())
    assert load_times(plain, known, 1) == pytest.approx([40.0], abs=4.0)
    quiet = loop(sp=1.0, noise=0.02).run(seed=3)
    plain = replace(fitted(quiet, (1,), FIT)[0].fit.misfit, type=ProcessType.FOPDT, loads=0, ramp=False, ar=())
    assert load_times(plain, known, 2) == []


def test_a_dead_time_too_short_to_be_seen_stays_at_its_bound_and_is_no_prior() -> None:
    region_model, gains, rng = None, PidGains(5.5, 1.04), np.random.default_rng(3)
    for begun_s in (0.0, 400.0):
        rows, x, integral = [], 0.0, 0.0
        for i in range(60):
            sp, pv = (2.0 if i >= 20 else 0.0), x + 0.02 * float(rng.standard_normal())
            integral += gains.ki * 3.0 * (sp - pv)
            rows.append((begun_s + 3.0 * i, sp, pv, gains.kp * (sp - pv) + integral))
            x += (1.0 - np.exp(-3.0 / 49.0)) * (1.73 * rows[-1][3] - x)
        window = Window(*np.array(rows).T)
        region_model = update_region_model(region_model, window, gains, SCATTERED, FIT).region_model
        assert region_model.identifiable
        assert region_model.log.model().theta_s == pytest.approx(region_model.bound_s) == 3.0
        assert region_model.known[0].log.model().theta_s < 0.3
        assert region_model_in(json.loads(json.dumps(region_model_out(region_model)))).bound_s == 3.0
