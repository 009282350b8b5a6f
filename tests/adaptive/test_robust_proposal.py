"""The proposal on line: robust on what is still allowed, and none where too little is known, unless there is danger."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner import Action, Decision, LinearProcess, PidController, PidGains, ProcessModel, ProcessType, RetunerSettings
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import RobustSettings, believed, robust_simc_on
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.from_neighbours import spread
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import predicted
from retuner.adaptive.rules.rule import ControllerKind
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.supervision.findings import no_more_action, propose
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.trial.response_numbers import UPSETS, shapes

S = RetunerSettings(0.5, 100.0)
FIRST = ProcessModel(ProcessType.FOPDT, 2.0, 20.0, 0.0, 4.0)
LAGGING = ProcessModel(ProcessType.INTEGRATING_LAG, 0.1, 0.0, 8.0, 0.8)
SECOND = ProcessModel(ProcessType.SOPDT, 1.0, 10.0, 10.0, 0.5, 0.5)


def known(model: ProcessModel, std: float = 0.02, *, identifiable: bool = True) -> RegionModel:
    x = parameters_of(model)
    log = LogModel(x, std**2 * np.eye(len(x)), 1, model.type)
    return RegionModel(
        (StructureModel(log, 0.0),), 2, 0.0, None, (), spread(log), identifiable, "too little excitation"
    )


def ms(model: ProcessModel, gains: PidGains) -> float:
    return sensitivity_peak(model.seen_by_controller(S.sample_time_s).linear(), gains)


def of(region_model: RegionModel, gains: PidGains) -> tuple[PidGains, Cause, bool]:
    found = propose(region_model, region_model.log, gains, S)
    return found.tuning.gains, found.diagnosis.cause, found.ready


@pytest.mark.parametrize(("model", "most"), [(FIRST, 1.68), (SECOND, 1.68), (LAGGING, 1.75)])
def test_the_nominal_limit_is_kept_and_used(model: ProcessModel, most: float) -> None:
    gains, _, ready = of(known(model, 1e-3), PidGains(0.1, 0.001))
    assert ready
    assert ms(model, gains) <= most + 1e-9
    if model is LAGGING:
        assert ms(model, gains) > most - 0.05


@pytest.mark.parametrize(("factor", "cause"), [(1.08, Cause.OK), (1.2, Cause.AGGRESSIVE)])
def test_a_gain_is_too_large_where_ms_leaves_the_proposals_own_limit(factor: float, cause: Cause) -> None:
    best = simc(FIRST.seen_by_controller(S.sample_time_s)).gains
    gains = PidGains(factor * best.kp, factor * best.ki)
    assert 1.65 < ms(FIRST, gains) < S.cause.ms_high
    assert of(known(FIRST, 1e-3), gains)[1] == cause


def test_with_a_smaller_setpoint_weight_the_integral_time_is_shorter_and_no_less_robust() -> None:
    long = replace(FIRST, tau1_s=32.0)
    proposals = [
        propose(known(long, 1e-3), known(long).log, PidGains(1.0, 0.03), replace(S, setpoint_weight=b)).tuning.gains
        for b in (1.0, 0.99, 0.3)
    ]
    rule, hardly, light = proposals
    assert rule.kp / rule.ki == pytest.approx(32.0)
    assert ms(long, light) <= 1.68
    assert light.kp / light.ki < 0.7 * 32.0
    for gains, b, better in ((hardly, 0.99, 1.0), (light, 0.3, 1.15)):
        loops = [ClosedLoop(long.seen_by_controller(S.sample_time_s).linear(), one, b) for one in (rule, gains)]
        before, after = ([one.iae for one in row] for row in shapes(loops, UPSETS))
        assert sum(x / y for x, y in zip(before, after, strict=True)) / 2 >= better


def test_a_shorter_integral_time_must_be_robust_on_every_process_that_is_allowed() -> None:
    light, taken = replace(S, setpoint_weight=0.3), dict[float, float]()
    for std in (1e-3, 0.12):
        known_now = known(FIRST, std)
        gains = propose(known_now, known_now.log, PidGains(1.0, 0.03), light).tuning.gains
        assert max(ms(one.model, gains) for one in believed(known_now.plausible, 4.0)) <= S.robust.ms_worst
        taken[std] = gains.ki
    assert taken[0.12] < taken[1e-3]


def test_what_is_less_known_gets_a_slower_proposal() -> None:
    sure, _, _ = of(known(FIRST, 0.02), PidGains(0.1, 0.001))
    unsure, _, _ = of(known(FIRST, 0.25), PidGains(0.1, 0.001))
    assert unsure.kp < 0.95 * sure.kp
    assert sure.kp == pytest.approx(simc(FIRST.seen_by_controller(S.sample_time_s)).gains.kp, rel=0.02)


def test_too_little_known_gives_nothing_unless_the_loop_is_in_danger_on_every_allowed_model() -> None:
    best = simc(FIRST).gains
    vague = known(FIRST, 0.15, identifiable=False)
    times = [(0.3, Cause.SLUGGISH, False), (1.35, Cause.AGGRESSIVE, False), (4.0, Cause.AGGRESSIVE, True)]
    for factor, cause, ready in times:
        assert of(vague, PidGains(best.kp * factor, best.ki * factor))[1:] == (cause, ready)
    assert of(replace(vague, identifiable=True), PidGains(best.kp * 0.3, best.ki * 0.3))[2]


def test_too_little_known_never_gives_more_gain_whatever_the_danger() -> None:
    level = ProcessModel(ProcessType.INTEGRATING, 0.6, 0.0, 0.0, 0.4)
    swinging = PidGains(0.3, 0.1)  # k' Kc tau_I = 0.5: the cure is more gain
    gains, cause, ready = of(known(level, 0.05), swinging)
    assert (cause, ready) == (Cause.SLOW_INTEGRATING, True)
    assert gains.kp > swinging.kp
    less, cause, ready = of(known(level, 0.05, identifiable=False), swinging)
    assert (cause, ready) == (Cause.SLOW_INTEGRATING, True)
    assert less.kp == swinging.kp
    assert less.ki == pytest.approx(swinging.kp * gains.ki / gains.kp)


@pytest.mark.parametrize("cause", [Cause.AGGRESSIVE, Cause.SLOW_INTEGRATING])
@given(st.lists(st.floats(0.01, 100.0), min_size=6, max_size=6), st.sampled_from([1, -1]))
def test_no_more_action_is_less_of_everything(cause: Cause, sizes: list[float], sign: int) -> None:
    wanted, in_force = (PidGains(*(sign * x for x in part)) for part in (sizes[:3], sizes[3:]))
    assert less_of_everything(in_force, no_more_action(wanted, in_force, cause))


def test_where_the_fit_stopped_at_its_least_damping_a_process_that_swings_longer_is_safe() -> None:
    found = ProcessModel(ProcessType.SOPDT, 7.3, 84.0, 84.0, 10.8, 0.148)
    truth = replace(found, zeta=0.11)
    given = robust_simc_on(found, (), 1.0, RobustSettings()).tuning.gains
    assert sensitivity_peak(truth.seen_by_controller(1.0).linear(), given) < 1.7
    known = robust_simc_on(replace(found, zeta=0.4), (), 1.0, RobustSettings()).tuning.gains
    assert known.ki > 2 * given.ki


@given(zeta=st.floats(0.1, 0.84).filter(lambda zeta: abs(zeta - 0.15) > 0.02), dead=st.floats(0.1, 3.0))
@settings(max_examples=15)
def test_a_process_that_swings_by_itself_gets_settings_that_are_robust_and_not_slow(zeta: float, dead: float) -> None:
    """1/ki, the IAE of a load, against that of pure integral action at the same Ms: at most a tenth more."""
    model = ProcessModel(ProcessType.SOPDT, 2.0, 30.0, 30.0, dead * 30.0, zeta)
    found = robust_simc_on(model, (), 1.0, RobustSettings())
    assert 1.4 < found.ms_nominal <= 1.69
    seen = model.seen_by_controller(1.0).linear()
    pure = next(ki for ki in np.geomspace(1.0, 1e-5, 200) if sensitivity_peak(seen, PidGains(0.0, float(ki))) <= 1.6)
    assert found.tuning.gains.ki > 0.9 * pure


def test_a_dead_time_too_short_to_be_seen_bounds_more_action_and_says_nothing_against_gains_in_force() -> None:
    quick = replace(FIRST, theta_s=0.01)
    late = replace(quick, theta_s=S.sample_time_s)
    log = LogModel(parameters_of(quick), 1e-6 * np.eye(3), 1)
    asked = (StructureModel(log, 0.0),), 2, 0.0, None, ()
    bound = RegionModel(*asked, (Plausible(late, 0.0), Plausible(quick, 0.0)), bound_s=S.sample_time_s)
    best = simc(quick.seen_by_controller(S.sample_time_s)).gains
    assert ms(quick, best) < 1.7
    assert np.isinf(ms(late, best))
    gains, cause, _ = of(bound, best)
    assert cause is Cause.OK
    assert ms(late, gains) <= S.guard.ms_nominal + 1e-9
    assert of(replace(bound, plausible=bound.plausible[:1]), best)[1] is Cause.AGGRESSIVE
    assert predicted(bound, 100.0, S.tracker).model().theta_s == pytest.approx(late.theta_s)
    assert bound.known[0].log is log


TWO_LAGS = ProcessModel(ProcessType.SOPDT, 1.0, 100.0, 40.0, 8.0)
ONE_LAG = ProcessModel(ProcessType.FOPDT, 1.0, 120.0, 0.0, 28.0)  # What a first-order fit sees of the first
PID_LOOP, PI_LOOP = PidGains(3.0, 0.03, 60.0), PidGains(3.0, 0.03)


def test_a_loop_with_derivative_action_gets_simcs_pid_where_the_second_lag_is_known() -> None:
    gains, cause, _ = of(known(TWO_LAGS, 1e-3), PID_LOOP)
    best = simc(TWO_LAGS.seen_by_controller(S.sample_time_s), kind=ControllerKind.PID).gains
    assert (gains.kp, gains.ki, gains.kd) == pytest.approx((best.kp, best.ki, best.kd), rel=0.02)
    assert ms(TWO_LAGS, gains) < 1.68
    assert cause is Cause.SLUGGISH
    assert of(known(TWO_LAGS, 1e-3), PI_LOOP)[0].kd == 0.0  # nobody asked for a derivative


@pytest.mark.parametrize("filter_s", [np.nan, np.inf, -1.0])
def test_a_filter_of_no_time_is_refused(filter_s: float) -> None:
    with pytest.raises(ValueError, match="filter_s"):
        RetunerSettings(0.5, 100.0, filter_s=filter_s)


def test_a_filtered_derivative_gets_a_shorter_integral_time_and_no_larger_tau_c_alone() -> None:
    """With a larger tau_c alone the IAE is half as large again."""
    quick = replace(TWO_LAGS, theta_s=4.0)
    filtered, model = replace(S, filter_s=4.0), quick.seen_by_controller(S.sample_time_s)
    assert sensitivity_peak(model.linear(), simc(model, kind=ControllerKind.PID).gains, 4.0) > 1.8
    gains = propose(known(quick, 1e-3), known(quick, 1e-3).log, PID_LOOP, filtered).tuning.gains
    limits = RobustSettings(filtered.guard.ms_nominal, ms_worst=np.inf, ms_third=np.inf, tau_f_s=4.0)
    plain = robust_simc_on(quick, (), S.sample_time_s, limits, PID_LOOP).tuning.gains
    assert max(sensitivity_peak(model.linear(), one, 4.0) for one in (gains, plain)) <= limits.ms_nominal + 1e-9
    loops = [ClosedLoop(model.linear(), one, 1.0, 4.0) for one in (gains, plain)]
    after, before = ([one.iae for one in row] for row in shapes(loops, UPSETS))
    assert sum(x / y for x, y in zip(before, after, strict=True)) / 2 > 1.4
    assert 0.0 < gains.kd * gains.ki / gains.kp**2 <= 0.25 + 1e-9


def test_no_derivative_is_proposed_that_a_model_without_a_second_lag_does_not_bear() -> None:
    def proposed(excess: float) -> PidGains:
        allowed = [Plausible(TWO_LAGS, 0.0), Plausible(ONE_LAG, excess)]
        return robust_simc_on(TWO_LAGS, allowed, S.sample_time_s, RobustSettings(), PID_LOOP).tuning.gains

    assert ms(ONE_LAG, proposed(9.0)) > 1.8 > ms(ONE_LAG, proposed(1.0))
    assert proposed(9.0).kd > 0.0 == proposed(1.0).kd


def test_a_second_lag_shorter_than_the_dead_time_brings_next_to_nothing_by_derivative_action() -> None:
    plain = ProcessModel(ProcessType.SOPDT, 1.0, 100.0, 5.0, 30.0)
    found = [of(known(plain, 1e-3), gains)[0] for gains in (PID_LOOP, PI_LOOP)]
    assert found[0].ki == pytest.approx(found[1].ki, rel=0.15)


def test_half_of_a_third_lag_counts_as_dead_time_of_settings_with_derivative_action() -> None:
    """Beside it the dead time may be next to nothing, and three of these give no robust settings at all."""
    three = ProcessModel(ProcessType.TOPDT, 1.0, 20.0, 8.0, 0.2, tau3_s=4.0)
    found = robust_simc_on(three, (), S.sample_time_s, S.robust, PID_LOOP)
    assert found.tuning.gains.kd > 0.0
    assert found.ms_nominal <= 1.59


# What a swing shows counts: no loop that every model calls unstable stays so behind one sentence, or behind none


LAG_S, DEAD = 20.0, 5
PROCESS = LinearProcess(1.0, (LAG_S,), (), DEAD + 0.5)


def watched(gains: PidGains, samples: int, *, gap_every: int = 0) -> tuple[PidController, list[Decision]]:
    """A loop on a first-order lag with dead time, its output between limits, with loads; decisions in their order."""
    pid = PidController(gains, dt_s=1.0, pv_range=(0.0, 100.0), mode="auto")
    y, past, found = 40.0, [40.0] * DEAD, []
    keep = math.exp(-1.0 / LAG_S)
    for t in range(samples):
        noise = 0.05 * math.sin(t * 12.9898) * math.cos(t * 78.233)
        past.append(pid.step(45.0 if t > 100 else 40.0, y + noise, 20.0 if gap_every and t % gap_every == 0 else 1.0))
        y = keep * y + (1.0 - keep) * past.pop(0)
        found += [pid.decision] if pid.decision is not None else []
    return pid, found


@pytest.mark.slow
@pytest.mark.parametrize("gains", [PidGains(9.0, 0.9), PidGains(12.0, 0.2), PidGains(4.0, 1.6)])
def test_a_loop_that_every_model_calls_unstable_is_made_safer_by_the_second_record(gains: PidGains) -> None:
    assert math.isinf(sensitivity_peak(PROCESS, gains))
    pid, found = watched(gains, 1500)
    first = next(i for i, d in enumerate(found) if d.action is Action.WRITE)
    assert first <= 1
    assert sensitivity_peak(PROCESS, pid.gains) < 2.5
    assert not any("one load response is not enough" in d.reason for d in found[1:])


def test_gaps_between_which_nothing_is_complete_are_told_and_ever_more_seldom() -> None:
    _, found = watched(PidGains(1.8, 0.09), 2400, gap_every=30)
    told = [d for d in found if d.code == "broken_off"]
    assert told[0].reason.startswith("3 gaps of more than 8 sample times in a row")
    assert len(told) <= 2
    assert all(d.action is Action.NONE for d in told)
    _, quiet = watched(PidGains(1.8, 0.09), 2400)
    assert "broken_off" not in {d.code for d in quiet}


def test_the_count_of_responses_in_danger_is_kept_with_the_others() -> None:
    seen = Excitation(1, 2, 1, 0, 1, 2)
    assert seen.lost == 2
    assert seen.of_alternative().lost == 0
    with pytest.raises(ValueError, match="lost"):
        replace(seen, lost=-1)
