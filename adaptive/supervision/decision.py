"""What a response leads to, and the record of the decision that is made of it: everything that led to it, in plain
values. A ledger keeps the record, and a replay is compared with it byte for byte.
"""

import json
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from retuner.adaptive import display_hook
from retuner.adaptive.decision_numbers import NO_NUMBERS, Basis, Numbers
from retuner.adaptive.diagnosis.cause import Diagnosis
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.explanations.book import Book
from retuner.adaptive.explanations.settings_by_book import BookNumbers
from retuner.adaptive.guard.ruling import Proof
from retuner.adaptive.identification.estimate import LogModel, ModelEstimate
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import ANEW, Agreement, Learned
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.response import Response
from retuner.adaptive.trial.judge import Judgement
from retuner.adaptive.trial.phase import ROLLBACK_CAUSES, TrialPhase
from retuner.adaptive.trial.posterior_check import PosteriorCheck
from retuner.adaptive.trial.prediction import Prediction
from retuner.adaptive.trial.trial import Trial
from retuner.adaptive.trial.words_on_persons_edit import lasting_words
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.plain_values import plain_values


class Mode(StrEnum):
    """What the retuner may do in a region.

    Attributes
    ----------
    off, advise : only watch; propose, and write what an operator approves, on trial.
    trial, auto : write one change, watch it, restore the old set when worse; then wait for an operator, or go on.
    """

    OFF = "off"
    ADVISE = "advise"
    TRIAL = "trial"
    AUTO = "auto"


WRITES = frozenset({Mode.AUTO, Mode.TRIAL})  # modes in which gains are written


