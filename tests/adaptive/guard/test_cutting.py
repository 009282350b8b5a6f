"""Locks, absolute limits, the commissioned set and the sampling time: one parameter is cut, and it is said."""

import math
from dataclasses import astuple, replace

import pytest
from guard_cases import GAINS, SAMPLED, SETTINGS, known, request, times
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.guard.checks import Check, limit_checks
from retuner.adaptive.guard.goal_within_limits import Goal, calmer, goals, without_short_derivative
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.proof import STEPS, prove, slower_settings
from retuner.adaptive.guard.request import KC_ONLY, NO_DERIVATIVE, NO_LOCKS, ChangeRequest, Locks
from retuner.adaptive.guard.ruling import Ruling
from retuner.adaptive.guard.step_size import extent, less_of_everything
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import ControllerKind, Tuning
from retuner.adaptive.rules.simc import simc
from retuner.schedule.gains import IdealGains, PidGains
from retuner.schedule.vendor_units import Quantity, StorableNumbers, VendorGain, VendorUnits

OLD = IdealGains(1.0, 20.0).to_parallel()


def cut(
    wanted: PidGains,
    limits: GuardSettings = SETTINGS,
    old: PidGains = OLD,
    over: bool = False,
    locks: Locks = NO_LOCKS,
    commissioned: PidGains | None = None,
) -> list[Goal]:
    asked = replace(request(old, commissioned=commissioned), locks=locks)
    return goals(wanted, 5.0, asked, limits, over_limit=over)


def times_of(gains: PidGains) -> tuple[float, float, float]:
    return gains.kp, gains.kp / gains.ki, gains.kd / gains.kp


@given(kp=st.floats(0.01, 100.0), tau_i=st.floats(1.0, 1000.0), sign=st.sampled_from([1.0, -1.0]))
def test_calmer_settings_are_less_of_something_the_smallest_step_first(kp: float, tau_i: float, sign: float) -> None:
    """Where the rule gives nothing, a loop over its limit is offered less action, never more, in growing steps."""
    old = PidGains(sign * kp, sign * kp / tau_i)
    found = [goal.gains for goal in calmer(request(old), Goal(old, old, 5.0))]
    steps = [round(extent(old, gains), 9) for gains in found]
    assert len(found) == 10
    assert all(less_of_everything(old, gains) and gains != old for gains in found)
    assert steps == sorted(steps)
    assert steps[-1] == pytest.approx(math.log(4.0))


@pytest.mark.parametrize(
    ("wanted", "limits", "result", "note"),
    [
        ((9.0, 20.0, 0.0), GuardSettings(kc_max=3.0), (3.0, 20.0, 0.0), "Kc held at 3 (wanted 9): kc_max"),
        ((0.4, 20.0, 0.0), GuardSettings(kc_min=0.5), (0.5, 20.0, 0.0), "Kc held at 0.5 (wanted 0.4): kc_min"),
        (
            (9.0, 20.0, 0.0),
            SETTINGS,
            (4.0, 20.0, 0.0),
            "Kc held at 4 (wanted 9): at most 4x baseline. Raise total_ratio_max or accept the new baseline.",
        ),
        (
            (0.1, 20.0, 0.0),
            SETTINGS,
            (0.25, 20.0, 0.0),
            "Kc held at 0.25 (wanted 0.1): at most 4x baseline. Raise total_ratio_max or accept the new baseline.",
        ),
        (
            (1.0, 100.0, 0.0),
            SETTINGS,
            (1.0, 80.0, 0.0),
            "tau_I held at 80 (wanted 100): at most 4x baseline. Raise total_ratio_max or accept the new baseline.",
        ),
        (
            (1.0, 3.0, 0.0),
            SETTINGS,
            (1.0, 5.0, 0.0),
            "tau_I held at 5 (wanted 3): at most 4x baseline. Raise total_ratio_max or accept the new baseline.",
        ),
        ((1.0, 8.0, 0.0), GuardSettings(tau_i_min_s=9.0), (1.0, 9.0, 0.0), "tau_I held at 9 (wanted 8): tau_i_min"),
        (
            (1.0, 40.0, 0.0),
            GuardSettings(tau_i_max_s=30.0),
            (1.0, 30.0, 0.0),
            "tau_I held at 30 (wanted 40): tau_i_max",
        ),
        ((1.0, 20.0, 6.0), GuardSettings(tau_d_max_s=4.0), (1.0, 20.0, 4.0), "tau_D held at 4 (wanted 6): tau_d_max"),
        ((1.0, 20.0, 0.5), SETTINGS, (1.0, 20.0, 0.0), "tau_D held at 0 (wanted 0.5): limit of the sampling time"),
    ],
)
def test_only_what_exceeds_is_cut_and_it_is_said(wanted, limits, result, note):
    goal = cut(IdealGains(*wanted).to_parallel(), limits)[0]
    assert times_of(goal.gains) == pytest.approx(result)
    assert goal.notes == (note,)
    assert not goal.no_room
    assert goal.wanted == IdealGains(*wanted).to_parallel()


