"""What may pass, what may not, and that nothing passes unproved."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from effort import examples
from guard_cases import BEST, GAINS, MODEL, SAMPLED, SETTINGS, known, request, times
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from retuner import PidGains, ProcessModel, ProcessType
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.model_set import MOST_LOG_STEP, allowed
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.request import ChangeRequest, Evidence, Locks, NeighbourBoundary, Support
from retuner.adaptive.guard.ruling import Proof, Ruling
from retuner.adaptive.guard.step_size import change_factor
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.simc import simc


def ms_of(model: ProcessModel, gains: PidGains, sample_time_s: float = 1.0) -> float:
    return sensitivity_peak(replace(model, theta_s=model.theta_s + sample_time_s / 2).linear(), gains)


def worst_of(models: tuple[Plausible, ...], gains: PidGains) -> float:
    return max(ms_of(p.model, gains) for p in models)


def test_a_good_step_passes_whole() -> None:
    verdict = prove(request(times(0.6, 0.6)), SETTINGS)
    assert verdict.ruling == Ruling.ACCEPTED
    assert verdict.step == 1.0
    assert verdict.gains == GAINS
    assert verdict.ms_nominal == pytest.approx(1.6014, abs=1e-4)
    assert verdict.ms_nominal == pytest.approx(ms_of(MODEL, GAINS))
    assert verdict.ms_before == pytest.approx(ms_of(MODEL, times(0.6, 0.6)))
    assert verdict.ms_worst == pytest.approx(worst_of(known(), GAINS))
    assert verdict.ms_worst > verdict.ms_nominal
    assert verdict.tau_c_s == BEST.tau_c_s
    assert not verdict.urgent


def test_doubt_slows_and_more_doubt_takes_a_smaller_step() -> None:
    slowed = prove(request(times(0.6, 0.6), models=known(0.2)), SETTINGS)
    assert slowed.ruling == Ruling.ACCEPTED
    assert 5.5 < slowed.tau_c_s <= 1.3 * 5.5 * (1 + 1e-9)
    assert slowed.step == 1.0
    assert slowed.ms_worst <= SETTINGS.ms_worst < worst_of(known(0.2), GAINS)
    smaller = prove(request(times(0.6, 0.6), models=known(0.3)), SETTINGS)
    assert smaller.ruling == Ruling.ACCEPTED
    assert smaller.step == pytest.approx(0.5)
    refused = prove(request(times(0.9, 0.5), models=known(0.6)), SETTINGS)
    assert refused.ruling in {Ruling.NOT_ROBUST, Ruling.SAFER}


def test_the_smallest_tau_c_that_is_robust_is_taken() -> None:
    verdict = prove(request(times(0.6, 0.6), models=known(0.2)), SETTINGS)
    tighter = simc(SAMPLED, verdict.tau_c_s / SETTINGS.tau_c_max_ratio ** (1 / 3)).gains
    assert worst_of(known(0.2), tighter) > SETTINGS.ms_worst


def test_a_proposal_without_tau_c_has_half_steps_only() -> None:
    fixed = Tuning("pattern", "parallel", times(1.6, 1.6))
    verdict = prove(request(times(0.8, 0.8), fixed), SETTINGS)
    assert verdict.step == pytest.approx(0.5)
    assert verdict.gains.kp == pytest.approx(0.8 * 2**0.5 * GAINS.kp)
    assert ms_of(MODEL, fixed.gains) > SETTINGS.ms_nominal
    assert verdict.tau_c_s == 0.0


def test_where_nothing_is_proved_the_safest_whole_step_is_taken() -> None:
    verdict = prove(request(times(2.5, 2.5), models=known(0.6)), SETTINGS)
    slowest = simc(SAMPLED, 1.3 * 5.5)
    assert verdict.ruling == Ruling.SAFER
    assert verdict.step == 1.0
    assert (verdict.gains.kp, verdict.gains.ki) == pytest.approx((slowest.gains.kp, slowest.gains.ki))
    assert verdict.tau_c_s == pytest.approx(slowest.tau_c_s)
    assert verdict.ms_worst > SETTINGS.ms_worst


def test_an_oscillating_loop_takes_the_whole_step_at_once() -> None:
    wild = times(6.0, 40.0)
    verdict = prove(request(wild), SETTINGS)
    assert verdict.ruling == Ruling.URGENT
    assert verdict.urgent
    assert verdict.gains == GAINS
    assert math.isinf(verdict.ms_before)
    assert "unstable" in verdict.sentence


def test_a_measured_oscillation_counts_where_the_model_does_not_see_it() -> None:
    calm = Tuning("pattern", "parallel", times(0.1, 0.1))
    wide = GuardSettings(total_ratio_max=100.0)
    ordinary = prove(request(GAINS, calm), wide)
    urgent = prove(replace(request(GAINS, calm), urgent=True), wide)
    assert urgent.gains is not None
    assert ordinary.gains.kp == pytest.approx(GAINS.kp / 4)
    assert urgent.gains == calm.gains
    assert urgent.ruling == Ruling.URGENT


def test_without_a_model_small_steps_only_unless_an_oscillation_asks_for_less() -> None:
    pattern = Evidence(records=0, support=Support.PATTERN)
    asked = replace(request(times(0.4, 0.4), models=()), evidence=pattern)
    verdict = prove(asked, SETTINGS)
    assert verdict.gains.kp == pytest.approx(0.6 * GAINS.kp)
    assert math.isnan(verdict.ms_nominal)
    assert verdict.to_dict()["ms"] == {"nominal": None, "worst": None, "before": None}
    assert prove(replace(asked, urgent=True), SETTINGS).gains == verdict.gains  # more action is never hurried
    less = replace(request(times(3, 3), models=()), evidence=pattern)
    slowly, at_once = prove(less, SETTINGS), prove(replace(less, urgent=True), SETTINGS)
    assert slowly.gains.kp == pytest.approx(2 * GAINS.kp)
    assert not slowly.urgent
    assert at_once.gains == GAINS
    assert at_once.urgent
    assert at_once.step == 1.0


def test_an_urgent_step_is_held_by_the_limits_that_point_to_more_action() -> None:
    slow = ProcessModel(ProcessType.INTEGRATING, 0.04, theta_s=5.0)
    good = simc(replace(slow, theta_s=5.5))
    swinging = PidGains(good.gains.kp / 8, good.gains.ki)
    verdict = prove(request(swinging, good, known(0.02, slow), good.gains), SETTINGS)
    assert verdict.ruling == Ruling.SAFER
    assert verdict.urgent
    assert verdict.gains.kp == pytest.approx(2 * swinging.kp)


def test_no_dead_band_for_a_loop_over_its_limit() -> None:
    over = PidGains(GAINS.kp * 1.04, GAINS.ki * 1.04)
    tight = GuardSettings(ms_nominal=1.62)
    assert ms_of(MODEL, over) > 1.62 > ms_of(MODEL, GAINS)
    assert prove(request(over), SETTINGS).ruling == Ruling.TOO_SMALL
    verdict = prove(request(over), tight)
    assert verdict.ruling == Ruling.ACCEPTED
    assert verdict.gains.kp < over.kp


def test_a_loop_over_its_limit_is_never_called_as_good_and_is_made_calmer_where_the_rule_gives_what_it_has() -> None:
    same = Tuning("pattern", "parallel", times(1.5, 1.5))
    verdict = prove(request(times(1.5, 1.5), same), SETTINGS)
    assert verdict.ruling == Ruling.ACCEPTED
    assert verdict.gains is not None
    assert ms_of(MODEL, verdict.gains) <= SETTINGS.ms_nominal < verdict.ms_before
    locked = replace(request(times(1.5, 1.5), same), locks=Locks(kc=True, tau_i=True, tau_d=True))
    refused = prove(locked, SETTINGS)
    assert refused.ruling == Ruling.NOT_ROBUST
    assert "as good" not in refused.sentence


def test_only_tau_i_moves_where_that_is_all_that_is_free() -> None:
    same = Tuning("pattern", "parallel", times(1.0, 2.5))
    verdict = prove(replace(request(times(1.0, 2.5), same), locks=Locks(kc=True)), SETTINGS)
    assert verdict.gains.kp == GAINS.kp
    assert verdict.ms_nominal < verdict.ms_before


def neighbour(model: ProcessModel, gains: PidGains = GAINS, interpolated: bool = False) -> NeighbourBoundary:
    return NeighbourBoundary("hot", gains, (Plausible(model, 0.0),), 1.0 if interpolated else 0.6, interpolated)


FASTER = replace(MODEL, k=6.0)
BIG = PidGains(1e300, 1e-300)
REACHED: dict[Ruling, tuple[ChangeRequest, GuardSettings]] = {
    Ruling.ACCEPTED: (request(times(0.6, 0.6)), SETTINGS),
    Ruling.URGENT: (request(times(6.0, 40.0)), SETTINGS),
    Ruling.SAFER: (request(times(2.5, 2.5), models=known(0.6)), SETTINGS),
    Ruling.UNPROVED_STEP: (
        replace(request(times(0.6, 0.6), models=()), evidence=Evidence(support=Support.PATTERN)),
        SETTINGS,
    ),
    Ruling.UNPROVED_WAY_OUT: (
        replace(request(times(3, 3), models=()), evidence=Evidence(support=Support.PATTERN), urgent=True),
        SETTINGS,
    ),
    Ruling.TOO_SMALL: (request(times(0.97, 0.98)), SETTINGS),
    Ruling.NOT_ROBUST: (request(times(0.9, 0.5), models=known(0.45)), SETTINGS),
    Ruling.NOT_ROBUST_AT_BORDER: (replace(request(times(0.8, 0.8)), boundaries=(neighbour(FASTER),)), SETTINGS),
    Ruling.OUTSIDE_LIMITS: (request(times(0.6, 0.6)), GuardSettings(kc_max=0.5 * GAINS.kp)),
    Ruling.OUTSIDE_TOTAL: (request(times(0.6, 1.0), commissioned=times(0.15, 1.0)), SETTINGS),
    Ruling.LOCKED: (replace(request(times(0.6, 0.6)), locks=Locks(kc=True)), SETTINGS),
    Ruling.WRONG_SIGN: (request(times(-1.0, -1.0)), SETTINGS),
    Ruling.NOT_FINITE: (request(times(0.6, 0.6), Tuning("x", "parallel", BIG)), SETTINGS),
    Ruling.NO_MODEL: (request(times(0.6, 0.6), models=()), SETTINGS),
    Ruling.TOO_FEW_RECORDS: (request(times(0.6, 0.6)), GuardSettings(records_min=2)),
    Ruling.NOT_SETTLED: (replace(request(times(0.6, 0.6)), evidence=Evidence(settled=False)), SETTINGS),
    Ruling.TOO_OLD: (replace(request(times(0.6, 0.6)), evidence=Evidence(age_s=3e6)), SETTINGS),
    Ruling.CONTRADICTED: (replace(request(times(0.6, 0.6)), evidence=Evidence(innovation=40.0, gate=20.0)), SETTINGS),
}
ACCEPTING = {Ruling.ACCEPTED, Ruling.URGENT, Ruling.SAFER, Ruling.UNPROVED_STEP, Ruling.UNPROVED_WAY_OUT}
"""Rulings that let gains through."""


@pytest.mark.parametrize("ruling", list(Ruling))
def test_every_ruling_is_reached_and_told_with_its_numbers(ruling: Ruling) -> None:
    verdict = prove(*REACHED[ruling])
    assert verdict.ruling == ruling
    assert verdict.accepted == (ruling in ACCEPTING)
    told = verdict.to_dict()
    json.dumps(told, allow_nan=False)
    assert told["code"] == told["ruling"] == ruling.name.lower()
    assert "{" not in verdict.sentence
    assert told["reason"] == verdict.sentence
    assert all(0 < len(check.words) < 90 for check in verdict.checks)
    if verdict.accepted:
        assert all(check.passed for check in verdict.checks)
    elif ruling in {Ruling.NOT_ROBUST, Ruling.NOT_ROBUST_AT_BORDER, Ruling.OUTSIDE_LIMITS, Ruling.TOO_OLD}:
        assert not all(check.passed for check in verdict.checks)


def test_doubtful_evidence_still_lets_a_loop_over_its_limit_have_less() -> None:
    doubted = Evidence(innovation=40.0, gate=20.0)
    verdict = prove(replace(request(times(3.0, 3.0)), evidence=doubted), SETTINGS)
    assert verdict.ruling == Ruling.SAFER
    assert verdict.gains.kp < 3 * GAINS.kp
    more = prove(replace(request(times(0.5, 3.0)), evidence=doubted), SETTINGS)
    assert more.ruling == Ruling.CONTRADICTED


def test_the_proof_holds_every_question() -> None:
    asked = {c.name for c in prove(replace(request(times(0.6, 0.6)), boundaries=(neighbour(MODEL),)), SETTINGS).checks}
    assert asked >= {
        "records",
        "age",
        "innovation",
        "step_kc",
        "step_tau_i",
        "step_integral",
        "total_kc",
        "total_tau_i",
        "tau_i_min",
        "ms_nominal",
        "ms_worst",
        "ms_border",
    }


def test_a_swinging_integrating_loop_gets_more_gain_as_the_safe_direction() -> None:
    slow = ProcessModel(ProcessType.INTEGRATING, 0.04, theta_s=5.0)
    good = simc(replace(slow, theta_s=5.5))
    swinging = PidGains(good.gains.kp / 2, good.gains.ki * 2)
    verdict = prove(request(swinging, good, known(0.3, slow)), SETTINGS)
    assert verdict.accepted
    assert verdict.gains.kp > swinging.kp
    assert ms_of(slow, verdict.gains) < ms_of(slow, swinging)


GAIN = st.floats(0.02, 50)


@settings(max_examples=examples(120))
@given(
    kp=GAIN,
    ki=GAIN,
    std=st.floats(0.001, 0.6),
    sign=st.sampled_from([1, -1]),
    urgent=st.booleans(),
    kind=st.sampled_from(["fopdt", "integrating"]),
    ratio=st.sampled_from([1.5, 4.0, 1000.0]),
)
def test_nothing_passes_unproved(kp, ki, std, sign, urgent, kind, ratio):
    fopdt = ProcessModel(ProcessType.FOPDT, sign * 2.0, 50.0, 0.0, 5.0)
    model = fopdt if kind == "fopdt" else ProcessModel(ProcessType.INTEGRATING, sign * 0.04, theta_s=5.0)
    best = simc(replace(model, theta_s=5.5))
    old, models = times(kp, ki, gains=best.gains), known(std, model)
    asked = replace(request(old, best, models), urgent=urgent)
    limits = GuardSettings(total_ratio_max=ratio)
    verdict = prove(asked, limits)
    over = ms_of(model, old) > limits.ms_nominal or worst_of(models, old) > limits.ms_worst
    if verdict.gains is None:
        assert verdict.step == 0.0
        return
    new = verdict.gains
    assert_within_change_limits(old, new, limits, all(ms_of(p.model, old) > limits.ms_worst for p in models) or urgent)
    assert 0 < verdict.step <= 1
    assert new.direction == old.direction
    assert new.kp / new.ki >= SETTINGS.tau_i_samples * 1.0 * (1 - 1e-9) or new.kp / new.ki >= old.kp / old.ki
    if verdict.ruling in {Ruling.ACCEPTED, Ruling.URGENT}:
        assert ms_of(model, new) <= limits.ms_nominal
        assert worst_of(models, new) <= limits.ms_worst
        assert change_factor(old, new) >= limits.smallest_change or over
    else:
        assert verdict.ruling == Ruling.SAFER
        assert over
        assert all(ms_of(p.model, new) <= ms_of(p.model, old) for p in models)


def assert_within_change_limits(old: PidGains, new: PidGains, limits: GuardSettings, urgent: bool) -> None:
    up = limits.step_up_max
    tau_i = () if urgent else ((old.ki / old.kp, new.ki / new.kp, up),)
    for before, after, most in ((old.kp, new.kp, up), (old.ki, new.ki, up**2), *tau_i):
        assert after / before <= most * (1 + 1e-9)
        assert urgent or before / after <= limits.step_down_max * (1 + 1e-9)
    assert abs(new.kp) <= limits.total_ratio_max * abs(old.kp) * (1 + 1e-9)
    assert new.ki / new.kp <= limits.total_ratio_max * old.ki / old.kp * (1 + 1e-9)


@settings(max_examples=examples(60))
@given(kp=st.floats(1.0, 30), ki=st.floats(1.0, 30), std=st.floats(0.001, 0.3))
def test_a_loop_that_is_too_hot_is_never_refused(kp: float, ki: float, std: float) -> None:
    verdict = prove(request(times(kp, ki), models=known(std)), SETTINGS)
    over = ms_of(MODEL, times(kp, ki)) > SETTINGS.ms_nominal
    assert verdict.accepted or not over


# What the guard lets through shows no failed check, whatever is asked; and what it says of each.


PATTERN = Evidence(records=0, support=Support.PATTERN)


def words_of(verdict: Proof, name: str) -> str:
    (check,) = (one for one in verdict.checks if one.name == name)
    assert check.passed
    return check.words


def of_pattern(in_force: PidGains, wanted: PidGains, commissioned: PidGains) -> ChangeRequest:
    asked = request(in_force, Tuning("pattern", "parallel", wanted), (), commissioned)
    return replace(asked, evidence=PATTERN)


def test_a_step_back_towards_the_commissioned_set_passes_and_says_that_it_leads_no_farther() -> None:
    verdict = prove(of_pattern(times(0.15, 0.15), times(0.19, 0.19), GAINS), SETTINGS)
    assert verdict.ruling == Ruling.UNPROVED_STEP
    assert verdict.gains.kp == pytest.approx(0.19 * GAINS.kp)
    assert words_of(verdict, "total_kc") == "kc as a factor of its baseline (no further than the active value, 6.667)"
    inside = prove(of_pattern(times(0.5, 0.5), times(0.6, 0.6), GAINS), SETTINGS)
    assert words_of(inside, "total_kc") == "kc as a factor of its baseline"


def test_a_step_beyond_the_commissioned_set_goes_no_farther() -> None:
    verdict = prove(of_pattern(times(0.15, 0.15), times(0.12, 0.12), GAINS), SETTINGS)
    assert verdict.ruling == Ruling.OUTSIDE_TOTAL
    limit = "refused: the limits leave no room for the change"
    assert verdict.sentence.startswith(f"{limit}; Kc held at ")
    assert "requested" not in verdict.sentence


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_was_cut_is_told_as_the_settings_show_it(sign: float) -> None:
    to, at = (PidGains(sign * share * GAINS.kp, sign * share * GAINS.ki) for share in (0.12, 0.15))
    verdict = prove(of_pattern(at, to, PidGains(sign * GAINS.kp, sign * GAINS.ki)), SETTINGS)
    assert f"Kc held at {0.15 * sign * GAINS.kp:.3g} (wanted {0.12 * sign * GAINS.kp:.3g}): " in verdict.sentence


def test_what_is_only_safer_says_so() -> None:
    verdict = prove(request(times(2.5, 2.5), models=known(0.6)), SETTINGS)
    assert verdict.ruling == Ruling.SAFER
    worst = "worst-case Ms over the plausible models (no worse than the active value, unstable)"
    assert words_of(verdict, "ms_worst") == worst


def test_a_derivative_on_its_way_is_left_out_while_it_is_too_short() -> None:
    wanted = PidGains(8 * GAINS.kp, 8 * GAINS.ki, 8 * GAINS.kp * 1.2)
    verdict = prove(of_pattern(GAINS, wanted, GAINS), SETTINGS)
    assert verdict.gains.kd == 0.0


@pytest.mark.parametrize("model", [True, False])
def test_from_outside_an_absolute_limit_the_way_leads_towards_it(model: bool) -> None:
    limits = GuardSettings(kc_max=0.05 * GAINS.kp)
    asked = of_pattern(GAINS, times(0.04, 0.04), GAINS)
    verdict = prove(replace(asked, models=known(), evidence=Evidence()) if model else asked, limits)
    assert 0.05 * GAINS.kp < verdict.gains.kp < GAINS.kp
    assert words_of(verdict, "kc_max").startswith("kc, at most kc_max (no further than the active value")


def test_a_locked_gain_stays_where_it_is_though_it_lies_outside_its_limits() -> None:
    limits = GuardSettings(kc_max=0.5 * GAINS.kp)
    asked = replace(request(times(1.0, 0.5), models=known()), locks=Locks(kc=True))
    verdict = prove(asked, limits)
    assert verdict.gains is None or verdict.gains.kp == GAINS.kp
    wide = prove(asked, GuardSettings())
    assert wide.gains.kp == GAINS.kp


FACTOR = st.floats(-4, 4).map(math.exp)
MAYBE = st.one_of(st.just(0.0), FACTOR)
KC, TIMES = st.tuples(FACTOR, FACTOR, MAYBE), st.sampled_from([0.0, 3.0, 30.0])
MODELS = {
    "none": (),
    "fopdt": known(0.3),
    "integrating": known(0.2, ProcessModel(ProcessType.INTEGRATING, 0.04, theta_s=5.0)),
}


@st.composite
def limits_of(draw: st.DrawFn) -> GuardSettings:
    """Limits that leave room, some of them tight."""
    kc_min, tau_i_min = draw(st.sampled_from([0.0, 0.5, 2.0])), draw(TIMES)
    return GuardSettings(
        kc_min=kc_min,
        kc_max=draw(st.sampled_from([2.0, 10.0, math.inf])),
        tau_i_min_s=tau_i_min,
        tau_i_max_s=draw(st.sampled_from([30.0, 200.0, math.inf])),
        tau_d_max_s=draw(st.sampled_from([2.0, 20.0, math.inf])),
        total_ratio_max=draw(st.sampled_from([1.0, 1.5, 4.0, 1000.0])),
        tau_i_samples=draw(st.sampled_from([0.0, 20.0])),
        pattern_step_max=draw(st.sampled_from([1.0, 1.5, 4.0])),
        records_min=draw(st.sampled_from([1, 3])),
    )


@pytest.mark.uncounted
@settings(max_examples=examples(200))
@given(
    sets=st.tuples(KC, KC, KC),
    limits=limits_of(),
    kind=st.sampled_from(sorted(MODELS)),
    urgent=st.booleans(),
    locks=st.builds(Locks, st.booleans(), st.booleans(), st.booleans()),
    odd=st.booleans(),
    kp=st.sampled_from([(1, 1, 1), (0, 1, 1), (1, 0, 1), (1, 1, 0)]),
)
def test_no_accepted_change_shows_a_failed_check(sets, limits, kind, urgent, locks, odd, kp):
    in_force, wanted, start = (
        times(p * share, i, 0.0) if not share or not d else PidGains(GAINS.kp * p, GAINS.ki * i, GAINS.kp * p * d)
        for (p, i, d), share in zip(sets, kp, strict=True)
    )
    assume(all(kp) or not locks.tau_d)
    evidence = Evidence(innovation=40.0 * odd, gate=20.0) if MODELS[kind] else PATTERN
    asked = ChangeRequest(
        in_force, start, Tuning("pattern", "parallel", wanted), MODELS[kind], 1.0, evidence, urgent=urgent, locks=locks
    )
    verdict = prove(asked, limits)
    assert all(0 < len(check.words) < 90 for check in verdict.checks)
    if verdict.accepted:
        assert [check for check in verdict.checks if not check.passed] == []


# The models that a change is proved on: as the record allows them, and farther apart when they are old


RECORD = replace(MODEL, k=2.2)
MORE_GAIN = replace(MODEL, k=2.2 * 1.1)
MORE_DELAY = replace(MODEL, k=2.2, theta_s=6.0)
RIVAL = ProcessModel(ProcessType.INTEGRATING, 0.045, theta_s=5.5)


def log(std: float = 0.1) -> LogModel:
    return LogModel(parameters_of(MODEL), std**2 * np.eye(3), 1)


def around(*models: tuple[ProcessModel, float]) -> tuple[Plausible, ...]:
    return (Plausible(RECORD, 0.0), *(Plausible(m, e) for m, e in models))


def test_the_deviations_of_the_record_are_carried_to_the_model_of_the_region() -> None:
    best, gain, delay = allowed(log(), around((MORE_GAIN, 3.9), (MORE_DELAY, 2.0)), 0.0, SETTINGS)
    assert best == Plausible(log().model(), 0.0)
    assert gain.model.k == pytest.approx(2.0 * 1.1)
    assert (delay.model.k, delay.model.theta_s) == (pytest.approx(2.0), pytest.approx(6.0))
    assert (gain.excess, delay.excess) == (3.9, 2.0)


def test_what_the_record_does_not_believe_is_left_out() -> None:
    assert len(allowed(log(), around((MORE_GAIN, 4.1), (MORE_DELAY, 4.0)), 0.0, SETTINGS)) == 2


def test_other_structures_count_as_they_are() -> None:
    models = allowed(log(), around((MORE_GAIN, 1.0), (RIVAL, 2.0)), 0.09, SETTINGS)
    assert models[-1] == Plausible(RIVAL, 2.0)


def test_age_widens_as_the_variances_add() -> None:
    for variance in (0.0, 0.0025, 0.01):
        moved = allowed(log(), around((MORE_GAIN, 1.0)), variance, SETTINGS)[1]
        assert math.log(moved.model.k / 2.0) ** 2 == pytest.approx(math.log(1.1) ** 2 + 4 * variance)


def test_age_ends_where_a_parameter_has_changed_by_two() -> None:
    moved = allowed(log(), around((MORE_GAIN, 1.0)), 100.0, SETTINGS)[1]
    assert moved.model.k == pytest.approx(4.0)
    far = around((replace(MODEL, k=2.2 * 5), 1.0))
    assert allowed(log(), far, 100.0, SETTINGS)[1].model.k == pytest.approx(10.0)


@pytest.mark.parametrize("known", [(), around(), (Plausible(RIVAL, 0.0), Plausible(MORE_GAIN, 1.0))])
def test_without_points_of_its_structure_the_covariance_stands_in(known: tuple[Plausible, ...]) -> None:
    models = allowed(log(0.1), known, 0.0, SETTINGS)
    corners = [p for p in models[1:] if p.model != MORE_GAIN]
    assert len(corners) == 6
    steps = [parameters_of(p.model) - log().x for p in corners]
    assert sorted(float(np.max(np.abs(step))) for step in steps) == pytest.approx([0.2] * 6)
    wide = [parameters_of(p.model) - log().x for p in allowed(log(3.0), (), 0.0, SETTINGS)[1:]]
    assert max(float(np.max(np.abs(step))) for step in wide) == pytest.approx(MOST_LOG_STEP)


def test_a_point_that_is_the_best_itself_stays() -> None:
    assert allowed(log(), around((RECORD, 0.5)), 0.04, SETTINGS)[1].model.k == pytest.approx(2.0)


def test_no_variance_that_is_none() -> None:
    for wrong in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="extra_variance"):
            allowed(log(), (), wrong, SETTINGS)
