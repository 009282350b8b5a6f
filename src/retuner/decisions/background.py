"""A retuner for a loop of your own that nothing may hold up: decisions are made in another process.

    with BackgroundRetuner(Retuner(table, settings)) as watcher:
        decision = watcher.observe(sample)      # microseconds, always

`Retuner.observe` fits models when a response completes: a tenth of a second to a second. Here the question goes to a
worker of low priority, and its answer comes out of `observe` at a later sample, when the loop may have gone on: then
the retuner itself refuses what came too late. A trial that must end is ended at its own sample, as ever. Making one
takes some seconds instead: everything that a later sample would have to wait for is loaded then.
"""

from collections import deque

from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Decision
from retuner.adaptive.supervision.retuner import Retuner
from retuner.decisions.decider import Decider
from retuner.decisions.warm_up import warm_up
from retuner.decisions.worker import DecideInWorker
from retuner.drivers.closing import Closes

DEADLINE_S = 30.0  # how long a decision may take on a busy machine


class BackgroundRetuner(Closes):
    """Watches one loop, and never waits for a decision.

    Parameters
    ----------
    retuner : that decides; tell it what was written, as always (`retuner.committed`, `retuner.restored`, ...).
    deadline_s : time of the machine that a decision may take, s; after it the worker is started anew.
    decider : where decisions are made; None for a worker process of its own. It is closed with this object.

    Raises
    ------
    ValueError
        The deadline is not positive.
    """

    def __init__(self, retuner: Retuner, deadline_s: float = DEADLINE_S, decider: Decider | None = None) -> None:
        if not deadline_s > 0:
            raise ValueError(f"deadline_s = {deadline_s}; give more than 0 s")
        self.retuner = retuner
        self._decider = decider or DecideInWorker(deadline_s)
        if decider is None:
            warm_up()  # entering a decision imports what making one does, and by then there are samples to take
        self._made: deque[Decision] = deque()
        self.trouble = ""
        """Why the last question has no decision (the worker died, or took too long); empty when it has one."""

    @property
    def deciding(self) -> bool:
        """Whether a question is being answered."""
        return self.retuner.open_question is not None

    def observe(self, sample: LoopSample) -> Decision | None:
        """Take one sample; a decision that has been made meanwhile, the oldest first.

        Raises
        ------
        ValueError
            A number of the sample is not finite or its time does not increase; nothing is changed then.
        """
        step = self.retuner.step(sample)
        if step.decision is not None:
            self._made.appendleft(step.decision)  # to restore, mostly: it does not wait behind others
        if step.question is not None:
            self._decider.ask(step.question)
        question = self.retuner.open_question
        answer = self._decider.answer(self.retuner.sample_number) if question is not None else None
        if question is not None and answer is not None:
            self.trouble = answer.trouble
            self._made.append(self.retuner.enter(question, answer.result, self.retuner.sample_number))
        return self._made.popleft() if self._made else None

    def close(self) -> None:
        """End the worker; what it was about is lost."""
        if isinstance(self._decider, DecideInWorker):
            self._decider.close()