def test_a_cut_tau_i_leaves_two_ways_and_the_proof_decides() -> None:
    held, moved = cut(IdealGains(1.0, 100.0).to_parallel())
    assert times_of(held.gains) == pytest.approx((1.0, 80.0, 0.0))
    assert times_of(moved.gains) == pytest.approx((0.8, 80.0, 0.0))
    assert moved.notes[0] == "Kc moved with tau_I"
    (only,) = cut(IdealGains(1.0, 100.0).to_parallel(), locks=Locks(kc=True))
    assert times_of(only.gains) == pytest.approx((1.0, 80.0, 0.0))


def test_below_the_sampling_time_the_integral_action_is_kept_first() -> None:
    old, whole = IdealGains(0.1, 1.0).to_parallel(), GuardSettings(tau_i_samples=1.0)
    first, second = cut(IdealGains(0.12, 0.5).to_parallel(), whole, old=old)
    assert times_of(first.gains) == pytest.approx((0.24, 1.0, 0.0))
    assert first.gains.ki == pytest.approx(0.24)
    assert times_of(second.gains) == pytest.approx((0.12, 1.0, 0.0))
    assert first.cut_by is None
    short = IdealGains(0.1, 0.3).to_parallel()
    kept, longer = (cut(IdealGains(0.12, tau_i).to_parallel(), whole, old=short)[0] for tau_i in (0.5, 0.2))
    assert times_of(kept.gains) == pytest.approx((0.12, 0.5, 0.0))
    assert times_of(longer.gains) == pytest.approx((0.18, 0.3, 0.0))


def test_an_almost_pure_dead_time_keeps_its_integral_where_kc_is_cut() -> None:
    """Kc says little there: cut alone it once left IAE at 1.7 times what tau_I, shortened with it, gives."""
    old, wanted = IdealGains(0.02, 2.0).to_parallel(), IdealGains(0.2, 2.0).to_parallel()
    delay = ProcessModel(ProcessType.FOPDT, 1.0, 2.0, 0.0, 10.0)
    asked = replace(request(old), models=(Plausible(delay, 0.0),))
    first, second = goals(wanted, 10.0, asked, SETTINGS, over_limit=False)
    assert times_of(first.gains) == pytest.approx((0.08, 0.8, 0.0))
    assert first.gains.ki == pytest.approx(wanted.ki)
    assert times_of(second.gains) == pytest.approx((0.08, 2.0, 0.0))
    lagging = replace(delay, tau1_s=20.0)
    asked = replace(asked, models=(Plausible(lagging, 0.0),))
    assert goals(wanted, 10.0, asked, SETTINGS, over_limit=False)[0].gains == second.gains


