"""A decision that is made elsewhere and entered samples later: the question travels, the loop goes on, an answer that
comes too late changes nothing.
"""

import json
import pickle
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import pytest
from loop_bench import Bench, made, scaled

from retuner import GainTable, LoopMode, LoopSample, Retuner, remember, restore
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.decision import Action, Decision, Delay, Mode, Outcome
from retuner.adaptive.supervision.question import Question

LATER = 7  # Samples between question and answer


class Asked(NamedTuple):
    """A question with its answer, and the samples that come next."""

    question: Question
    result: Outcome
    samples: Iterator[LoopSample]


def travelled(value: object) -> object:
    """As another process would have it."""
    return pickle.loads(pickle.dumps(value))


def asked(bench: Bench, sp: float = 1.0) -> Asked:
    """The first question after a setpoint step from rest, answered elsewhere."""
    assert [d for d in map(bench.retuner.observe, bench.samples(400, 0.0, 0.0, 10.0)) if d] == []
    samples = bench.samples(900, sp, 0.0, 10.0)
    for sample in samples:
        step = bench.retuner.step(sample)
        assert step.decision is None
        if step.question is not None:
            sent = travelled(step.question)
            assert isinstance(sent, Question)
            back = travelled(decide(sent))
            assert isinstance(back, Outcome)
            return Asked(step.question, back, samples)
    raise AssertionError("nothing was asked")


def go_on(bench: Bench, samples: Iterator[LoopSample], count: int = LATER) -> None:
    """Samples while the question is open."""
    for _ in range(count):
        assert bench.retuner.step(next(samples)) == (None, None)


def entered(bench: Bench, found: Asked) -> Decision:
    return bench.retuner.enter(found.question, found.result, bench.retuner.sample_number)


@pytest.fixture(scope="module")
def at_once() -> Decision:
    """What `observe` decides after the same step."""
    bench = made(scaled(2.4, 2.4))
    bench.run(400)
    return bench.run(900, 1.0)[0]


@pytest.fixture
def found(bench: Bench) -> Asked:
    return asked(bench)


@pytest.fixture
def bench() -> Bench:
    return made(scaled(2.4, 2.4))


def test_an_answer_that_travelled_decides_as_observe_does(found: Asked, bench: Bench, at_once: Decision) -> None:
    assert entered(bench, found).canonical() == at_once.canonical()
    assert "delay" not in at_once.to_dict()
    assert at_once.action is Action.WRITE


def test_an_answer_entered_later_is_the_same_but_for_its_time_and_says_when(found, bench, at_once):
    go_on(bench, found.samples)
    number = bench.retuner.sample_number
    late = entered(bench, found)
    assert late.delay == Delay(number - LATER, number) == (found.question.sample_number, number)
    assert late.to_dict()["delay"] == {"raised": number - LATER, "entered": number}
    assert late.t_s == at_once.t_s + LATER
    assert replace(late, t_s=at_once.t_s, delay=None, known=at_once.known).canonical() == at_once.canonical()
    assert bench.retuner.open_question is None


def run_later(bench: Bench, later: int) -> list[Decision]:
    """A session that enters each answer so many samples later, or not at all when it ends before."""
    decisions: list[Decision] = []
    due: tuple[int, Question] | None = None
    for sp, load in ((0.0, 0.0), (1.0, 0.0), (1.0, 0.5), (0.0, 0.0)):
        for sample in bench.samples(500, sp, load, 10.0):
            step = bench.retuner.step(sample)
            found = [step.decision] if step.decision else []
            if step.question is not None:
                due = (bench.retuner.sample_number + later, step.question)
            if due is not None and bench.retuner.sample_number == due[0]:
                found.append(bench.retuner.enter(due[1], decide(due[1]), due[0]))
                due = None
            for decision in found:
                decisions.append(decision)
                bench.obey(decision)
    return decisions


@pytest.mark.slow
@pytest.mark.uncounted
def test_no_delay_is_observe(bench: Bench) -> None:
    at_once = [d for sp, load in ((0, 0), (1, 0), (1, 0.5), (0, 0)) for d in bench.run(500, sp, load)]
    assert [d.canonical() for d in run_later(made(scaled(2.4, 2.4)), 0)] == [d.canonical() for d in at_once]