class Action(StrEnum):
    """What follows from a decision.

    Attributes
    ----------
    NONE : nothing. ADVISE : a proposal for an operator. WRITE : gains to be written and put on trial. RESTORE :
    earlier gains to be written again. COMMIT : the former name of WRITE.
    """

    NONE = "none"
    ADVISE = "advise"
    WRITE = COMMIT = "commit"  # the word of every ledger
    RESTORE = "restore"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a response leads to: gains that are proved, or the reason why none; steps that were not reached are None.

    code : name of the reason, for machines. proof : the guard's, of the gains that win; refused, or None, for none.
    basis : what these rest on. proposal : of the rule, before the proof.
    region_model : what is known of the region from now on, None for as before.
    forget : what was known of the region is refuted. foreign : as in the record, with this response.
    excitation : what the region model rests on.
    prediction : what the proved gains promise, worked out where they may be written at all. posterior : what the record
    says of both sets of a trial that it ran under. beside : what is known from now on of the other regions on its way.
    elsewhere : what is due in a region where the loop is not, by its index. robust : after a trial, whether all
    samples show its set to be robust. refuted : why the samples of a trial by themselves speak against its set, empty
    for not. book : what all samples have shown of the region by now, None for as before; all_samples : of the gains in
    force.
    """

    code: str
    reason: str
    learned: Learned | None = None
    region_model: RegionModel | None = None
    diagnosis: Diagnosis | None = None
    proposal: Tuning | None = None
    basis: Basis | None = None
    proof: Proof | None = None
    foreign: int | None = None
    excitation: Excitation | None = None
    numbers: Numbers = NO_NUMBERS
    forget: bool = False
    prediction: Prediction | None = None
    posterior: PosteriorCheck | None = None
    beside: Mapping[int, RegionModel] = field(default_factory=dict)
    elsewhere: Mapping[int, "Outcome"] = field(default_factory=dict)
    robust: bool = False
    refuted: str = ""
    book: Book | None = None
    all_samples: BookNumbers | None = None

    @property
    def changes(self) -> bool:
        """Whether it has gains that are proved."""
        return self.proof is not None and self.proof.accepted

    def asks_for_less(self, now: PidGains) -> bool:
        """Whether its proved gains have less gain or integral action than those in force."""
        new = None if self.proof is None else self.proof.gains
        return new is not None and (abs(new.kp) < abs(now.kp) or abs(new.ki) < abs(now.ki))


class Delay(NamedTuple):
    """Numbers of two samples: of the one that raised the question, and of the later one at which it was decided."""

    raised: int
    entered: int


@dataclass(frozen=True, slots=True)
class Decision(display_hook.Shown):
    """One decision on one response.

    Attributes
    ----------
    number : counts up from 1 per loop.
    t_s : time of the sample at which it was entered, which is the one that completed the response unless `delay` names
        both.
    region : name.
    mode : of the region at the time. The stages that were not reached are None; `reason` is the sentence of the one
        that decided, `code` its name for machines, `numbers` what it weighed.
    gains_before : in force.
    gains_after : what shall be written (action WRITE or RESTORE) or is advised.
    records : how many records the region's model rests on.
    basis : what the proposal rests on.
    prediction : what gains_after promise.
    judgement : of the response against the promise of the gains on trial, if any.
    trial : where the region stands after this decision.
    known : the process as it may be met in the region from now on, which is what the cause and the proof go by
        (`estimate` is what the record itself shows).
    rollbacks : rollbacks in a row, told where this one restores.
    later : the loop is in another region, so that nothing is to be written now: the gains belong in the table, and run
        when the loop comes.
    all_samples : what all samples up to now say of the gains in force, beside this response; None before they were
        looked at.
    """

    number: int
    t_s: float
    loop: str
    region: str
    mode: Mode
    action: Action
    code: str
    reason: str
    gains_before: PidGains
    gains_after: PidGains | None = None
    response: Response | None = None
    estimate: ModelEstimate | None = None
    agreement: Agreement | None = None
    records: int = 0
    diagnosis: Diagnosis | None = None
    basis: Basis | None = None
    proposal: Tuning | None = None
    proof: Proof | None = None
    numbers: Numbers = NO_NUMBERS
    prediction: Prediction | None = None
    judgement: Judgement | None = None
    trial: str = "idle"
    known: LogModel | None = None
    delay: Delay | None = None
    rollbacks: int | None = None
    later: bool = False
    all_samples: Numbers | None = None

    @property
    def verdict(self) -> Proof | None:
        """`proof` under its former name."""
        return self.proof

    def __repr__(self) -> str:
        return (
            f"Decision({self.number}, {self.loop!r}, {self.region!r}, {self.t_s:.6g} s, {self.action}: {self.reason})"
        )

    def to_dict(self) -> dict[str, object]:
        """Plain values: what the ledger keeps. Keys that are not always there: `delay` where a decision was entered
        later, `all_samples` where a book is kept, `later` where gains of another region are to come into the table.
        """
        return {
            **plain_values(self, "number t_s loop region mode action code reason"),
            "numbers": self.numbers.to_dict() | ({} if self.rollbacks is None else {"undos": float(self.rollbacks)}),
            **plain_values(self, "gains_before gains_after response estimate"),
            "known": {"model": self.known.model().to_dict(), "std": self.known.std()} if self.known else None,
            "surprise": self.agreement.code if self.agreement else None,
            **plain_values(self, "records diagnosis basis proposal verdict=proof promise=prediction judgement trial"),
            **({"delay": self.delay._asdict()} if self.delay else {}),
            **(plain_values(self, "all_samples") if self.all_samples else {}),
            **({"later": True} if self.later and self.action == Action.WRITE else {}),
        }

    def canonical(self) -> bytes:
        """The bytes that replay must reproduce: JSON, sorted keys, no spaces, shortest round-trip floats."""
        body = self.to_dict()
        return json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False, default=_own).encode()

    def digest(self) -> str:
        """SHA-256 of the canonical bytes, in hexadecimal."""
        import hashlib  # noqa: PLC0415  with OpenSSL, an eighth of what importing Retuner takes

        return hashlib.sha256(self.canonical()).hexdigest()


def _own(value: object) -> object:
    """A number of numpy, as settings may bring it in, as one of Python. Raises TypeError: it is none."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is no plain value")