def test_the_commissioned_set_does_not_hold_up_a_loop_over_its_limit() -> None:
    less = IdealGains(0.1, 100.0).to_parallel()
    assert times_of(cut(less, over=True)[0].gains) == pytest.approx((0.1, 100.0, 0.0))
    more = IdealGains(9.0, 3.0, 9.0).to_parallel()
    held = cut(more, over=True, old=IdealGains(1.0, 20.0, 2.0).to_parallel())[0]
    assert times_of(held.gains) == pytest.approx((4.0, 5.0, 8.0))


def test_what_is_beyond_the_commissioned_set_may_stay_but_go_no_farther() -> None:
    start = IdealGains(0.1, 20.0, 2.0).to_parallel()
    old = IdealGains(1.0, 200.0, 20.0).to_parallel()
    (more,) = cut(IdealGains(2.0, 300.0, 30.0).to_parallel(), old=old, commissioned=start)[:1]
    assert times_of(more.gains) == pytest.approx((1.0, 200.0, 20.0))
    assert (more.no_room, more.cut_by) == (False, Ruling.OUTSIDE_TOTAL)
    (less,) = cut(IdealGains(0.7, 150.0, 10.0).to_parallel(), old=old, commissioned=start)
    assert times_of(less.gains) == pytest.approx((0.7, 150.0, 10.0))
    (up,) = cut(
        IdealGains(0.02, 150.0, 10.0).to_parallel(), old=IdealGains(0.01, 150.0, 10.0).to_parallel(), commissioned=start
    )
    assert up.gains.kp == pytest.approx(0.02)


def test_a_cut_that_turns_the_integral_action_back_leaves_no_room() -> None:
    """More was wanted of kc and of kc/tau_I; what kc_max leaves of kc makes kc/tau_I less than it is."""
    old, wanted = IdealGains(1.0, 20.0).to_parallel(), IdealGains(3.0, 40.0).to_parallel()
    limits = GuardSettings(kc_max=1.2)
    goal, other = cut(wanted, limits, old)
    assert (goal.no_room, goal.cut_by) == (True, Ruling.OUTSIDE_LIMITS)
    assert (other.no_room, times_of(other.gains)) == (False, pytest.approx((1.2, 16.0, 0.0)))
    assert other.gains.ki == pytest.approx(wanted.ki)
    assert other.notes[0] == "tau_I moved with Kc"
    (locked,) = cut(wanted, limits, old, locks=Locks(tau_i=True))
    assert locked.gains.ki == pytest.approx(1.2 / 20)
    assert not cut(wanted, limits, old, over=True)[0].no_room
    assert not cut(wanted, GuardSettings(kc_max=2.5), old)[0].no_room


def test_a_derivative_is_turned_back_in_time_not_in_gain() -> None:
    old = IdealGains(4.0, 80.0, 3.0).to_parallel()
    (less,) = cut(IdealGains(4.0, 80.0, 2.8).to_parallel(), GuardSettings(tau_d_max_s=2.0), old)
    assert not less.no_room
    assert times_of(less.gains)[2] == pytest.approx(2.0)
    (more,) = cut(IdealGains(4.0, 80.0, 3.5).to_parallel(), GuardSettings(tau_d_max_s=2.0), old)
    assert more.no_room


@pytest.mark.parametrize("locks", [Locks(a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)])
def test_locked_parameters_stay_as_they_are(locks: Locks) -> None:
    old = IdealGains(-1.0, 20.0, 2.0).to_parallel()
    goal = cut(IdealGains(-1.5, 30.0, 3.0).to_parallel(), old=old, locks=locks)[0]
    expected = (-1.0 if locks.kc else -1.5, 20.0 if locks.tau_i else 30.0, 2.0 if locks.tau_d else 3.0)
    assert times_of(goal.gains) == pytest.approx(expected)


def test_no_derivative_means_none_where_there_is_none() -> None:
    assert cut(IdealGains(1.5, 30.0, 3.0).to_parallel(), locks=NO_DERIVATIVE)[0].gains.kd == 0.0
    assert Locks(tau_i=True, tau_d=True) == KC_ONLY


