"""Decisions made elsewhere and entered later: replayed byte for byte; a worker that dies costs one decision."""

import itertools
import os
import pickle
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import answer
from once import once
from recorded import SHORT, bodies, run_short

from retuner import LoopSample, Retuner
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.question import Question
from retuner.decisions.decider import LATE, LOST, Answer, DecideHere, Decider
from retuner.decisions.worker import DecideInWorker, DecisionWorkers
from retuner.drivers.clock import SimulatedClock
from retuner.replay.replaying import recorded_columns
from retuner.session.assembly import make_retuner
from retuner.session.outputs import read_loops

DELAY = 25
PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run whose decisions are entered late."""
    slow = SHORT.replace("[device]", f"decision_delay_samples = {DELAY}\n[device]", 1)
    return once(tmp_path_factory, "later", lambda folder: run_short(folder, "--mode", "auto", text=slow)) / "run"


@pytest.fixture(scope="module")
def asked(session: Path) -> tuple[Retuner, Question]:
    """A retuner with an open question, and the question."""
    recorded = read_loops(session)[0][0]
    retuner = make_retuner(recorded.config, recorded.mode)
    columns = recorded_columns(recorded)
    for t, sp, pv, co in zip(*(columns[name] for name in ("t", "sp", "pv", "co")), strict=True):
        step = retuner.step(LoopSample(float(t), float(sp), float(pv), float(co), 1, 0, float(sp)))
        if step.question is not None:
            return retuner, step.question
    raise AssertionError("nothing was asked")


def test_a_later_decision_is_entered_at_its_sample_and_replayed_byte_for_byte(session):
    questions, answers = bodies(session, "question"), bodies(session, "answer")
    assert len(questions) == len(answers) >= 2
    for question, given in zip(questions, answers, strict=True):
        assert (question["asked"], given["asked"]) == (question["samples"], question["samples"])
        assert given["samples"] == question["samples"] + DELAY
    late = [body["delay"] for body in bodies(session, "decision") if "delay" in body]
    assert late == [{"raised": row["asked"], "entered": row["samples"]} for row in answers]
    assert len(bodies(session, "committed")) >= 1
    assert answer("replay", session)["identical"] is True


def waited(worker: Decider) -> Answer:
    """What the worker says, within a patience that a busy machine does not exhaust."""
    end_s = time.monotonic() + PATIENCE_S
    for number in itertools.count(1):
        answer = worker.answer(number)
        if answer is not None:
            return answer
        assert time.monotonic() < end_s, "the worker does not answer"
        time.sleep(0.01)
    raise AssertionError


@pytest.mark.slow
def test_the_worker_answers_as_this_process_would(asked: tuple[Retuner, Question]) -> None:
    _, question = asked
    here = decide(pickle.loads(pickle.dumps(question)))  # sent as to the worker: arrays share types or not
    with DecideInWorker(PATIENCE_S) as worker:
        assert worker.answer(1) is None
        worker.ask(question)
        there = waited(worker)
        assert worker.answer(2) is None
    assert there.trouble == ""
    assert pickle.dumps(there.result) == pickle.dumps(pickle.loads(pickle.dumps(here)))


@pytest.mark.slow
def test_loops_share_a_worker_and_each_gets_the_answer_to_its_newest_question(asked: tuple[Retuner, Question]) -> None:
    _, question = asked
    with DecisionWorkers(2, processes=1) as workers:
        one, other, silent = (workers.decider(PATIENCE_S) for _ in range(3))
        one.ask(question)
        other.ask(replace(question, sample_number=7))
        other.ask(question)  # the question before it waits for the worker, and is not asked any more
        found = [waited(one), waited(other)]
        assert silent.answer(1) is None
        assert [one.answer(2), other.answer(2)] == [None, None]
    assert [answer.trouble for answer in found] == ["", ""]
    assert pickle.dumps(found[0].result) == pickle.dumps(found[1].result)


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_this_decision_and_not_the_next(asked: tuple[Retuner, Question]) -> None:
    """Killed between two questions it costs none."""
    _, question = asked
    with DecideInWorker(PATIENCE_S) as worker:
        first = worker.pid
        assert first is not None
        os.kill(first, signal.SIGSTOP)
        worker.ask(question)
        os.kill(first, signal.SIGKILL)
        lost = waited(worker)
        assert lost.result.code == LOST
        assert "was killed by SIGKILL" in lost.trouble
        assert "\n" not in lost.result.reason
        second = worker.pid
        assert second not in {None, first}
        worker.ask(question)
        assert waited(worker).trouble == ""
        os.kill(second, signal.SIGKILL)
        worker._worker.process.wait()
        worker.ask(question)
        assert waited(worker).trouble == ""
        assert worker.pid != second


@pytest.mark.slow
def test_a_worker_is_warm_when_it_has_imported_and_one_that_is_gone_holds_nobody_up() -> None:
    with DecideInWorker(60.0) as decider:
        worker = decider._worker
        assert not worker.warm.is_set()  # it has a second of imports before it
        decider.wait_until_warm(60.0)
        assert worker.warm.is_set()
        assert worker.process.poll() is None
    with DecideInWorker(60.0) as decider:
        assert decider.pid is not None
        os.kill(decider.pid, signal.SIGKILL)
        worker = decider._worker
        decider.wait_until_warm(60.0)
        assert worker.warm.is_set()


@pytest.mark.slow
def test_a_worker_that_hangs_is_ended_at_the_deadline_and_nothing_waits_for_it(asked: tuple[Retuner, Question]) -> None:
    _, question = asked
    clock = SimulatedClock()
    with DecideInWorker(60.0, clock=clock) as worker:
        first = worker.pid
        os.kill(first, signal.SIGSTOP)
        for _ in range(3):  # more than a pipe takes
            worker.ask(question)
        clock.advance(59.9)
        assert worker.answer(1) is None
        clock.advance(0.2)
        late = worker.answer(2)
        assert late.result.code == LATE
        assert "no decision within 60 s" in late.trouble
        assert worker.pid not in {None, first}
        worker.ask(question)
        assert waited(worker).trouble == ""


@pytest.mark.slow
def test_a_worker_without_memory_is_named_and_the_loop_goes_on(asked: tuple[Retuner, Question]) -> None:
    _, question = asked
    with DecideInWorker(PATIENCE_S, memory_bytes=1 << 23) as worker:
        worker.ask(question)
        lost = waited(worker)
    assert lost.result.code == LOST
    assert lost.trouble.count("\n") == 0
    assert lost.result.region_model is None
    assert lost.result.proof is None


def test_what_is_entered_without_a_decision_changes_nothing(asked: tuple[Retuner, Question]) -> None:
    retuner, question = asked
    clock = SimulatedClock()
    with DecideInWorker(1.0, clock=clock) as worker:
        os.kill(worker.pid or 0, signal.SIGSTOP)
        worker.ask(question)
        clock.advance(2.0)
        late = worker.answer(1)
    before = retuner.table
    decision = retuner.enter(question, late.result, retuner.sample_number)
    assert decision.gains_after is None
    assert decision.code == LATE
    assert retuner.table is before


def test_a_delay_below_zero_is_refused() -> None:
    with pytest.raises(ValueError, match="delay_samples = -1"):
        DecideHere(-1)
