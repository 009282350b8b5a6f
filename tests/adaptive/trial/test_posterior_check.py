"""The check after the fact: what a record says of both sets undoes what kept a false promise, and only that."""

import math
from dataclasses import replace
from itertools import product
from typing import Any

import pytest
from rig import BAD, GOOD, MODEL, PROMISE, Rig, responses

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.update import Agreement, Learned
from retuner.adaptive.supervision import decide
from retuner.adaptive.supervision.decision import Action, Mode, Outcome
from retuner.adaptive.supervision.judge_evidence import posterior_of
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.judge import TrialFinding, judge
from retuner.adaptive.trial.posterior_check import PosteriorCheck, against, check_posterior, in_favour
from retuner.adaptive.trial.prediction import Prediction, Spread, predict
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

S = TrialSettings()
DT_S = 1.0
TRUE = [
    Plausible(replace(MODEL, k=MODEL.k * k, theta_s=MODEL.theta_s * theta), 0.5)
    for k, theta in product((1.0, 0.9, 1.1), (1.0, 0.9, 1.1))
]
SLUGGISH = BAD["kc /4"]
STRONG = PidGains(1.8 * GOOD.kp, 1.8 * GOOD.ki)
"""Ms about 2.8: no runaway, and hardly a swing after a load."""


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
    cost = numbers.cost
    assert cost.cost_promised is not None
    assert cost.cost_promised < 0.5
    assert cost.cost_limit == S.iae_slack


def test_no_promise_makes_an_unstable_loop_pass() -> None:
    believed = predict(TRUE, SLUGGISH, GOOD, DT_S)
    assert believed.ms is not None
    unsafe = replace(believed, ms=Spread(2.0, 1.5, math.inf))
    runs_away = PosteriorCheck(ms_tried=math.inf, ms_most=math.inf, ms_old=1.5, robuster=True, slower=0.0)
    assert not in_favour(runs_away, S)
    assert not in_favour(replace(runs_away, ms_tried=1.5, ms_most=S.harmless_ms + 0.01), S)
    words, numbers = against(runs_away, unsafe, S)
    assert "unstable" in words
    assert (numbers.robustness.ms, numbers.robustness.ms_limit) == (-1.0, S.harmless_ms)


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