def test_an_integral_controller_has_no_times_to_hold_or_cut() -> None:
    integral = PidGains(0.0, 0.1)
    assert cut(PidGains(0.0, 5.0), old=integral)[0].gains == PidGains(0.0, 5.0)
    assert cut(PidGains(0.0, 5.0), old=integral, locks=Locks(tau_i=True))[0].gains == integral
    assert cut(PidGains(1.0, 0.05, 3.0), old=integral, locks=NO_DERIVATIVE)[0].gains == PidGains(1.0, 0.05)
    proportional = PidGains(1.0, 0.0)
    assert cut(PidGains(2.0, 0.0), old=proportional)[0].gains == PidGains(2.0, 0.0)


def test_a_cut_change_is_written_and_says_so() -> None:
    limits = GuardSettings(kc_max=0.9 * GAINS.kp)
    verdict = prove(request(times(0.6, 0.6)), limits)
    assert verdict.accepted
    assert verdict.gains.kp == pytest.approx(0.9 * GAINS.kp)
    assert ": kc_max" in verdict.sentence
    assert verdict.step < 1.0


GAIN = st.floats(0.01, 100)
TIME = st.floats(0.1, 1000)


@given(
    kc=GAIN,
    tau_i=TIME,
    tau_d=st.floats(0, 50),
    kc0=GAIN,
    tau_i0=TIME,
    over=st.booleans(),
    kc_max=st.sampled_from([0.5, 5.0, math.inf]),
    tau_i_max=st.sampled_from([30.0, math.inf]),
)
def test_every_goal_is_inside_whatever_is_asked(kc, tau_i, tau_d, kc0, tau_i0, over, kc_max, tau_i_max):
    start = IdealGains(kc0, tau_i0).to_parallel()
    limits = GuardSettings(kc_max=kc_max, tau_i_max_s=tau_i_max)
    for goal in cut(IdealGains(kc, tau_i, tau_d).to_parallel(), limits, start, over):
        new_kc, new_tau_i, new_tau_d = times_of(goal.gains)
        assert new_kc <= kc_max * (1 + 1e-9)
        assert min(limits.tau_i_samples, tau_i0) * (1 - 1e-9) <= new_tau_i <= tau_i_max * (1 + 1e-9)
        assert new_tau_d == 0.0 or new_tau_d >= 1.0 * (1 - 1e-9)
        assert new_kc <= 4 * kc0 * (1 + 1e-9)
        assert new_tau_i >= min(tau_i0 / 4, tau_i_max) * (1 - 1e-9)
        assert over or new_kc >= min(kc0 / 4, kc_max) * (1 - 1e-9)


def test_a_request_is_checked_at_the_door() -> None:
    proposal = Tuning("simc", "series", GAINS, 5.0)
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="sample_time_s"):
            ChangeRequest(GAINS, GAINS, proposal, known(), wrong)
        if wrong != 0.0:
            with pytest.raises(ValueError, match="filter_s"):
                ChangeRequest(GAINS, GAINS, proposal, known(), 1.0, filter_s=wrong)
    with pytest.raises(ValueError, match="first the least"):
        ChangeRequest(GAINS, GAINS, proposal, tuple(reversed(known())), 1.0)
    with pytest.raises(ValueError, match="finite"):
        ChangeRequest(GAINS, GAINS, proposal, (replace(known()[0], excess=math.nan),), 1.0)