def gains_dict(gains: PidGains) -> dict[str, float]:
    """Parallel form by name."""
    return {"kp": gains.kp, "ki": gains.ki, "kd": gains.kd}


def blocked(outcome: Outcome, trial: Trial, now_s: float) -> Outcome:
    """The outcome with the reason why nothing may be changed now, when something was accepted."""
    if not outcome.changes:
        return outcome
    words = str(trial.phase)
    if trial.phase == TrialPhase.COOLING:
        words += f" for another {max(trial.until_s - now_s, 0.0):,.0f} s after {trial.cause}"
    elif trial.phase == TrialPhase.LOCKED:
        words += f" after {trial.rollbacks} rollbacks; an operator must unlock the region"
    elif trial.phase == TrialPhase.IDLE:
        words = "a change in another region is being written"
    return replace(outcome, code=f"held_{trial.phase.name.lower()}", reason=f"no change now: {words}")


def predicted_wrongly(trial: Trial, decision: Decision) -> bool:
    """Whether the models behind a change that is given up are not to be believed any more.

    decision : on the response that ended it; it may have put another model in their place.
    """
    by_models = trial.prediction is not None and trial.prediction.models > 0
    return trial.cause in ROLLBACK_CAUSES and by_models and decision.agreement not in ANEW


def restoring(decision: Decision, region: str, trial: Trial, also: Sequence[str]) -> Decision:
    """The decision that goes with a rollback. also : other regions that are restored with this one."""
    cause, back = trial.cause, trial.back
    assert cause is not None  # of a trial that is being restored
    assert back is not None
    judged = decision.judgement.reason if decision.judgement else ""
    done = f"rolled back to the {'verified' if back.gains == trial.old else 'most robust earlier'} gains"
    done = "no earlier gains are expected to be better, so the trial gains are kept" if back.stays else done
    reason = "; ".join(filter(None, (f"{done}: {judged or cause}", back.reason)))
    reason += f"; also in {', '.join(also)}" if also else ""
    if predicted_wrongly(trial, decision):
        reason += "; the model's prediction was wrong, so the model is discarded"
    return replace(
        decision,
        region=region,
        action=Action.RESTORE,
        code=f"undo_{cause.name.lower()}",
        reason=reason,
        numbers=back.numbers or decision.numbers,
        rollbacks=trial.rollbacks,
        gains_before=trial.new or decision.gains_before,
        gains_after=back.gains,
        prediction=trial.prediction,
        trial=str(trial.phase),
    )


def staying(decision: Decision, region: str, trial: Trial, also: Sequence[str]) -> Decision:
    """The decision that the tried set stays. also : other regions where it does as well.

    Where the controller may run something else, it has the action RESTORE: these gains are to run, and to be read back.
    """
    cause, back, ensure = trial.cause, trial.back, trial.phase is TrialPhase.ENSURING
    assert cause is not None  # of a trial that stays for all that
    assert back is not None
    what = str(cause).removeprefix("the ") + " during the trial" * ("trial" not in cause)
    reason = f"{what[:1].upper()}{what[1:]}; trial gains kept; {back.reason}"
    return replace(
        decision,
        region=region,
        action=Action.RESTORE if ensure else Action.NONE,
        code=f"kept_{cause.name.lower()}",
        reason=reason + (f"; also in {', '.join(also)}" if also else ""),
        numbers=back.numbers or decision.numbers,
        gains_before=back.gains,
        gains_after=back.gains if ensure else None,
        prediction=trial.prediction,
        trial=str(trial.phase),
    )


def proposing(decision: Decision, trial: Trial, now_s: float) -> Decision:
    """A change where a person's gains are held: it is proposed, and waits for his word."""
    if decision.gains_after is None or decision.code in ORDERED:
        return decision
    left_s = max(trial.until_s - now_s, 0.0)
    reason = (
        f"an operator set the active gains, on hold for another {lasting_words(left_s)}; proposed: {decision.reason}"
    )
    return replace(decision, action=Action.ADVISE, reason=reason)


ORDERED = ("approved", "ordered_back")  # codes of decisions that are that word
