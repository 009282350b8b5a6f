"""What must not be changed, bad changes, and the competitors: their generators and judgements on known cases."""

import math

import numpy as np
import pytest
from cases.plant import HeldPlant
from cases.setting import draw_loop
from online import harm, injected
from online.judge import Judge, effect
from online.rivals import relay_then_ziegler_nichols, step_then_simc

from retuner.adaptive.loop.margins import ultimate
from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains

PROCESS = LinearProcess(-2.0, (8.0, 1.0), (), 1.0)
DT = 0.2


def judge():
    return Judge(PROCESS, DT)


def scaled(gains, factor):
    return PidGains(gains.kp * factor, gains.ki * factor)


@pytest.mark.parametrize(
    ("before", "after", "ms_worse", "iae_worse"),
    [
        (1.0, 1.6, True, False),  # out of the limit on Ms, though faster
        (1.0, 0.3, False, True),  # slower for nothing
        (2.5, 0.3, False, False),  # slower, but it was over the limit
        (0.3, 1.0, False, False),  # right
        (2.5, 1.0, False, False),  # right
        (2.5, 5.0, True, True),  # unstable
        (1.0, 1.0, False, False),
    ],
)
def test_a_change_is_worse_where_ms_leaves_its_limit_or_j_grows_for_nothing(before, after, ms_worse, iae_worse):
    of = judge()
    found = effect(of, 1.0, scaled(of.best, before), scaled(of.best, after))
    assert (found.ms_worse, found.iae_worse) == (ms_worse, iae_worse)
    assert found.worse == (ms_worse or iae_worse)


@pytest.mark.parametrize("family", ["first", "integrating-lag", "oscillatory"])
def test_a_loop_in_other_time_is_the_same_loop(family):
    loop = draw_loop(np.random.default_rng(4), family)
    slower = harm.rescaled(loop, 3.0 * loop.dt_s)
    assert slower.theta_s == pytest.approx(3.0 * loop.theta_s)
    assert slower.margins(slower.best).ms == pytest.approx(loop.margins(loop.best).ms, rel=1e-6)


@pytest.mark.parametrize("kind", harm.KINDS)
def test_scenes_are_reproducible_and_in_spec_at_the_start(kind):
    def drawn(index):
        return harm.scene_of(kind, np.random.default_rng([7, index]))

    for index in range(3):
        scene, again = drawn(index), drawn(index)
        np.testing.assert_array_equal(scene.load, again.load)
        assert scene.gains == again.gains
        found = Judge(scene.loop.process, scene.loop.dt_s, (scene.loop.best, scene.loop.theta_s)).of(scene.gains)
        assert math.isfinite(found.ms)
        if kind == "quiet":
            assert len(scene.load) * scene.loop.dt_s == pytest.approx(3600, rel=0.01)
            assert harm.SAMPLE_TIMES_S[0] <= scene.loop.dt_s <= harm.SAMPLE_TIMES_S[1]
            assert scene.sps == [(0, 0.0)]
        else:
            assert found.in_spec
            assert len(scene.load) <= harm.MOST_SAMPLES


def test_a_saturation_scene_asks_for_more_than_the_output_can_do():
    scene = harm.scene_of("saturation", np.random.default_rng(2))
    loop = scene.loop
    asked = [abs(sp / loop.process.k) for _, sp in scene.sps] + [float(np.max(np.abs(scene.load)))]
    assert scene.bounded
    assert max(asked) > loop.room


def test_relay_finds_the_ultimate_point_within_what_its_formula_allows():
    ku, pu = ultimate(PROCESS)
    gains = relay_then_ziegler_nichols(HeldPlant(PROCESS, DT), PROCESS, DT, 0.005, np.random.default_rng(1))
    assert gains.kp / (0.45 * ku) == pytest.approx(1.0, abs=0.25)
    assert gains.kp / gains.ki / (pu / 1.2) == pytest.approx(1.0, abs=0.25)


def test_one_step_gives_simc_that_is_in_spec():
    of = judge()
    gains = step_then_simc(HeldPlant(PROCESS, DT), PROCESS, of.theta_s, DT, 0.005, np.random.default_rng(1))
    assert of.of(gains).in_spec


def test_an_unstable_set_on_trial_is_taken_back_to_the_verified_one():
    row = injected.run(injected.Task("integral", 3, 1))
    assert math.isinf(row["ms"])
    assert row["rolled_back"]
    assert row["verified"]
    assert 0 < row["theta"] < 60
    assert 1 < row["excursion"] < 20


@pytest.mark.parametrize("kind", [kind for kind in injected.KINDS if kind != "right"])
def test_bad_sets_are_bad_and_the_wrong_model_calls_them_good(kind):
    for index in range(4):
        loop, change = injected.drawn(kind, np.random.default_rng([5, index]), "wrong model")
        truth = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s)).of(change.new)
        assert not truth.in_spec
        believed = Judge(change.believed.model.linear(), loop.dt_s).of(change.said)
        assert believed.ms < 2.1
        assert change.said == change.new
        _, other = injected.drawn(kind, np.random.default_rng([5, index]), "wrong set")
        assert other.said != other.new


def test_a_right_set_takes_the_place_of_a_sluggish_one():
    for index in range(4):
        loop, change = injected.drawn("right", np.random.default_rng([5, index]), "wrong set")
        judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
        assert judge.of(change.new).in_spec
        assert not judge.of(change.old).in_spec
        assert change.said == change.new


@pytest.mark.slow
def test_a_load_that_wanders_takes_back_no_right_set_and_hides_no_unstable_one():
    right = injected.run(injected.Task("right", 31, 3, "walk"))
    assert not right["rolled_back"]
    wrong = injected.run(injected.Task("gain", 31, 0, "walk"))
    assert math.isinf(wrong["ms"])
    assert wrong["rolled_back"]