def test_where_hardly_more_than_the_integral_counts_a_cut_of_both_keeps_it() -> None:
    """A process that swings: kc and tau_I both cut at four times the baseline gains would leave ki as it was."""
    rings = ProcessModel(ProcessType.SOPDT, 0.0965, 28.8, 28.8, 7.4, 0.2)
    old, wanted = IdealGains(0.09, 2.6).to_parallel(), IdealGains(0.75, 15.0).to_parallel()
    asked = request(old, models=(Plausible(rings, 0.0),))
    first, *others = goals(wanted, 5.0, asked, SETTINGS, over_limit=False)
    assert first.gains.kp == pytest.approx(4 * old.kp)
    assert first.gains.ki == pytest.approx(wanted.ki)
    assert all(goal.gains.ki < 1.05 * old.ki for goal in others)
    lagging = replace(asked, models=(Plausible(ProcessModel(ProcessType.FOPDT, 0.1, 60.0, 0.0, 7.4), 0.0),))
    assert all(goal.gains.ki < 1.05 * old.ki for goal in goals(wanted, 5.0, lagging, SETTINGS, over_limit=False))


@pytest.mark.parametrize(("kd", "kept"), [(0.5, 0.25), (0.1, 0.1), (0.0, 0.0)])
def test_a_step_on_the_way_keeps_a_derivative_that_a_series_form_has(kd: float, kept: float) -> None:
    """kc at its limit leaves tau_I to shorten alone; a panel in series form could not take the gains."""
    old = PidGains(1.0, 0.5, kd)
    asked = ChangeRequest(old, old, Tuning("simc", "series", old), (), 0.01)
    found = without_short_derivative(PidGains(1.0, 1.0, kd), asked, GuardSettings())
    assert found == PidGains(1.0, 1.0, kept)
    longer = PidGains(1.0, 0.5, 0.8)  # no series form had it before
    asked = ChangeRequest(longer, longer, Tuning("simc", "series", longer), (), 0.01)
    assert without_short_derivative(PidGains(1.0, 1.0, 0.8), asked, GuardSettings()).kd == pytest.approx(0.4)


# Limits in absolute numbers: each is checked where somebody has set it, and only there.


PID = IdealGains(GAINS.kp, GAINS.kp / GAINS.ki, 4.0).to_parallel()


def checks(gains: PidGains, settings: GuardSettings, in_force: PidGains = GAINS) -> dict[str, Check]:
    return {check.name: check for check in limit_checks(request(in_force), gains, settings)}


@pytest.mark.parametrize(
    ("name", "limits", "key"),
    [
        ("kc_min", {"kc_min": 0.01}, 0.01),
        ("kc_max", {"kc_max": 99.0}, 99.0),
        ("tau_i_max", {"tau_i_max_s": 300.0}, 300.0),
        ("tau_d_max", {"tau_d_max_s": 30.0}, 30.0),
    ],
)
def test_a_limit_is_checked_where_it_is_set(name: str, limits: dict[str, float], key: float) -> None:
    assert name not in checks(PID, GuardSettings(), PID)
    assert checks(PID, GuardSettings(**limits), PID)[name].limit == key


def test_a_derivative_may_fall_to_nothing_without_leaving_the_commissioned_range() -> None:
    small = IdealGains(GAINS.kp, GAINS.kp / GAINS.ki, 0.5).to_parallel()
    settings = replace(GuardSettings(), tau_d_max_s=math.inf)
    total = checks(small, settings, PID)["total_tau_d"]
    assert total.value == pytest.approx(8.0)
    assert total.limit == settings.total_ratio_max
    up = checks(PID, settings, small)["total_tau_d"]  # no shortest derivative time gives more room upwards
    assert (up.limit, up.value) == (settings.total_ratio_max, pytest.approx(8.0))


# What the guard lets through is what the controller will hold: rounded, and proved as it is rounded.


def units(step: float, high: float = 255.0) -> VendorUnits:
    """Whole numbers: kp in this step, Tn in seconds."""
    return VendorUnits(
        (
            VendorGain(Quantity.KP, step, StorableNumbers(1.0, high, 1.0)),
            VendorGain(Quantity.TN, 1.0, StorableNumbers(0.0, 10000.0, 1.0), message=1, off=0.0),
        )
    )


