"""What the guard rules, in words and numbers."""

import math
from enum import StrEnum

from retuner.adaptive.decision_numbers import NO_NUMBERS, Numbers
from retuner.adaptive.identification.plausible import Plausible
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_value, plain_values


class Ruling(StrEnum):
    """Every outcome; the value is its sentence, with the numbers that it needs by name."""

    ACCEPTED = "proved: nominal Ms {ms_nominal}, worst case {ms_worst} over the plausible models ({models})"
    URGENT = (
        "proved, without the limit of one change because the loop oscillates: Ms {ms_before} -> {ms_nominal}, "
        "worst case {ms_worst} over the plausible models ({models})"
    )
    SAFER = (
        "accepted because it improves a loop over its Ms limit: Ms {ms_before} -> {ms_nominal}, "
        "worst case {ms_before_worst} -> {ms_worst}"
    )
    UNPROVED_STEP = "accepted without a model, a small step from the response pattern: factor {factor} (limit {limit})"
    UNPROVED_WAY_OUT = "accepted without a model because the loop oscillates: less action, by a factor of {factor}"
    TOO_SMALL = "no change: the active settings are as good (new ones differ by {factor}x, changes start at {limit}x)"
    NOT_ROBUST = (
        "refused: not robust even at a quarter of the change: nominal Ms {ms_tried} (limit {ms_limit}), "
        "worst case {ms_tried_worst} (limit {ms_worst_limit})"
    )
    NOT_ROBUST_AT_BORDER = (
        "refused: not robust at the boundary to a neighbouring region: Ms {ms_tried} there (limit {ms_limit})"
    )
    OUTSIDE_LIMITS = "refused: the absolute limits leave no room for the change: requested {wanted}, limit {limit}"
    OUTSIDE_TOTAL = (
        "refused: the largest factor from the baseline gains leaves no room for the change: "
        "requested {wanted}, limit {limit}"
    )
    LOCKED = "refused: the change needs a parameter that is locked (factor {factor})"
    WRONG_SIGN = "refused: wrong controller action (requested direction {wanted}, active {in_force})"
    NOT_FINITE = "refused: the proposed gain is out of numeric range (kc {wanted})"
    NO_MODEL = "refused: no process model to prove the change on"
    TOO_FEW_RECORDS = "refused: the model has {records} records, {limit} are needed"
    TOO_OLD = "refused: the last record of the process is {age_s} s old (limit {limit} s)"
    NOT_SETTLED = "refused: the model is not accurate enough for tuning"
    CONTRADICTED = (
        "refused: the last record contradicts the model (misfit {innovation}, limit {limit}): another one decides"
    )


CUT = frozenset({Ruling.OUTSIDE_LIMITS, Ruling.OUTSIDE_TOTAL})
"""Rulings of which the notes tell more: which parameter was cut, and by what."""
NO_ROOM = "refused: the limits leave no room for the change"  # what they say then

# What the sentences need, one value for the rulings of one kind.


@dataclass(frozen=True, slots=True)
class SignNumbers(Numbers):
    """Directions, +1 or -1: of the proposal and of the gains in force."""

    wanted: float
    in_force: float


@dataclass(frozen=True, slots=True)
class WantedNumbers(Numbers):
    """What was wanted, beyond what numbers hold."""

    wanted: float


@dataclass(frozen=True, slots=True)
class LimitNumbers(Numbers):
    """What was wanted and the limit that cuts it, in the unit of its parameter."""

    wanted: float
    limit: float


@dataclass(frozen=True, slots=True)
class FactorNumbers(Numbers):
    """Factor of a change, and what it is held against; None for no limit."""

    factor: float
    limit: float | None = None


@dataclass(frozen=True, slots=True)
class DoubtNumbers(Numbers):
    """The one number of the evidence that fails, and its limit."""

    limit: float
    records: float | None = None
    age_s: float | None = None
    innovation: float | None = None
    settled: float | None = None


@dataclass(frozen=True, slots=True)
class BoundaryNumbers(Numbers):
    """Ms of the gentlest step towards a neighbouring region, and its limit."""

    ms_tried: float
    ms_limit: float


@dataclass(frozen=True, slots=True)
class NotRobustNumbers(Numbers):
    """Ms of the gentlest step, on the process and on the worst model, and their limits."""

    ms_tried: float
    ms_tried_worst: float
    ms_limit: float
    ms_worst_limit: float


@dataclass(frozen=True, slots=True)
class ProofNumbers(Numbers):
    """Ms of what is accepted and of the gains in force, and on how many models; ms_before_worst : where it is told."""

    ms_nominal: float
    ms_worst: float
    ms_before: float
    models: float
    ms_before_worst: float | None = None


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was asked.

    name : for machines. words : for people. value, limit : in the unit that the words say. passed : the answer.
    """

    name: str
    words: str
    value: float
    limit: float
    passed: bool

    def to_dict(self) -> dict[str, object]:
        """Plain values; null where a number is infinite or not known."""
        return plain_values(self, "name words value limit passed")


@dataclass(frozen=True, slots=True)
class Proof:
    """What the guard lets through.

    ruling : the outcome. gains : what may be written, None when refused. step : share of the proposed step (0 to 1).
    ms_nominal, ms_worst : Ms of these gains (when refused, of those in force) on the process and on the worst model;
        infinite for an unstable loop, NaN where no model is known. ms_before : of the gains in force on the process.
    tau_c_s : of the proposal. numbers : what the sentence needs. checks : the proof. notes : what was cut.
    allowed : the models on which it was proved. urgent : the loop oscillates and this is the way out.
    """

    ruling: Ruling
    gains: PidGains | None
    step: float
    ms_nominal: float
    ms_worst: float
    ms_before: float
    tau_c_s: float
    numbers: Numbers = NO_NUMBERS
    checks: tuple[Check, ...] = ()
    notes: tuple[str, ...] = ()
    allowed: tuple[Plausible, ...] = ()
    urgent: bool = False

    @property
    def accepted(self) -> bool:
        """Whether gains may be written."""
        return self.gains is not None

    @property
    def code(self) -> str:
        """Name of the ruling, for machines."""
        return self.ruling.name.lower()

    @property
    def sentence(self) -> str:
        """The ruling in words, with its numbers and what was cut."""
        shown = {name: text(name, value) for name, value in self.numbers.to_dict().items()}
        said = self.ruling.value.format(**shown)
        if self.ruling in CUT and self.notes:  # they name what was cut, and give the same two numbers
            said = NO_ROOM
        return "; ".join((said, *self.notes))

    def to_dict(self) -> dict[str, object]:
        """Plain values; null where Ms is infinite (unstable) or not known."""
        return {
            **plain_values(self, "accepted ruling=code code step"),
            "ms": plain_values(self, "nominal=ms_nominal worst=ms_worst before=ms_before"),
            **plain_values(self, "tau_c_s reason=sentence"),
            "numbers": plain_value(self.numbers.to_dict()),
            **plain_values(self, "checks notes"),
            "allowed": [plain_values(p, "model excess") for p in self.allowed],
            "urgent": self.urgent,
        }


def text(name: str, value: float) -> str:
    """A number as people read it."""
    if name.startswith("ms_"):
        return "unknown" if math.isnan(value) else "unstable" if math.isinf(value) else f"{value:.2f}"
    return f"{value:.4g}"
