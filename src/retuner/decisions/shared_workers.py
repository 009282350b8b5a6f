"""One set of decision workers for all loops of a session: questions wait for a free one in the order of their coming.

A loop sees a Decider of its own. Its deadline counts from when a worker begins with its question; how long the question
had to wait shows in the decision, as samples between question and answer.
"""

import os
from collections import deque
from types import TracebackType
from typing import NamedTuple

from retuner.adaptive.supervision.pipeline_types import Question
from retuner.decisions.decider import Answer
from retuner.decisions.worker import DecideInWorker
from retuner.drivers.clock import Clock


class _Asked(NamedTuple):
    """A question and the loop that asks it."""

    by: "LoopDecider"
    question: Question


class DecisionWorkers:
    """See the head of this file.

    Parameters
    ----------
    loops : how many loops ask. processes : how many workers answer; None for one less than the machine has cores, and
    no more than there are loops. clock : measures the deadlines.
    """

    def __init__(self, loops: int, *, processes: int | None = None, clock: Clock | None = None) -> None:
        wanted = processes if processes is not None else min(loops, max((os.cpu_count() or 2) - 1, 1))
        self._free = [DecideInWorker(float("inf"), clock=clock) for _ in range(wanted)]
        self._busy: dict[DecideInWorker, _Asked] = {}
        self._waiting: deque[_Asked] = deque()

    def __enter__(self) -> "DecisionWorkers":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def decider(self, deadline_s: float) -> "LoopDecider":
        """What one loop asks. deadline_s : time of the machine that a decision of it may take, s."""
        return LoopDecider(self, deadline_s)

    def close(self) -> None:
        """End the workers; what they were about is lost."""
        for worker in (*self._free, *self._busy):
            worker.close()
        self._free, self._busy = [], {}

    def ask(self, by: "LoopDecider", question: Question) -> None:
        """Put a question behind those that wait; one of this loop that still waits is not asked any more."""
        self._waiting = deque(asked for asked in self._waiting if asked.by is not by)
        self._waiting.append(_Asked(by, question))
        self.turn()

    def turn(self) -> None:
        """Hand out the answers that have come, and the questions that workers are free for."""
        for worker, asked in tuple(self._busy.items()):
            answer = worker.answer(0)
            if answer is not None:
                del self._busy[worker]
                self._free.append(worker)
                asked.by.came(asked.question, answer)
        while self._waiting and self._free:
            worker, asked = self._free.pop(), self._waiting.popleft()
            worker.ask(asked.question, asked.by.deadline_s)
            self._busy[worker] = asked


class LoopDecider:
    """The Decider of one loop: see there."""

    def __init__(self, workers: DecisionWorkers, deadline_s: float) -> None:
        self.deadline_s = deadline_s
        self._workers = workers
        self._question: Question | None = None
        self._answer: Answer | None = None

    def ask(self, question: Question) -> None:
        """See Decider."""
        self._question, self._answer = question, None
        self._workers.ask(self, question)

    def answer(self, sample_number: int) -> Answer | None:
        """See Decider; in real time it comes when it comes."""
        del sample_number
        if self._question is None:
            return None
        self._workers.turn()
        answer, self._answer = self._answer, None
        if answer is not None:
            self._question = None
        return answer

    def came(self, question: Question, answer: Answer) -> None:
        """The answer to a question; to one that is not asked any more it counts for nothing."""
        if question is self._question:
            self._answer = answer
