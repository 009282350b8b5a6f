"""The measurement of on-line retuning: its processes, its judge and its simulated loop against known answers."""

import math
import statistics
from dataclasses import replace

import numpy as np
import pytest
from cases.plant import HeldPlant, robustness
from online import batch, changes, harm, injected
from online.judge import Judge, at_most, effect
from online.loop import FixedGains, LostLoop, WatchedLoop, one_region
from online.rivals import batch as processes
from online.rivals import relay_then_ziegler_nichols, step_then_simc
from online.runner import Task, rows_of
from online.varying import Local, VaryingPlant
from schedules.records import Course, shape

from retuner import LinearProcess, PidGains
from retuner.adaptive.loop.margins import ultimate
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.simc import simc


def test_simc_on_the_whole_batch_has_the_margins_that_are_known_of_it():
    ms = [robustness(m.process, simc(half_rule(m.process)).gains).ms for m in processes()]
    assert len(ms) == 134
    assert (min(ms), statistics.median(ms), max(ms)) == pytest.approx((1.39, 1.59, 1.98), abs=0.005)
    over = {m.name for m, value in zip(processes(), ms, strict=True) if value > 1.8}
    assert over == {f"P6 L={x:g}" for x in (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)} | {
        m.name for m in processes() if m.family == "P9"
    }


def test_an_unstable_start_whose_swing_grows_is_cut_at_its_first_response_whatever_a_walk_explains():
    task = next(t for t in batch.tasks(12622, every=9) if t.member.name == "P5 a=0.6")
    assert batch.run(task)["spec"][0]


@pytest.mark.parametrize("member", processes()[::19], ids=lambda m: m.name)
def test_perfect_knowledge_is_in_spec_and_gains_far_off_are_not(member):
    judge = Judge(member.process, Judge.theta(member.process) / 8)
    best = judge.best
    found = judge.of(best)
    assert found.in_spec
    assert found.j == pytest.approx(1.0)
    assert not judge.of(PidGains(best.kp / 4, best.ki / 4)).in_spec
    assert judge.of(PidGains(best.kp / 4, best.ki / 4)).j > 1.25
    assert judge.of(PidGains(best.kp * 2.5, best.ki * 2.5)).ms > judge.ms_limit


def test_a_loop_beyond_its_gain_margin_is_unstable_for_the_judge():
    judge = Judge(LinearProcess(1.0, (10.0,), (), 1.0), 0.125)
    found = judge.of(PidGains(4 * judge.best.kp, 4 * judge.best.ki))
    assert found.ms == math.inf
    assert not found.in_spec


@pytest.mark.parametrize(
    ("kc", "shorter", "opened", "reached"),
    [(0.5, 1.0, False, True), (0.25, 1.0, False, False), (0.25, 1.0, True, True), (0.25, 0.25, True, False)],
)
def test_what_one_change_reaches_follows_the_limits(kc, shorter, opened, reached):
    judge = Judge(LinearProcess(1.0, (1.0,), (), 1.0), 0.125)
    start = PidGains(judge.best.kp * kc, judge.best.ki * kc * shorter)
    assert batch.reaches(judge, start, opened=opened) is reached


def test_j_counts_setpoint_and_load_alike():
    """Without overshoot the IAE of a load step is tau_I/Kc; of a setpoint step it is tau_I/(k Kc)."""
    judge = Judge(LinearProcess(1.0, (1.0,), (), 1.0), 1.0 / 64)
    slow = PidGains(judge.best.kp / 2, judge.best.ki / 2)
    half, whole = judge._iae(slow), judge._iae(judge.best)
    assert half == pytest.approx((1 / slow.ki, 1 / slow.ki), rel=1e-3)
    assert judge.of(slow).j == pytest.approx((half[0] / whole[0] + half[1] / whole[1]) / 2)


def test_load_has_the_size_that_moves_pv_by_one():
    process = LinearProcess(2.0, (10.0,), (), 1.0)
    judge = Judge(process, 0.125)
    load = judge.load_like_setpoint()
    loop = WatchedLoop(HeldPlant(process, 0.125), one_region(judge.best), 0.125, FixedGains())
    trace = loop.run(0.0, load, [0.0] * 800)
    assert max(abs(pv) for pv, _ in trace) == pytest.approx(1.0, rel=1e-6)
    assert trace[-1][1] == pytest.approx(-load, rel=1e-3)