@pytest.mark.parametrize("step", [0.3, 0.1, 0.037, 0.001])
@pytest.mark.parametrize("factor", [0.3, 0.6, 1.9])
def test_accepted_gains_are_those_that_are_held(step: float, factor: float) -> None:
    held = units(step, 100_000.0)
    in_force = held.rounded(times(factor, factor))
    verdict = prove(replace(request(in_force), units=held), SETTINGS)
    if verdict.gains is not None:
        assert held.rounded(verdict.gains) == verdict.gains
        assert all(check.passed for check in verdict.checks)
        assert verdict.ms_worst <= SETTINGS.ms_worst
    if step <= 0.037:
        assert verdict.accepted


def test_what_cannot_be_held_is_refused() -> None:
    held = units(0.1, high=round(0.4 * GAINS.kp / 0.1))  # more gain than is in force cannot be held
    in_force = held.rounded(times(0.4, 0.4))
    assert prove(request(in_force), SETTINGS).accepted
    assert not prove(replace(request(in_force), units=held), SETTINGS).accepted


# The first remedy: the rule's own settings at larger tau_c, as the same kind of controller.


def test_equal_ratios_up_to_the_largest_tau_c() -> None:
    found = slower_settings(request(GAINS), SETTINGS)
    assert [t.tau_c_s for t in found] == pytest.approx([5.5 * 1.3 ** (i / STEPS) for i in (1, 2, 3)])
    assert all(astuple(t.gains) == pytest.approx(astuple(simc(SAMPLED, t.tau_c_s).gains)) for t in found)
    halfway = simc(SAMPLED, 5.5 * 1.2)
    rest = slower_settings(request(GAINS, halfway), SETTINGS)
    assert rest[-1].tau_c_s == pytest.approx(5.5 * 1.3)
    assert slower_settings(request(GAINS, simc(SAMPLED, 5.5 * 1.4)), SETTINGS) == ()


def test_a_pid_proposal_is_slowed_as_pid_with_its_own_dead_time() -> None:
    model = ProcessModel(ProcessType.SOPDT, 2.0, 50.0, 20.0, 5.0)
    later = replace(model, theta_s=5.5)
    wanted = simc(later, None, ControllerKind.PID)
    found = slower_settings(request(GAINS, wanted, known(0.02, model)), SETTINGS)
    assert found[-1].tau_c_s == pytest.approx(5.5 * 1.3)
    slowest = simc(later, 5.5 * 1.3, ControllerKind.PID).gains
    assert astuple(found[-1].gains) == pytest.approx(astuple(slowest))
    assert found[-1].gains.kd != 0.0
    plain = slower_settings(request(GAINS, simc(later), known(0.02, model)), SETTINGS)
    assert plain[-1].tau_c_s == pytest.approx((5.5 + 10.0) * 1.3)
    assert all(t.gains.kd == 0.0 for t in plain)


def test_a_third_lag_is_dead_time_of_a_slower_pid_proposal_by_the_half_rule() -> None:
    model = ProcessModel(ProcessType.TOPDT, 2.0, 50.0, 20.0, 5.0, tau3_s=8.0)
    wanted = simc(replace(model, theta_s=5.5), None, ControllerKind.PID)
    assert wanted.tau_c_s == pytest.approx(5.5 + 8.0 / 2)
    found = slower_settings(request(GAINS, wanted, known(0.02, model)), SETTINGS)
    assert found[-1].tau_c_s == pytest.approx(1.3 * wanted.tau_c_s)


def test_what_a_rule_brings_is_proved_like_any_other() -> None:
    hot = Tuning("amigo", "parallel", times(2.0, 2.0), 3.0)
    calm = Tuning("amigo", "parallel", times(0.9, 0.9), 9.0)
    verdict = prove(replace(request(times(0.6, 0.6), hot), slower=(calm,)), SETTINGS)
    assert verdict.gains == calm.gains
    assert verdict.tau_c_s == 9.0
    assert prove(request(times(0.6, 0.6), hot), GuardSettings(tau_c_max_ratio=3.0)).tau_c_s == 3.0
