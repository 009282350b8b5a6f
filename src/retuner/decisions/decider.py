"""Where decisions are made: here, at a sample that is known beforehand, or in a worker that nothing waits for.

A question goes in with `ask`, and the answer comes out of `answer` at some later sample; the session enters it there
and records that it did. In simulated time that sample is so many after the question, so equal runs give equal bytes.
In real time it is the first one after the worker has answered, or after its deadline.
"""

from typing import NamedTuple, Protocol

from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.question import Question


class Answer(NamedTuple):
    """What has become of a question. trouble : why there is no decision, in a sentence; empty when there is one."""

    result: Outcome
    trouble: str = ""


LATE, LOST = "decision_late", "decision_lost"
"""Codes of what is entered in place of a decision that did not come: it teaches and changes nothing."""


def without_decision(code: str, trouble: str) -> Answer:
    """The answer to a question that nobody has answered: the loop stays as it is."""
    return Answer(Outcome(code, f"{trouble}; the loop stays as it is"), trouble)


class Decider(Protocol):
    """Answers one question at a time. Nothing waits in either call."""

    def ask(self, question: Question) -> None:
        """Begin to answer."""

    def answer(self, sample_number: int) -> Answer | None:
        """The answer to be entered at this sample, None while there is none."""


class DecideHere:
    """Decides in this process, and hands the answer out a fixed number of samples after the question.

    delay_samples : so many, 0 or more.

    Raises ValueError: the delay is negative.
    """

    def __init__(self, delay_samples: int = 0) -> None:
        if delay_samples < 0:
            raise ValueError(f"delay_samples = {delay_samples}; give 0 or more")
        self._delay = delay_samples
        self._question: Question | None = None

    def ask(self, question: Question) -> None:
        """See Decider."""
        self._question = question

    def answer(self, sample_number: int) -> Answer | None:
        """See Decider."""
        question = self._question
        if question is None or sample_number < question.sample_number + self._delay:
            return None
        self._question = None
        return Answer(decide(question))
