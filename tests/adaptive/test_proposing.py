"""What is proposed where no model can be had: by which rule, within which locks, and why nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.guard.request import KC_ONLY, NO_DERIVATIVE, NO_LOCKS, Locks
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.without_model.proposal_without_model import Proposed, WithoutModelSettings, step_without_model
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup

PERIOD, N, AT = 60.0, 600, 100


def proposed(
    s: float,
    gains: PidGains,
    *,
    cause: Cause | None = None,
    locks: Locks = NO_LOCKS,
    settings: WithoutModelSettings | None = None,
) -> Proposed:
    """After a load response whose peaks are -s times the one before."""
    t = np.arange(N, dtype=np.float64) - AT
    error = np.where(t < 0, 0.0, s ** (2 * t / PERIOD) * np.sin(2 * math.pi * t / PERIOD))
    window = Window(t + AT, np.zeros(N), -error, np.where(t < 0, 0.0, 1 - error))
    peaks = tuple(Peak(AT + PERIOD / 4 + i * PERIOD / 2, (-s) ** i * s**0.5) for i in range(3))
    response = Response(AT, N - 1.0, peaks, Ending.COMPLETE, False, 0.01)
    diagnosis = Diagnosis(cause, 0.9, {}, f"because of {cause}") if cause else None
    return step_without_model(response, window, gains, diagnosis, settings or WithoutModelSettings(), locks)


INTEGRATING = PidGains(1.0, 1.0 / (PERIOD * 0.3 * math.sqrt(1 - 0.09) / math.pi))
"""tau_I with which this period belongs to zeta = 0.3, where peaks decay by 0.372."""
LONG = PidGains(1.0, 1.0 / PERIOD)


def test_the_slow_oscillation_rule_has_its_range_and_the_pattern_the_rest() -> None:
    slow, pattern = proposed(0.372, INTEGRATING), proposed(0.372, LONG)
    assert (slow.basis, slow.code) == (Basis.SLOW_OSCILLATION, "applies")
    assert (pattern.basis, pattern.code) == (Basis.PATTERN, "lively")
    assert slow.tuning.gains.kp > INTEGRATING.kp
    assert pattern.tuning.gains.kp < LONG.kp
    assert "slow-oscillation" in slow.sentence
    assert "pattern" in pattern.sentence


def test_nothing_is_proposed_for_other_causes_near_the_targets_or_when_not_allowed() -> None:
    for found in (
        proposed(0.372, INTEGRATING, cause=Cause.STICTION),
        proposed(0.372, LONG, cause=Cause.EXTERNAL),
        proposed(0.15, LONG),
        proposed(0.372, LONG, settings=WithoutModelSettings(allowed=False)),
    ):
        assert found.tuning is None
        assert found.basis is None
        assert found.sentence


def test_locks_hold_and_a_proposal_of_nothing_but_the_locked_is_none() -> None:
    kc_only = proposed(0.372, INTEGRATING, locks=KC_ONLY).tuning
    assert kc_only.gains.kp / kc_only.gains.ki == pytest.approx(INTEGRATING.kp / INTEGRATING.ki)
    assert kc_only.gains.kp == pytest.approx(INTEGRATING.kp / 0.09, rel=0.02)
    nothing = proposed(0.372, LONG, locks=Locks(kc=True))
    assert nothing.tuning is None
    assert nothing.basis is None
    assert "locked" in nothing.sentence


GAINS = st.builds(PidGains, st.floats(0.01, 100), st.floats(0.001, 10), st.floats(0, 10))


@given(wanted=GAINS, in_force=GAINS, kc=st.booleans(), tau_i=st.booleans(), tau_d=st.booleans())
def test_locked_parameters_are_those_in_force_and_the_others_as_wanted(wanted, in_force, kc, tau_i, tau_d):
    kept = Locks(kc, tau_i, tau_d).keep(wanted, in_force)
    for lock, value in ((kc, lambda g: g.kp), (tau_i, lambda g: g.kp / g.ki), (tau_d, lambda g: g.kd / g.kp)):
        assert value(kept) == pytest.approx(value(in_force if lock else wanted))


def test_a_locked_derivative_stays_away_where_there_is_none() -> None:
    assert NO_DERIVATIVE.keep(PidGains(2.0, 0.1, 5.0), PidGains(1.0, 0.1)).kd == 0
    assert KC_ONLY.keep(PidGains(0.0, 0.1), PidGains(1.0, 0.1)) == PidGains(1.0, 0.1)


def test_a_locked_derivative_holds_nothing_else_of_a_controller_without_proportional_gain() -> None:
    assert NO_DERIVATIVE.keep(PidGains(0.0, 0.2), PidGains(0.0, 0.1)) == PidGains(0.0, 0.2)
    assert NO_DERIVATIVE.keep(PidGains(2.0, 0.2, 5.0), PidGains(0.0, 0.1)) == PidGains(2.0, 0.2)


# A retuner that can identify nothing: small steps by the pattern, watched by the guard, and none for other causes.


CALM = PidGains(1.25, 1.25 / 40)  # A quarter of the right gain: slow, and far from any limit
NOTHING_IDENTIFIABLE = FitSettings(gain_std_limit=1e-9)
SETTINGS = RetunerSettings(1.0, 10.0, Mode.AUTO, fit=NOTHING_IDENTIFIABLE)


def decided(
    gains: PidGains, settings: RetunerSettings, upsets: int = 4, sine: float = 0.0, length: int = 400,
    lookup: Lookup = Lookup.HARD,
) -> list[Decision]:  # fmt: skip
    """e^-5s/(50 s + 1) under PI, setpoint steps, noise of one percent; every commit is obeyed and confirmed."""
    table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (gains,), lookup)
    retuner, rng = Retuner(table, settings), np.random.default_rng(3)
    x = integral = 0.0
    past, decisions, a = [0.0] * 5, [], float(np.exp(-1 / 50.0))
    for i in range(60 + length * upsets):
        now = retuner.table.gains_of(0)
        sp = 0.0 if i < 60 else float((i - 60) // length % 2 == 0)
        pv = x + 0.01 * float(rng.standard_normal()) + sine * float(np.sin(i / 12))
        integral += now.ki * (sp - pv)
        co = now.kp * (sp - pv) + integral
        past.append(co)
        x = a * x + (1 - a) * past.pop(0)
        decision = retuner.observe(LoopSample(float(i), sp, pv, co))
        if decision is not None:
            decisions.append(decision)
            if decision.action is Action.WRITE and decision.gains_after is not None:
                integral += (now.kp - decision.gains_after.kp) * (sp - pv)
                retuner.committed(0, decision.gains_after)
    return decisions


@pytest.fixture(scope="module")
def calm() -> list[Decision]:
    return decided(CALM, SETTINGS)


@pytest.mark.slow
def test_a_calm_loop_is_made_faster_by_the_pattern_and_says_so(calm: list[Decision]) -> None:
    first = next(d for d in calm if d.action is Action.WRITE)
    assert first.basis is Basis.PATTERN
    assert first.code == "unproved_step"
    assert "pattern" in first.reason
    assert 1 < first.gains_after.kp / first.gains_before.kp <= 1.3
    assert first.numbers.to_dict()["margin"] > 0
    assert first.canonical()


def test_a_person_may_forbid_it() -> None:
    settings = replace(SETTINGS, without_model=WithoutModelSettings(allowed=False))
    decisions = decided(CALM, settings, upsets=2)
    assert decisions
    assert all(d.action is Action.NONE for d in decisions)
    assert {d.code for d in decisions} == {"not_identifiable"}
    assert all("are switched off" in d.reason for d in decisions)


def test_a_tone_from_outside_moves_nothing() -> None:
    decisions = decided(PidGains(3.0, 3.0 / 40), SETTINGS, upsets=1, sine=0.4, length=250)
    assert decisions
    assert all(d.action is Action.NONE for d in decisions)


@pytest.mark.slow
def test_a_pattern_gives_no_more_action_where_a_plausible_model_says_too_much() -> None:
    """Ms 1.55, 1.72, 1.97, back, and on again: what does not carry settings still says how far not to go. A table of
    interpolated gains has no book, which would object first.
    """
    decisions = decided(PidGains(4.5, 4.5 / 100), SETTINGS, lookup=Lookup.INTERPOLATED)
    process = LinearProcess(1.0, (50.0,), (), 5.5)
    after = [sensitivity_peak(process, d.gains_after) for d in decisions if d.gains_after is not None]
    assert after
    assert max(after) < 1.8
    assert any("not done: on a plausible model Ms would be" in d.reason for d in decisions)