def refused(bench: Bench, found: Asked) -> str:
    """The code of a refused answer, which leaves everything as it was."""
    before = remember(bench.retuner)
    decision = entered(bench, found)
    assert decision.action is Action.NONE
    assert decision.gains_after is decision.estimate is decision.proof is decision.prediction is None
    assert decision.response == found.question.record.response
    assert remember(bench.retuner) == before | {"decisions": decision.number}
    return decision.code


def test_an_answer_is_overtaken_by_other_gains(found: Asked, bench: Bench) -> None:
    go_on(bench, found.samples)
    bench.retuner.committed(0, scaled(1.0, 1.0))
    assert refused(bench, found) == "overtaken_gains_changed"


def test_an_answer_is_overtaken_by_a_set_that_the_controller_reports(found: Asked, bench: Bench) -> None:
    bench.retuner.step(next(found.samples)._replace(revision=9))
    assert refused(bench, found) == "overtaken_gains_changed"


@pytest.mark.slow
def test_an_answer_is_overtaken_when_the_region_is_left_or_the_record_breaks_off() -> None:
    for change, code in (
        ({"x": 90.0}, "overtaken_region_left"),
        ({"mode": LoopMode.MANUAL}, "overtaken_broken_off"),
        ({"t_s": 1e6}, "overtaken_broken_off"),
    ):
        bench = made(scaled(2.4, 2.4))
        found = asked(bench)
        bench.retuner.step(next(found.samples)._replace(**change))
        assert refused(bench, found) == code


def test_a_response_that_completes_meanwhile_is_passed_over(found: Asked, bench: Bench) -> None:
    steps = [bench.retuner.step(sample) for sample in chain(found.samples, bench.samples(900, 0.0, 0.0, 10.0))]
    (passed,) = [step.decision for step in steps if step.decision]
    assert (passed.code, passed.action, passed.estimate) == ("passed_over", Action.NONE, None)
    assert re.search(r"still being evaluated after \d+ s: this one is not used", passed.reason)
    assert all(step.question is None for step in steps)


def test_only_the_open_question_is_answered_once_and_at_the_newest_sample(found: Asked, bench: Bench) -> None:
    with pytest.raises(ValueError, match="newest one is"):
        bench.retuner.enter(found.question, found.result, bench.retuner.sample_number - 1)
    entered(bench, found)
    with pytest.raises(ValueError, match="is not open"):
        entered(bench, found)


def test_a_question_does_not_outlive_a_restart(found: Asked, bench: Bench) -> None:
    number = bench.retuner.sample_number
    bench.retuner = restore(json.loads(json.dumps(remember(bench.retuner))), bench.retuner.settings)
    assert bench.retuner.sample_number == number
    with pytest.raises(ValueError, match="is not open"):
        entered(bench, found)


def test_in_a_region_that_is_off_nothing_is_asked() -> None:
    bench = made(scaled(2.4, 2.4), Mode.OFF)
    assert all(bench.retuner.step(s) == (None, None) for s in bench.samples(400, 0.0, 0.0, 10.0))
    assert all(bench.retuner.step(s) == (None, None) for s in bench.samples(400, 1.0, 0.0, 10.0))


def test_a_worker_that_fails_is_answered_for(found: Asked, bench: Bench) -> None:
    failed = Outcome("fit_failed", "the worker died")
    decision = bench.retuner.enter(found.question, failed, bench.retuner.sample_number)
    assert (decision.code, decision.reason, decision.action) == ("fit_failed", "the worker died", Action.NONE)


def test_a_question_is_not_changed_by_what_comes_after_it(found: Asked, bench: Bench, at_once: Decision) -> None:
    """It holds values: samples, table and models as they were."""
    bytes_then = pickle.dumps(found.question)
    go_on(bench, found.samples, 30)
    assert pickle.dumps(found.question) == bytes_then
    assert isinstance(found.question.record.table, GainTable)
    assert decide(found.question).proof == at_once.proof
    assert isinstance(bench.retuner, Retuner)
