"""A retuner that can identify nothing: small steps by the pattern, watched by the guard, and none for other causes."""

from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.without_model.proposal_without_model import WithoutModelSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup

CALM = PidGains(1.25, 1.25 / 40)
"""A quarter of the right gain: slow, and far from any limit."""
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
