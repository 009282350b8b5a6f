"""What the guard lets through shows no failed check, whatever is asked; and what it says of each."""

import math
from dataclasses import replace

import pytest
from effort import examples
from guard_cases import GAINS, SETTINGS, known, request, times
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from retuner.adaptive.guard import ChangeRequest, Evidence, GuardSettings, Locks, Proof, Ruling, Support, prove
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import Tuning
from retuner.schedule.gains import PidGains

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
@settings(max_examples=examples(200), deadline=None)
@given(
    sets=st.tuples(KC, KC, KC),
    limits=limits_of(),
    kind=st.sampled_from(sorted(MODELS)),
    urgent=st.booleans(),
    locks=st.builds(Locks, st.booleans(), st.booleans(), st.booleans()),
    odd=st.booleans(),
    kp=st.sampled_from([(1, 1, 1), (0, 1, 1), (1, 0, 1), (1, 1, 0)]),
)
def test_no_accepted_change_shows_a_failed_check(
    sets: tuple[tuple[float, float, float], ...],
    limits: GuardSettings,
    kind: str,
    urgent: bool,
    locks: Locks,
    odd: bool,
    kp: tuple[int, int, int],
) -> None:
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
