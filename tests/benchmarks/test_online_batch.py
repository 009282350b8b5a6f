"""The measurement of on-line retuning: its processes, its judge and its simulated loop against known answers."""

import math
import statistics
from dataclasses import replace

import numpy as np
import pytest
from cases.plant import HeldPlant
from cases.robustness import robustness
from online import batch
from online.astrom_hagglund import batch as processes
from online.counting import at_most
from online.judge import Judge
from online.loop import FixedGains, LostLoop, WatchedLoop
from online.runner import finite, rows_of
from online.supervisors import one_region

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.simc import simc
from retuner.schedule.gains import PidGains


def test_simc_on_the_whole_batch_has_the_margins_that_are_known_of_it():
    ms = [robustness(m.process, simc(half_rule(m.process)).gains).ms for m in processes()]
    assert len(ms) == 134
    assert (min(ms), statistics.median(ms), max(ms)) == pytest.approx((1.39, 1.59, 1.98), abs=0.005)
    over = {m.name for m, value in zip(processes(), ms, strict=True) if value > 1.8}
    assert over == {f"P6 L={x:g}" for x in (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)} | {
        m.name for m in processes() if m.family == "P9"
    }


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


def test_loop_without_integral_settles_where_algebra_says():
    process = LinearProcess(2.0, (5.0,), (), 1.0)
    loop = WatchedLoop(HeldPlant(process, 0.1), one_region(PidGains(0.7, 0.0)), 0.1, FixedGains())
    pv, co = loop.run(1.0, 0.3, [0.0] * 2000)[-1]
    assert pv == pytest.approx((2.0 * 0.7 + 2.0 * 0.3) / (1 + 2.0 * 0.7), rel=1e-9)
    assert co == pytest.approx(0.7 * (1.0 - pv), rel=1e-9)


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


def test_gains_change_without_a_bump_and_hold_from_the_next_sample():
    process = LinearProcess(1.0, (3.0,), (), 1.0)
    loop = WatchedLoop(HeldPlant(process, 0.1), one_region(PidGains(0.5, 0.1)), 0.1, FixedGains())
    before = loop.run(1.0, 0.0, [0.0] * 50)[-1]
    loop.write(0, PidGains(2.0, 0.1), 1.0, before[0])
    assert loop.gains == PidGains(2.0, 0.1)
    after = loop.run(1.0, 0.0, [0.0])[-1]
    assert abs(after[1] - before[1]) < 2.0 * abs(after[0] - before[0]) + 0.1 * 0.1 + 1e-9
    assert loop.changes == 1


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


def test_staying_asks_for_every_later_disturbance():
    row = {"spec": [True, True, False, True, True, True]}
    assert [batch.staying(row, n) for n in (1, 3, 4, 6)] == [False, False, True, True]


def test_tasks_are_reproducible_and_spread_over_the_starts():
    def drawn(seed):
        return batch.tasks(seed, opened=False, every=1, only="", noise=0.01, verbose=False, starts=1)

    assert drawn(3) == drawn(3) != drawn(4)
    assert len(drawn(3)) == 134
    assert {t.start for t in drawn(3)} == set(batch.STARTS)


def test_bound_of_no_event_is_the_exact_one():
    assert at_most(0, 1000) == pytest.approx(1 - 0.025 ** (1 / 1000))
    assert at_most(5, 5) == 1.0


def test_rows_become_json_that_has_no_infinity():
    assert finite({"ms": [1.5, math.inf], "spec": (True,)}) == {"ms": [1.5, None], "spec": [True]}


def test_rows_come_back_from_their_file(tmp_path):
    file = tmp_path / "rows.jsonl"
    file.write_text('{"ms": [1.5, null], "who": {"a": {"iae": [null]}}}\n', encoding="utf-8")
    assert rows_of(file) == [{"ms": [1.5, math.inf], "who": {"a": {"iae": [math.inf]}}}]