def test_loop_answers_with_the_exact_step_response_until_its_own_output_comes_back():
    process = LinearProcess(1.0, (3.0,), (), 1.0)
    loop = WatchedLoop(HeldPlant(process, 0.1), one_region(PidGains(0.5, 0.0)), 0.1, FixedGains())
    pv = np.array([p for p, _ in loop.run(1.0, 0.0, [0.0] * 20)])
    late = np.maximum(np.arange(20) * 0.1 - 1.0, 0)
    assert pv[:20] == pytest.approx(0.5 * (1 - np.exp(-late / 3.0)), abs=1e-12)


def test_an_unstable_loop_is_lost():
    process = LinearProcess(1.0, (), (), 1.0, 1)
    loop = WatchedLoop(HeldPlant(process, 0.1), one_region(PidGains(3.0, 0.0)), 0.1, FixedGains(), lost=100.0)
    with pytest.raises(LostLoop):
        loop.run(1.0, 0.0, [0.0] * 5000)


@pytest.mark.slow
@pytest.mark.uncounted
@pytest.mark.parametrize("name", ["P1 T=2", "P6 L=0.5"])
def test_retuner_brings_a_sluggish_loop_into_spec_in_a_whole_run(name):
    task = batch.tasks(5, opened=True, every=1, only=name, noise=0.01, verbose=True, starts=1)[0]
    row = batch.run(replace(task, start=(0.25, 1.0)))
    assert not row["spec"][0] or row["changes"] >= 1
    assert row["spec"][-1]
    assert row["j0"] > 1.25
    assert len(row["spec"]) == len(row["ms"]) == batch.DISTURBANCES
    assert any("commit" in text for text in row["story"])


def test_bound_of_no_event_is_the_exact_one():
    assert at_most(0, 1000) == pytest.approx(1 - 0.025 ** (1 / 1000))
    assert at_most(5, 5) == 1.0


def test_rows_come_back_from_their_file(tmp_path):
    file = tmp_path / "rows.jsonl"
    file.write_text('{"ms": [1.5, null], "who": {"a": {"iae": [null]}}}\n', encoding="utf-8")
    assert rows_of(file) == [{"ms": [1.5, math.inf], "who": {"a": {"iae": [math.inf]}}}]


# ---- What must not be changed, bad changes, and the competitors: their generators and judgements on known cases

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


@pytest.mark.slow
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
    row = injected.run(Task("integral", 3, 1))
    assert math.isinf(row["ms"])
    assert row["rolled_back"]
    assert row["verified"]
    assert 0 < row["theta"] < 60
    assert 1 < row["excursion"] < 20


@pytest.mark.slow
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


@pytest.mark.nightly
def test_a_load_that_wanders_takes_back_no_right_set_and_hides_no_unstable_one():
    right = injected.run(Task("right", 31, 3, wander="walk"))
    assert not right["rolled_back"]
    wrong = injected.run(Task("gain", 31, 0, wander="walk"))
    assert math.isinf(wrong["ms"])
    assert wrong["rolled_back"]


# ---- Processes that vary: against exact held responses, their own linearisation, and the changes drawn for them

COURSE = Course(Local(2.0, 5.0, 1.0, 1.0), (1, -1, 1), 4.0, shape("ramp", 0.5))


def moved(plant, u, n):
    return np.array([plant.move(u) for _ in range(n)])


@pytest.mark.parametrize("y", [10.0, 50.0, 90.0])
def test_small_steps_show_the_linearisation_there(y):
    plant = VaryingPlant(COURSE.at, COURSE.rest, 0.1, y)
    linear = HeldPlant(COURSE.at(y).linear(), 0.1)
    found, exact = moved(plant, 1e-4, 300), moved(linear, 1e-4, 300)
    assert found == pytest.approx(exact, abs=0.01 * abs(exact[-1]))


@pytest.mark.parametrize("kind", ["gain", "delay", "drift"])
def test_a_change_is_by_the_factor_in_one_parameter(kind):
    rng = np.random.default_rng(1)
    local = changes.draw_local(rng)
    target = changes.changed(local, kind, 2.0, rng)
    assert changes.between(local, target, 0.0) == local
    ends = changes.between(local, target, 1.0)
    ratios = [ends.k / local.k, ends.theta_s / local.theta_s, (ends.tau1_s or 1.0) / (local.tau1_s or 1.0)]
    assert sorted(ratios)[-1] == pytest.approx(2.0) or (ends.tau2_s / local.tau2_s == pytest.approx(2.0))
    assert sorted(ratios)[:2] == pytest.approx([1.0, 1.0])


@pytest.mark.nightly
def test_a_loop_that_changes_is_run_and_judged_as_what_it_has_become():
    row = changes.run(Task("gain", 3, 0))
    assert len(row["spec"]) == changes.UPSETS
    assert row["records"] >= 3
    assert all(ms >= 1.0 for ms in row["ms"])
