"""What is proposed where no model can be had: by which rule, within which locks, and why nothing."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.guard.request import KC_ONLY, NO_DERIVATIVE, NO_LOCKS, Locks
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.without_model.proposal_without_model import Proposed, WithoutModelSettings, step_without_model
from retuner.schedule.gains import PidGains

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
def test_locked_parameters_are_those_in_force_and_the_others_as_wanted(
    wanted: PidGains, in_force: PidGains, kc: bool, tau_i: bool, tau_d: bool
) -> None:
    kept = Locks(kc, tau_i, tau_d).keep(wanted, in_force)
    for lock, value in ((kc, lambda g: g.kp), (tau_i, lambda g: g.kp / g.ki), (tau_d, lambda g: g.kd / g.kp)):
        assert value(kept) == pytest.approx(value(in_force if lock else wanted))


def test_a_locked_derivative_stays_away_where_there_is_none() -> None:
    assert NO_DERIVATIVE.keep(PidGains(2.0, 0.1, 5.0), PidGains(1.0, 0.1)).kd == 0
    assert KC_ONLY.keep(PidGains(0.0, 0.1), PidGains(1.0, 0.1)) == PidGains(1.0, 0.1)


def test_a_locked_derivative_holds_nothing_else_of_a_controller_without_proportional_gain() -> None:
    assert NO_DERIVATIVE.keep(PidGains(0.0, 0.2), PidGains(0.0, 0.1)) == PidGains(0.0, 0.2)
    assert NO_DERIVATIVE.keep(PidGains(2.0, 0.2, 5.0), PidGains(0.0, 0.1)) == PidGains(2.0, 0.2)
