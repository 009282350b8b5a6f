"""The retuner with its trials: what samples tell ends a trial by itself, and the response under way teaches."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rig import BAD, GOOD, MODEL, PROMISE, Rig, responses

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess, ProcessModel
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Agreement, Learned
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision import decide
from retuner.adaptive.supervision.decision import Action, Decision, Mode, Outcome
from retuner.adaptive.supervision.judge_evidence import posterior_of, prediction_of
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.trial.diverging_trial import divergence_begin, divergence_step, law_of
from retuner.adaptive.trial.judge import TrialFinding, judge, sigma_of
from retuner.adaptive.trial.load_variability import BLOCK, FEWEST_BLOCKS, load_variability, load_variability_there
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.adaptive.trial.posterior_check import PosteriorCheck, against, check_posterior, in_favour
from retuner.adaptive.trial.prediction import Prediction, Spread, predict
from retuner.adaptive.trial.trial import Trial
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

P, E = TrialPhase, TrialEvent
NEW = BAD["kc x4"]


class Stand:
    """A loop at rest, its retuner, and a change that has just been committed."""

    def __init__(self, new: PidGains = NEW, mode: Mode = Mode.AUTO) -> None:
        table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (GOOD,))
        self.retuner = Retuner(table, RetunerSettings(1.0, 100.0, mode, band=0.1))
        self.rig = Rig(GOOD, noise=0.02)
        assert list(self.run(60)) == []
        made = self.retuner.ordered(0, Outcome("injected", "for a test"), new, PROMISE)
        assert made.action is Action.WRITE
        assert self.retuner.trials.phase(0) is P.WRITING
        self.retuner.committed(0, new)
        self.rig.change(new)
        assert self.retuner.trials.phase(0) is P.TRIAL

    def run(self, samples: int) -> Iterator[Decision]:
        for sample in self.rig.run(samples):
            decision = self.retuner.observe(sample)
            if decision is not None:
                yield decision

    def run_away(self) -> Decision:
        """A setpoint step under the set on trial, until it is given up."""
        assert list(self.run(40)) == []
        self.rig.sp = 5.0
        return next(self.run(100))


def learned_by_a_runaway() -> RegionModel:
    stand = Stand()
    stand.run_away()
    return stand.retuner.region_models[0]


def test_a_set_that_its_own_samples_refute_is_rolled_back_without_a_response() -> None:
    retuner = Stand().retuner
    record = SimpleNamespace(region=0, crossed=False)
    question: Any = SimpleNamespace(record=record, alone=True, sample_number=retuner.sample_number)
    made = retuner._entered(question, Outcome("looked", "", refuted="worse than predicted"))
    assert (made.code, made.gains_after) == ("undo_worse", GOOD)
    assert "worse than predicted" in made.reason
    assert retuner.trials.phase(0) is P.RESTORING


def test_a_loop_that_runs_away_is_taken_back_in_mid_response_and_the_record_teaches() -> None:
    stand = Stand()
    decision = stand.run_away()
    assert decision.action is Action.RESTORE
    assert decision.code == "undo_runaway"
    assert (decision.gains_before, decision.gains_after) == (NEW, GOOD)
    assert decision.prediction == PROMISE
    assert stand.retuner.table.gains == (GOOD,)
    assert decision.response.ending.name == "UNDONE"
    assert 0 in stand.retuner.region_models
    assert stand.retuner.region_models[0].log.model().theta_s == pytest.approx(5.0, rel=0.2)
    assert json.loads(decision.canonical())["trial"] == "rolling back to the verified gains"


def test_a_model_that_promised_wrongly_is_not_believed_any_more() -> None:
    """The record of the undo agrees with it: what the two say together is forgotten, the next one begins anew."""
    for before, kept in ((learned_by_a_runaway(), False), (None, True)):
        stand = Stand()
        stand.retuner.region_models = {} if before is None else {0: before}
        decision = stand.run_away()
        assert decision.code == "undo_runaway"
        assert decision.agreement is (Agreement.FIRST if before is None else Agreement.AGREES)
        assert (0 in stand.retuner.region_models, 0 in stand.retuner.excitation) == (kept, kept)


def test_a_tone_that_speaks_against_a_cure_does_not_give_a_rescued_loop_back_to_the_unstable_set() -> None:
    """A far too short tau_I is unstable on every model, the cure is on trial, and a tone from outside rises."""
    lost = PidGains(0.8 * GOOD.kp, 14.0 * GOOD.ki)
    process = MODEL.seen_by_controller(1.0).linear()
    assert math.isinf(sensitivity_peak(process, lost))
    table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (lost,))
    retuner, rig = Retuner(table, RetunerSettings(1.0, 100.0, Mode.AUTO, band=0.1)), Rig(GOOD, noise=0.02)
    for sample in rig.run(60):
        retuner.observe(sample)
    retuner.region_models = {0: learned_by_a_runaway()}
    prediction = predict([Plausible(MODEL, 0.0)], lost, GOOD, 1.0)
    retuner.ordered(0, Outcome("injected", "for a test"), GOOD, prediction)
    retuner.committed(0, GOOD)
    ended: list[Decision] = []
    for t in range(400):
        rig.load = 0.05 * 1.12 ** min(t, 90) * math.sin(2.0 * math.pi * t / 30.0)
        ended += [made for made in map(retuner.observe, rig.run(1)) if made and made.action is Action.RESTORE]
        if ended:
            break
    assert ended[0].code == "undo_runaway"
    assert ended[0].gains_after == GOOD
    assert "no earlier gains are expected to be better" in ended[0].reason
    assert "previous gains unstable" in ended[0].reason
    assert retuner.table.gains[0] == GOOD


def test_an_undo_that_does_not_speak_against_the_gains_forgets_nothing() -> None:
    known, stand = learned_by_a_runaway(), Stand()
    stand.retuner.region_models = {0: known}
    decision = stand.retuner.observe(next(stand.rig.run(1))._replace(mode=LoopMode.MANUAL))
    assert decision.code == "undo_manual"
    assert stand.retuner.region_models == {0: known}


def test_a_gap_or_manual_mode_ends_the_trial() -> None:
    stand = Stand()
    sample = next(stand.rig.run(1))
    decision = stand.retuner.observe(sample._replace(t_s=sample.t_s + 9.0))
    assert decision.code == "undo_gap"
    stand = Stand()
    decision = stand.retuner.observe(next(stand.rig.run(1))._replace(mode=LoopMode.MANUAL))
    assert decision.code == "undo_manual"
    assert stand.retuner.table.gains == (GOOD,)


def test_a_change_is_held_while_another_is_on_trial() -> None:
    made = Stand().retuner.ordered(0, Outcome("injected", "for a test"), GOOD, PROMISE)
    assert (made.action, made.code) == (Action.NONE, "held_trial")


def test_a_restart_of_the_host_in_mid_trial_loses_nothing() -> None:
    stand, twin = Stand(), Stand()
    for one in (stand, twin):
        one.rig.load = 10.0
        assert list(one.run(25)) == []
    memory = json.loads(json.dumps(remember(stand.retuner), allow_nan=False))
    stand.retuner = restore(memory, stand.retuner.settings)
    assert stand.retuner.trials.to_dict() == twin.retuner.trials.to_dict()
    assert next(stand.run(100)).canonical() == next(twin.run(100)).canonical()


# What moves the error while nothing happens: measured before a change, and no evidence against it afterwards.


def samples(errors: list[float], revision: int = 0) -> list[LoopSample]:
    return [LoopSample(float(i), 1.0, 1.0 - e, 0.0, LoopMode.AUTO, 0, 1.0, revision) for i, e in enumerate(errors)]


def walk(n: int, std: float, seed: int = 1) -> list[float]:
    """First order, a correlation time of ten samples."""
    rng, x, out = np.random.default_rng(seed), 0.0, []
    for _ in range(n):
        x = 0.9 * x + std * math.sqrt(1 - 0.81) * float(rng.standard_normal())
        out.append(x)
    return out


def test_a_load_that_never_rests_is_measured_and_upsets_that_end_are_not() -> None:
    assert 0.15 < load_variability(samples(walk(2000, 0.3)))[0] < 0.3
    upset = [0.01 * (-1) ** i for i in range(2000)]
    for at in range(0, 2000, 500):
        upset[at : at + 200] = [math.exp(-i / 40) for i in range(200)]
    assert load_variability(samples(upset))[0] == pytest.approx(0.01, rel=0.05)
    slow = [math.exp(-i / 800) + 0.01 * (-1) ** i for i in range(2000)]
    assert load_variability(samples(slow))[0] == pytest.approx(0.01, rel=0.1)


def test_only_what_ran_under_the_gains_in_force_counts_and_little_says_nothing() -> None:
    calm = samples([0.01 * (-1) ** i for i in range(FEWEST_BLOCKS * BLOCK)], revision=1)
    assert load_variability(samples([(-1.0) ** i for i in range(3000)]) + calm) == pytest.approx((0.01, 0.01), rel=1e-3)
    assert load_variability(calm[1:]) == (0.0, 0.0)
    assert load_variability([]) == (0.0, 0.0)


def test_how_far_the_error_went_is_that_of_three_blocks_in_four_whatever_its_slope() -> None:
    """A load that pauses for half of the time counts, an upset in one block of five does not."""
    slow = [8.0 * math.sin(math.pi * i / 600) for i in range(2400)]
    wander, moved = load_variability(samples(slow))
    assert wander < 0.3
    assert 3.0 < moved < 8.0
    for lasts, period, most in ((500, 1000, 8.0), (100, 500, 0.5)):
        pauses = [(8.0 if i % period < lasts else 0.5) * math.sin(i / 10) for i in range(2000)]
        assert load_variability(samples(pauses))[1] == pytest.approx(most, rel=0.02)


@pytest.mark.parametrize(
    ("times", "swings", "seen", "known"),
    [(0.5, False, (0.2, 0.5), True), (0.5, True, (0.0, 0.0), True), (2.0, True, (0.0, 0.5), True),
     (2.0, True, (0.0, 0.7), False)],
)  # fmt: skip
def test_a_swing_is_the_loops_own_where_less_action_is_the_answer(times, swings, seen, known):
    """Where gains have not run for long, what was known before them still holds."""
    now = PidGains(1.0, 0.1)
    table = GainTable("loop", Regions("sp", "-", ("all",), -1e6, (), 1e6), (now,))
    model = Plausible(ProcessModel("fopdt", 1.0, 20.0, theta_s=2.0), 0.0)
    proof: Any = SimpleNamespace(gains=PidGains(times, times * 0.1), allowed=(model,))
    peaks = tuple(Peak(float(i), (-0.8 if swings else -0.1) ** i) for i in range(3))
    response = Response(0.0, 60.0, peaks, Ending.COMPLETE, sp_changed=False, band=0.01)
    rows = samples([0.5 * math.sin(i / 7) for i in range(2000 if known else 100)])
    last = Trial(new=now, prediction=replace(PROMISE, moved=0.7))
    found = prediction_of(proof, table, 0, (0.0, 0.0), response, RetunerSettings(1.0, 100.0), rows, last)
    assert (found.wander > 0.0, found.moved) == (seen[0] > 0.0, pytest.approx(seen[1], rel=0.01))


def ran(prediction: Prediction, errors: list[float]) -> int | None:
    """The sample at which it is a runaway."""
    law, state = law_of(prediction, TrialSettings(), 60.0), divergence_begin(1.0)
    for i, sample in enumerate(samples(errors)):
        state, found = divergence_step(law, state, sample, 0.01)
        if found is TrialEvent.RUNAWAY:
            return i
    return None


@pytest.mark.parametrize("before", [{"wander": 0.2}, {"moved": 0.4}])
def test_what_went_on_before_is_no_runaway_and_what_outgrows_it_is(before: dict[str, float]) -> None:
    errors = [0.2 * (1 + 0.15 * (i // 20 % 4)) * math.sin(math.pi * i / 20) for i in range(400)]
    assert ran(PROMISE, errors) is not None
    known = replace(PROMISE, **before)
    assert ran(known, errors) is None
    growing = [0.2 * math.exp(i / 80) * math.sin(math.pi * i / 20) for i in range(600)]
    assert ran(known, growing) is not None


def test_noise_is_the_least_of_it_and_it_is_remembered() -> None:
    known = replace(PROMISE, wander=0.2, moved=0.3)
    assert sigma_of(0.4, PROMISE) == pytest.approx(0.1)
    assert sigma_of(0.4, known) == pytest.approx(0.2)
    assert Prediction.from_dict(known.to_dict()) == known
    before = known.to_dict()
    del before["wander"], before["moved"]
    assert Prediction.from_dict(before) == PROMISE


def integrating(theta_s: float) -> ClosedLoop:
    """The same loop at every dead time: its response to a load is theta times as large, and as long."""
    return ClosedLoop(LinearProcess(0.1, (), (), theta_s, 1), PidGains(5.0 / theta_s, 5.0 / theta_s / (8.0 * theta_s)))


def test_a_load_that_walks_moves_another_loop_by_its_own_response() -> None:
    here, there = integrating(1.0), integrating(4.0)
    assert load_variability_there(0.3, 0.0, here, here) == pytest.approx(0.3)
    assert load_variability_there(0.3, 0.0, here, there) == pytest.approx(0.3 * 4.0**1.5, rel=1e-6)
    assert load_variability_there(0.5, 0.3, here, there) == pytest.approx(math.hypot(0.3, 0.4 * 4.0**1.5), rel=1e-6)


def test_what_is_noise_is_the_same_everywhere() -> None:
    assert load_variability_there(0.2, 0.3, integrating(1.0), integrating(4.0)) == 0.2


# The check after the fact: what a record says of both sets undoes what kept a false promise, and only that.


S = TrialSettings()
DT_S = 1.0
TRUE = [
    Plausible(replace(MODEL, k=MODEL.k * k, theta_s=MODEL.theta_s * theta), 0.5)
    for k, theta in product((1.0, 0.9, 1.1), (1.0, 0.9, 1.1))
]
SLUGGISH = BAD["kc /4"]
STRONG = PidGains(1.8 * GOOD.kp, 1.8 * GOOD.ki)  # Ms about 2.8: no runaway, and hardly a swing after a load


def lie(tried: PidGains, k: float) -> Prediction:
    """What a model with another gain promises of the tried set."""
    return predict([Plausible(replace(MODEL, k=MODEL.k * k), 0.0)], GOOD, tried, DT_S)


def test_the_numbers_are_those_of_the_margins_and_of_the_integral_time() -> None:
    found = check_posterior(TRUE, GOOD, STRONG, DT_S)
    peaks = [sensitivity_peak(replace(p.model, theta_s=p.model.theta_s + DT_S / 2).linear(), STRONG) for p in TRUE]
    assert found.ms_tried == pytest.approx(min(peaks))
    assert found.robuster
    assert 1.55 < found.ms_old < S.harmless_ms
    slow = check_posterior(TRUE[:1], GOOD, SLUGGISH, DT_S)
    assert slow.slower == pytest.approx(4.0, rel=0.1)  # both IAE go with 1/ki where nothing swings


def test_a_sluggish_set_that_a_wrong_model_calls_right_is_found_out() -> None:
    believed = lie(SLUGGISH, 4.0)
    seen = responses(Rig(SLUGGISH, noise=0.025), 2500, load=10.0)[0]
    assert judge(seen, believed, SLUGGISH, S).finding is not TrialFinding.WORSE  # its IAE is 1/ki, as promised
    found = judge(replace(seen, posterior=check_posterior(TRUE, GOOD, SLUGGISH, DT_S)), believed, SLUGGISH, S)
    assert found.finding is TrialFinding.WORSE
    assert "times that with the previous gains" in found.reason
    numbers = found.numbers.to_dict()
    assert numbers["cost"] > numbers["cost_limit"]


def test_a_set_that_is_too_strong_is_found_out_after_a_load() -> None:
    believed = lie(STRONG, 1 / 1.8)
    seen = responses(Rig(STRONG, noise=0.025), 400, load=10.0)[0]
    assert judge(seen, believed, STRONG, S).finding is not TrialFinding.WORSE
    found = judge(replace(seen, posterior=check_posterior(TRUE, GOOD, STRONG, DT_S)), believed, STRONG, S)
    assert found.finding is TrialFinding.WORSE
    assert "Ms is at least" in found.reason
    numbers = found.numbers.to_dict()
    assert numbers["ms"] > numbers["ms_limit"]


def test_one_model_that_clears_the_tried_set_is_enough() -> None:
    for tried, k in ((SLUGGISH, 4.0), (STRONG, 1 / 1.8)):
        clears = Plausible(replace(MODEL, k=MODEL.k * k), 3.0)
        assert not against(check_posterior([*TRUE, clears], GOOD, tried, DT_S), lie(tried, k), S)[0]


def test_the_check_after_the_fact_decides_where_the_loop_was_not_at_rest() -> None:
    rig = Rig(SLUGGISH, noise=0.025)
    rig.load = 10.0
    moving = next(seen for seen in responses(rig, 2500, rest=60, sp=5.0) if seen.response.sp_changed)
    found = judge(moving, lie(SLUGGISH, 4.0), SLUGGISH, S)
    assert (found.finding, "not at rest" in found.reason) == (TrialFinding.INCONCLUSIVE, True)
    known = replace(moving, posterior=check_posterior(TRUE, GOOD, SLUGGISH, DT_S))
    assert judge(known, lie(SLUGGISH, 4.0), SLUGGISH, S).finding is TrialFinding.WORSE


def test_the_check_after_the_fact_is_silent_where_something_else_is_behind_the_response() -> None:
    seen = responses(Rig(STRONG, noise=0.025), 400, load=10.0)[0]
    known = replace(seen, posterior=check_posterior(TRUE, GOOD, STRONG, DT_S), outside="a valve that sticks")
    assert judge(known, lie(STRONG, 1 / 1.8), STRONG, S).finding is TrialFinding.INCONCLUSIVE


SEEN = PosteriorCheck(ms_tried=1.3, ms_most=1.4, ms_old=1.8, robuster=False, slower=3.0)
"""The tried set is three times as slow as an old one that is robust."""


def test_a_cure_is_not_undone_for_being_slower_than_a_set_that_is_not_robust() -> None:
    believed = lie(SLUGGISH, 4.0)
    assert "3.00 times" in against(SEEN, believed, S)[0]
    assert not against(replace(SEEN, ms_old=S.harmless_ms + 0.01), believed, S)[0]
    assert not against(replace(SEEN, ms_old=math.inf), believed, S)[0]


def test_what_was_seen_of_the_old_set_counts_more_than_what_models_say_of_it() -> None:
    believed = lie(SLUGGISH, 4.0)
    assert against(SEEN, replace(believed, decay_seen=S.harmless_decay), S)[0]
    assert not against(SEEN, replace(believed, decay_seen=S.harmless_decay + 0.01), S)[0]


def test_a_set_is_not_undone_for_one_that_is_no_more_robust() -> None:
    strong = PosteriorCheck(ms_tried=2.5, ms_most=2.6, ms_old=2.7, robuster=True, slower=0.5)
    believed = lie(STRONG, 1 / 1.8)
    assert "limit 2.10" in against(strong, believed, S)[0]
    assert not against(replace(strong, robuster=False), believed, S)[0]


def test_a_promise_of_being_faster_is_not_held_against_a_set_that_is_not_slower() -> None:
    fast = predict(TRUE[:1], SLUGGISH, GOOD, DT_S)
    words, numbers = against(replace(SEEN, slower=1.4), fast, S)
    assert not words
    assert numbers.cost_promised is not None
    assert numbers.cost_promised < 0.5
    assert numbers.cost_limit == S.iae_slack


def test_no_promise_makes_an_unstable_loop_pass() -> None:
    believed = predict(TRUE, SLUGGISH, GOOD, DT_S)
    assert believed.ms is not None
    unsafe = replace(believed, ms=Spread(2.0, 1.5, math.inf))
    runs_away = PosteriorCheck(ms_tried=math.inf, ms_most=math.inf, ms_old=1.5, robuster=True, slower=0.0)
    assert not in_favour(runs_away, S)
    assert not in_favour(replace(runs_away, ms_tried=1.5, ms_most=S.harmless_ms + 0.01), S)
    words, numbers = against(runs_away, unsafe, S)
    assert "unstable" in words
    assert (numbers.ms, numbers.ms_limit) == (-1.0, S.harmless_ms)


def test_a_set_that_costs_as_much_as_promised_is_kept() -> None:
    half = PidGains(GOOD.kp / 2, GOOD.ki / 2)
    assert against(check_posterior(TRUE, GOOD, half, DT_S), lie(half, 6.0), S)[0]
    assert not against(check_posterior(TRUE, GOOD, half, DT_S), predict(TRUE, GOOD, half, DT_S), S)[0]


def test_a_promised_ms_is_no_ground_to_undo() -> None:
    found = PosteriorCheck(ms_tried=2.2, ms_most=2.3, ms_old=1.5, robuster=True, slower=0.7)
    assert against(found, lie(STRONG, 1 / 1.8), S)[0]
    prediction = predict([Plausible(MODEL, 0.0)], GOOD, STRONG, DT_S)
    assert prediction.ms.high > found.ms_tried
    assert not against(found, prediction, S)[0]


def test_without_integral_action_before_nothing_is_said_of_the_cost() -> None:
    assert check_posterior(TRUE[:1], PidGains(GOOD.kp, 0.0), SLUGGISH, DT_S).slower == 0.0


def test_a_robust_set_need_not_wait_for_a_step_from_rest() -> None:
    rig = Rig(GOOD, noise=0.025)
    rig.load = 10.0
    moving = next(seen for seen in responses(rig, 2500, rest=30, sp=5.0) if seen.response.sp_changed)
    believed = predict(TRUE, SLUGGISH, GOOD, DT_S)
    assert judge(moving, believed, GOOD, S).finding is TrialFinding.INCONCLUSIVE
    said = check_posterior(TRUE, SLUGGISH, GOOD, DT_S)
    known = replace(moving, posterior=said)
    found = judge(known, believed, GOOD, S)
    assert found.finding is TrialFinding.AS_PROMISED
    assert "robust according to the models: Ms at most" in found.reason
    doubtful = Plausible(replace(MODEL, k=2.0), 3.0)
    unsure = replace(moving, posterior=check_posterior([*TRUE, doubtful], SLUGGISH, GOOD, DT_S))
    assert judge(unsure, believed, GOOD, S).finding is TrialFinding.INCONCLUSIVE
    unsettled = replace(known, posterior=replace(said, settled=False))
    assert judge(unsettled, believed, GOOD, S).finding is TrialFinding.INCONCLUSIVE
    small = replace(known, response=replace(moving.response, band=10.0))
    assert judge(small, believed, GOOD, S).finding is TrialFinding.INCONCLUSIVE


def test_only_a_record_that_shows_the_process_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, ...]] = []

    def noted(*given: Any) -> PosteriorCheck | None:
        asked.append(given)
        return posterior_of(*given)

    monkeypatch.setattr(decide, "posterior_of", noted)
    table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (GOOD,))
    retuner, rig = Retuner(table, RetunerSettings(1.0, 100.0, Mode.AUTO, band=0.1)), Rig(GOOD, noise=0.02)
    _ = [retuner.observe(sample) for sample in rig.run(60)]
    retuner.ordered(0, Outcome("injected", "for a test"), SLUGGISH, lie(SLUGGISH, 4.0))
    retuner.committed(0, SLUGGISH)
    rig.change(SLUGGISH)
    _ = [retuner.observe(sample) for sample in rig.run(40)]
    rig.sp = 5.0
    decision = next(filter(None, (retuner.observe(sample) for sample in rig.run(2000))))
    assert decision.action is Action.RESTORE
    ((case, learned, trial, settings),) = asked

    def with_(**changes: Any) -> PosteriorCheck | None:
        estimate = replace(learned.estimate, **{k: v for k, v in changes.items() if k != "agreement"})
        now = replace(learned, estimate=estimate, agreement=changes.get("agreement", learned.agreement))
        return posterior_of(case, now, trial, settings)

    usual, unsettled = with_(), with_(identifiable=False)
    assert unsettled == replace(usual, settled=False)
    assert (usual.settled, usual.slower > 3.0) == (True, True)
    assert with_(agreement=Agreement.SILENT) is None
    assert with_(plausible=()) is None
    assert with_(residual_std=1e3) is None
    assert posterior_of(case, None, trial, settings) is None

    def odd(records: int, *, identifiable: bool) -> PosteriorCheck | None:
        known = replace(learned.region_model, records=records)
        estimate = replace(learned.estimate, identifiable=identifiable)
        return posterior_of(case, Learned(known, estimate, Agreement.CONTRADICTS, 9.0), trial, settings)

    assert odd(2, identifiable=False) is None  # two that agree stand against what cannot name the process
    assert odd(1, identifiable=False) == unsettled
    assert odd(2, identifiable=True) == usual

    def agreeing(records: int) -> PosteriorCheck | None:
        known = replace(learned.region_model, records=records)
        return posterior_of(case, Learned(known, learned.estimate, Agreement.AGREES, 0.0), trial, settings)

    assert agreeing(2) == usual
    assert agreeing(3) == replace(usual, agreed=True)


def test_peaks_that_several_records_explain_by_loads_take_no_robust_set_back() -> None:
    """Two loads in one response are a swing that grows, in the calmest loop."""
    ringing = PidGains(2.2 * GOOD.kp, 4 * GOOD.ki)
    prediction = predict([Plausible(MODEL, 0.0)], SLUGGISH, ringing, 1.0)
    held = replace(prediction, setpoint=PROMISE.setpoint, load_step=PROMISE.load_step)
    robust = PosteriorCheck(1.5, 1.7, 1.1, robuster=False, slower=0.3, agreed=True)
    seen = replace(responses(Rig(ringing), 400, load=10.0)[0], posterior=robust)
    kept = judge(seen, held, ringing, S)
    assert kept.finding is TrialFinding.AS_PROMISED
    assert "robust according to the models: Ms at most 1.70" in kept.reason
    assert "loads explain this response: half-cycle decay ratio" in kept.reason
    for doubt in ({"agreed": False}, {"settled": False}, {"ms_most": 2.5}):
        assert judge(replace(seen, posterior=replace(robust, **doubt)), held, ringing, S).finding is TrialFinding.WORSE
