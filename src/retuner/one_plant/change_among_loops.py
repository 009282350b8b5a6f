"""Decides for a loop that is not alone on its plant.

question -> on trial, and another loop's setpoint moved meanwhile?  yes: the response says nothing, all samples may
         -> decided as ever, then put to the loops together (below): a change that they do not survive is not made

Whether the loops on one plant survive a change of one of them, as far as the plant is known.

all loops' records -> answers to every output (interaction/) -> Ms of each loop, closed together, before and after
"""

import math
from collections.abc import Sequence
from itertools import pairwise

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.guard.step_size import extent, less_of_everything
from retuner.adaptive.interaction.common_windows import OneLoopRecord, seen_in
from retuner.adaptive.interaction.together import Closed, together
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.question import OTHER_LOOP, Question
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.trial.phase import UNDECIDED, TrialPhase
from retuner.decisions.decider import Answer, Decider, without_decision
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

NO_VERDICT = "a known disturbance, no verdict on this loop"
"""How it ends what is told of another loop's move in a response."""
NOT_SURVIVED = "not_survived"  # Code: the other loops on the plant do not survive the change


def without_change(outcome: Outcome, reason: str) -> Outcome:
    """What was learned, and no change."""
    return replace(outcome, code=NOT_SURVIVED, reason=reason, proof=None, basis=None, prediction=None)


IN_PART = "half of a change that was "  # how the reason begins of a change that the other loops survive in half


def half_way(question: Question, refused: PidGains) -> Question:
    """The question where one change may go half the way (of logarithms) to gains that were refused."""
    guard = question.settings.guard.held_to(math.exp(extent(question.record.in_force, refused) / 2))
    return replace(question, settings=replace(question.settings, guard=guard), after=None)


NO_WORSE = 1.05  # another loop's Ms over the limit may grow by this factor: the plant is known no better


@dataclass(frozen=True, slots=True)
class Among:
    """A loop among the others on its plant; plain values, so that another process may work it out.

    names, closed, records : of all loops. dt_s : of the records. own : index of the loop. ms_most : largest Ms of a
    loop among the others, that of the guard for the identified process: the answers are one model of the plant.
    """

    names: tuple[str, ...]
    closed: tuple[Closed, ...]
    records: tuple[OneLoopRecord, ...]
    dt_s: float
    own: int
    ms_most: float

    def answered(self, question: Question, result: Outcome) -> Outcome:
        """The answer to a question; with half of its change, or none, where the others do not survive it."""
        gains = None if result.proof is None else result.proof.gains
        words = "" if gains is None else self._against(gains, result.basis)
        if gains is None or not words:
            return result
        half = decide(half_way(question, gains))
        less = half.proof.gains if half.proof is not None and half.proof.accepted else None
        if less is None or self._against(less, half.basis):
            return without_change(result, words)
        return replace(half, reason=f"{IN_PART}{words}: {half.reason}")

    def _against(self, gains: PidGains, basis: Basis | None) -> str:
        """What speaks against these gains; empty for nothing. Where the plant is not known, that nothing else is."""
        plant, own = seen_in(self.records, self.dt_s), self.closed[self.own].gains
        others = " and ".join(name for i, name in enumerate(self.names) if i != self.own)
        if plant is None:
            blind = basis in {Basis.PATTERN, Basis.SLOW_OSCILLATION} and not less_of_everything(own, gains)
            return (
                f"refused: without a model, no more action before {others} on the same plant is known" if blind else ""
            )
        now = together(plant, self.closed)
        changed = [replace(one, gains=gains) if i == self.own else one for i, one in enumerate(self.closed)]
        told = [
            f"Ms of {name} {_shown(after)}, now {_shown(before)}"
            for i, (name, before, after) in enumerate(zip(self.names, now, together(plant, changed), strict=True))
            if after > max(self.ms_most, before * (1.0 if i == self.own else NO_WORSE))
        ]
        if not told:
            return ""
        return f"refused: with {others} on the same plant: {'; '.join(told)}; limit {self.ms_most:g}"


def _shown(ms: float) -> str:
    return "infinite" if ms == float("inf") else f"{ms:.2f}"


def on_one_clock(samples: Sequence[Sequence[tuple[float, ...]]], dt_s: float) -> tuple[OneLoopRecord, ...]:
    """What loops have kept as records at the same times, from when all were watched; samples : (t_s, sp, pv, co, ...).

    Each controller counts its own time: the newest samples are taken for simultaneous where they are further apart than
    two sample times.
    """
    import numpy as np  # noqa: PLC0415  only where loops share a plant

    every = [np.array([sample[:4] for sample in one], dtype=np.float64) for one in samples]
    end = float(every[0][-1, 0])
    for one in every[1:]:
        off = end - float(one[-1, 0])
        one[:, 0] += off if abs(off) > 2 * dt_s else 0.0
    t = end - dt_s * np.arange(int((end - max(float(one[0, 0]) for one in every)) / dt_s + 1e-9), -1, -1)
    rows = [one[np.maximum(np.searchsorted(one[:, 0], t + dt_s / 1000, "right") - 1, 0)] for one in every]
    return tuple(OneLoopRecord(row[:, 1], row[:, 2], row[:, 3]) for row in rows)


