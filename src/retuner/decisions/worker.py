"""Has decisions made in another process, so that the loop is never left alone: see worker_process.py for that side.

    ask -> courier thread -> pipe -> worker -> pipe -> courier thread -> answer

The courier does what may block: putting the question on the pipe, and waiting for the answer. The session only looks
whether one has come. A worker that is killed, dies, hangs past the deadline, or cannot be started costs the decision it
was about, which is said in one line; the next question goes to a new one.
"""

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
from collections import deque
from typing import NamedTuple

from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.question import Question
from retuner.decisions.decider import LATE, LOST, Answer, without_decision
from retuner.decisions.worker_process import receive, send
from retuner.drivers.clock import Clock, MonotonicClock
from retuner.drivers.closing import Closes

NICE = 3  # how much the worker gives way: beside two programs that keep two cores busy it still gets a quarter of one
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""What numpy's libraries of linear algebra look at: their threads would take the loop's core."""
MOST_WARMING_S = 60.0
"""Longest wait for the workers' imports, s; after that the loop is watched, and its first decision waits for them."""
END_S = 2.0  # how long a process whose pipe has ended may take to be gone by itself


class _Worker:
    """One worker process and the thread that talks with it."""

    def __init__(self, nice: int, memory_bytes: int) -> None:
        self.process = subprocess.Popen(  # noqa: S603  this program itself
            [sys.executable, "-P", "-m", "retuner.decisions.worker_process", str(nice), str(memory_bytes)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **dict.fromkeys(ONE_THREAD, "1")},
        )
        self._questions: queue.SimpleQueue[Question | None] = queue.SimpleQueue()
        self.answers: queue.SimpleQueue[object] = queue.SimpleQueue()
        self.warm = threading.Event()
        """Set when it has imported what a decision needs, or is gone."""
        self._courier = threading.Thread(target=self._carry, name="decisions", daemon=True)
        self._courier.start()

    def ask(self, question: Question) -> None:
        self._questions.put(question)

    def _carry(self) -> None:
        """Question there, answer back, until there are no more questions or the worker is gone."""
        to, back = self.process.stdin, self.process.stdout
        assert to is not None
        assert back is not None
        with to, back, contextlib.suppress(OSError, EOFError):
            receive(back)
            self.warm.set()
            while (question := self._questions.get()) is not None:
                send(to, question)
                self.answers.put(receive(back))
        self.warm.set()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(END_S)
        self.process.kill()
        self.process.wait()
        self.answers.put(None)

    def end(self) -> str:
        """Kill it; how it had ended before that, in words, empty if it was alive. The courier clears up."""
        code = self.process.poll()
        self.process.kill()
        self._questions.put(None)
        if code is None:
            return ""
        if code >= 0:
            return f"ended with status {code}"
        named = -code in set(signal.Signals)
        return f"was killed by {signal.Signals(-code).name if named else f'signal {-code}'}"

    def join(self) -> None:
        """Wait until a process that was ended is gone."""
        self._courier.join(END_S)


class DecideInWorker(Closes):
    """Decides in a process of its own: see the head of this file.

    deadline_s : time of the machine that a decision may take, s. nice : how much the worker gives way, 0 to 19.
    memory_bytes : data that the worker may hold; 0 for no limit. clock : measures the deadline.
    """

    def __init__(
        self, deadline_s: float, *, nice: int = NICE, memory_bytes: int = 0, clock: Clock | None = None
    ) -> None:
        self._deadline_s, self._nice, self._memory_bytes = deadline_s, nice, memory_bytes
        self._clock = clock or MonotonicClock()
        self._worker: _Worker | None = None
        self._asked_s: float | None = None
        self._why_not = ""
        self._start()

    def ask(self, question: Question, deadline_s: float | None = None) -> None:
        """See Decider. deadline_s : for this question and those after it; None for the one before."""
        self._deadline_s = self._deadline_s if deadline_s is None else deadline_s
        if self._worker is None or self._worker.process.poll() is not None:
            self._end()
            self._start()
        self._asked_s = self._clock.now_s()
        if self._worker is not None:
            self._worker.ask(question)

    def answer(self, sample_number: int) -> Answer | None:  # noqa: ARG002  in real time it comes when it comes
        """See Decider."""
        if self._asked_s is None:
            return None
        found = self._found()
        if found is not None:
            self._asked_s = None
        return found

    def close(self) -> None:
        """End the worker; what it was about is lost."""
        self._asked_s, worker = None, self._worker
        self._end()
        if worker is not None:
            worker.join()

    def wait_until_warm(self, timeout_s: float) -> None:
        """Wait until the worker can decide without importing anything first, or so long."""
        if self._worker is not None:
            self._worker.warm.wait(timeout_s)

    @property
    def pid(self) -> int | None:
        """Number of the worker process, None while there is none."""
        return self._worker.process.pid if self._worker is not None else None

    def _found(self) -> Answer | None:
        if self._worker is None:
            return without_decision(LOST, f"the worker could not be started: {self._why_not}")
        try:
            came = self._worker.answers.get_nowait()
        except queue.Empty:
            assert self._asked_s is not None
            if self._clock.now_s() - self._asked_s < self._deadline_s:
                return None
            self._end()
            self._start()
            trouble = f"no decision within {self._deadline_s:g} s of the machine's time; the worker was started anew"
            return without_decision(LATE, trouble)
        if isinstance(came, Outcome):
            return Answer(came)
        if isinstance(came, str):
            return without_decision(LOST, f"no decision was made: {came}")
        how = self._end() or "broke off"
        self._start()
        return without_decision(LOST, f"the worker {how} while it made a decision, and was started anew")

    def _start(self) -> None:
        try:
            self._worker = _Worker(self._nice, self._memory_bytes)
        except (OSError, RuntimeError) as error:  # RuntimeError: no thread can be started
            self._worker, self._why_not = None, str(error)

    def _end(self) -> str:
        worker, self._worker = self._worker, None
        return worker.end() if worker is not None else ""


# ---- One set of decision workers for all loops of a session: questions wait for a free one in the order of their
# coming.
#
# A loop sees a Decider of its own. Its deadline counts from when a worker begins with its question; how long the
# question had to wait shows in the decision, as samples between question and answer.


class _Asked(NamedTuple):
    by: "LoopDecider"
    question: Question


class DecisionWorkers(Closes):
    """See the head of this file.

    loops : how many loops ask. processes : how many workers answer; None for one less than the machine has cores, and
    no more than there are loops. clock : measures the deadlines.
    """

    def __init__(self, loops: int, *, processes: int | None = None, clock: Clock | None = None) -> None:
        wanted = processes if processes is not None else min(loops, max((os.cpu_count() or 2) - 1, 1))
        self._free = [DecideInWorker(float("inf"), clock=clock) for _ in range(wanted)]
        self._busy: dict[DecideInWorker, _Asked] = {}
        self._waiting: deque[_Asked] = deque()

    def decider(self, deadline_s: float) -> "LoopDecider":
        """What one loop asks. deadline_s : time of the machine that a decision of it may take, s."""
        return LoopDecider(self, deadline_s)

    def wait_until_warm(self) -> None:
        """Wait until the workers can decide: a loop's first response does not wait for their imports then."""
        clock = MonotonicClock()
        for worker in self._free:
            worker.wait_until_warm(max(MOST_WARMING_S - clock.now_s(), 0.0))

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
