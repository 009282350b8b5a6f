"""A retuner that nothing waits for: the same decisions, later; and decisions of numpy's numbers."""

import numpy as np
import pytest

from retuner import BackgroundRetuner, GainTable, LoopSample, PidGains, Retuner, RetunerSettings
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.question import Question
from retuner.decisions import background
from retuner.decisions.decider import LOST, Answer, DecideHere, without_decision
from retuner.schedule.regions import Regions

N, STEP_AT = 700, 100


def made(number: type = float) -> Retuner:
    regions = Regions("sp", "m", ("tank",), number(0.0), (), number(10.0))
    table = GainTable("level", regions, (PidGains(number(12.0), number(0.3)),))
    return Retuner(table, RetunerSettings(number(1.0), number(10.0), Mode.AUTO))


def samples(number: type = float) -> list[LoopSample]:
    """A tank, k 0.1, lag 50 s, dead time 5 s, under a quarter of the right gain; one setpoint step."""
    rng, y, integral, past, found = np.random.default_rng(1), 0.0, 0.0, [0.0] * 5, []
    for i in range(N):
        sp = float(i >= STEP_AT)
        integral += 0.3 * (sp - y)
        co = 12.0 * (sp - y) + integral
        past.append(co)
        y += (0.1 * past.pop(0) - y) / 50
        pv = y + 0.001 * float(rng.standard_normal())
        found.append(LoopSample(number(i), number(sp), number(pv), number(co), x=number(sp)))
    return found


def heard(watcher: Retuner | BackgroundRetuner) -> list[Decision]:
    return [decision for sample in samples() if (decision := watcher.observe(sample)) is not None]


@pytest.mark.slow
def test_the_same_decisions_come_later() -> None:
    at_once, later = heard(made()), heard(BackgroundRetuner(made(), decider=DecideHere(20)))
    assert any(decision.action is Action.WRITE for decision in at_once)
    assert [d.reason for d in later] == [d.reason for d in at_once]
    assert [d.t_s for d in later] == [d.t_s + 20 for d in at_once]
    assert all(d.delay is not None for d in later)


def test_what_a_sample_would_wait_for_is_loaded_before_the_first_one(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    monkeypatch.setattr(background, "warm_up", lambda: done.append("warm"))
    with BackgroundRetuner(made()):
        assert done == ["warm"]
    BackgroundRetuner(made(), decider=DecideHere(20))
    assert done == ["warm"]


def test_nothing_is_decided_while_a_question_is_open() -> None:
    watcher = BackgroundRetuner(made(), decider=DecideHere(20))
    was_open = []
    for sample in samples():
        decision = watcher.observe(sample)
        was_open.append(watcher.deciding)
        assert decision is None or not watcher.deciding
    assert sum(was_open) >= 20


class Dead:
    """A worker that has died."""

    def ask(self, question: Question) -> None:
        """Nobody hears."""

    def answer(self, sample_number: int) -> Answer:
        return without_decision(LOST, f"the worker was killed at sample {sample_number}")


def test_a_worker_that_dies_costs_one_decision_and_is_told() -> None:
    watcher = BackgroundRetuner(made(), decider=Dead())
    found = heard(watcher)
    assert found
    assert {d.code for d in found} == {LOST}
    assert all(d.action is Action.NONE for d in found)
    assert "killed" in watcher.trouble


def test_its_own_worker_ends_with_it() -> None:
    with BackgroundRetuner(made()) as watcher:
        assert watcher.observe(samples()[0]) is None
        assert not watcher.deciding
    with pytest.raises(ValueError, match="deadline_s = 0"):
        BackgroundRetuner(made(), deadline_s=0)