MOVES_MOST = 4
"""Moves of another setpoint during a response that are single ones; more, and it is led by a master all the time."""
BEFORE = 2.0
"""Lengths of a response before its start in which another loop's move may have begun it: by way of a slow element."""


class OnePlant:
    """The retuners of the loops on one plant, in a fixed order."""

    def __init__(self, retuners: Sequence[Retuner]) -> None:
        self.retuners = tuple(retuners)

    def moved_beside(self, own: int, question: Question) -> str:
        """Which other loop's setpoint moved during the response of a question, in a sentence; empty for none.

        A response to a load counts from BEFORE its start on, or from the other loop's last move where that loop has not
        come to rest since.
        """
        response, now_s = question.record.response, question.t_s
        for i, other in enumerate(self.retuners):
            kept = other.samples
            if i == own or not kept:
                continue
            off = now_s - kept[-1].t_s
            off = off if abs(off) > 2 * self._dt_s else 0.0
            begin = response.t_start_s - off
            if not response.sp_changed:
                lead_s = BEFORE * (response.t_end_s - response.t_start_s)
                # since when the error has stood outside the noise band, before a time; that time where it does not
                since = begin
                for sample in reversed(kept):
                    if sample.t_s <= begin:
                        if abs(sample.sp - sample.pv) <= other.band:
                            break
                        since = sample.t_s
                begin = min(begin - lead_s, since)
            # times at which the setpoint changed, between two times
            end_s = response.t_end_s - off
            moves = [b.t_s for a, b in pairwise(kept) if a.sp != b.sp and begin <= b.t_s <= end_s]
            if 0 < len(moves) <= MOVES_MOST:
                moved = f"moved its setpoint at {moves[-1] + off:,.0f} s"
                return f"{other.table.loop}, on the same plant, {moved}: {NO_VERDICT}"
        return ""

    def among(self, own: int) -> Among | None:
        """The loop among the others; None before all have a sample."""
        samples = [one.samples for one in self.retuners]
        if not all(samples):
            return None
        settings = [one.settings for one in self.retuners]
        order = [own, *(i for i in range(len(samples)) if i != own)]  # the clock is that of the loop that asks
        return Among(
            tuple(self.retuners[i].table.loop for i in order),
            tuple(Closed(_gains(self.retuners[i]), settings[i].sample_time_s, settings[i].filter_s) for i in order),
            on_one_clock([samples[i] for i in order], self._dt_s),
            self._dt_s,
            0,
            settings[own].guard.ms_nominal,
        )

    @property
    def _dt_s(self) -> float:
        return max(one.settings.sample_time_s for one in self.retuners)


class DecideAmong:
    """The Decider of a loop on a shared plant.

    inner : makes the decisions. plant : with all its loops. own : index of this one.
    """

    def __init__(self, inner: Decider, plant: OnePlant, own: int) -> None:
        self._inner, self._plant, self._own = inner, plant, own
        self._asked, self._spoilt = 0, ""
        self._others: tuple[PidGains, ...] = ()
        self._waits: Answer | None = None

    def ask(self, question: Question) -> None:
        """See Decider."""
        self._asked, self._others, self._waits = question.sample_number, self._other_gains(), None
        on_trial = question.trial.phase in UNDECIDED and not question.alone
        self._spoilt = self._plant.moved_beside(self._own, question) if on_trial else ""
        question, among = replace(question, spoilt=self._spoilt), self._plant.among(self._own)
        self._inner.ask(question if among is None else replace(question, after=among.answered))

    def answer(self, sample_number: int) -> Answer | None:
        """See Decider. What stands in place of a decision is not handed out at once: the question has a row first."""
        if self._waits is None:
            answer = self._inner.answer(sample_number)
            self._waits = None if answer is None else self._in_place_of(answer)
            if self._waits is None:
                return answer
        if sample_number == self._asked:
            self._asked = 0
            return None
        waited, self._waits = self._waits, None
        return waited

    def _in_place_of(self, answer: Answer) -> Answer | None:
        proof, reason = answer.result.proof, answer.result.reason
        held = reason if answer.result.code == NOT_SURVIVED or reason.startswith(IN_PART) else ""
        if self._spoilt and held:
            return without_decision(OTHER_LOOP, f"{self._spoilt}; {held}")
        if proof is None or not proof.accepted or self._other_gains() == self._others:
            trouble = held or self._spoilt
            return Answer(answer.result, trouble) if trouble else None
        return without_decision(OTHER_LOOP, "another loop on the same plant has got other gains meanwhile")

    def _other_gains(self) -> tuple[PidGains, ...]:
        return tuple(_gains(one) for i, one in enumerate(self._plant.retuners) if i != self._own)


def _gains(one: Retuner) -> PidGains:
    """The gains in force where the loop is, or being written."""
    region = one.region or 0
    trial = one.trials.of(region)
    if trial.phase is TrialPhase.WRITING and trial.new is not None:
        return trial.new
    return one.table.at(region, *one.scheduled)
