"""The verdict of a loop over time, from the causes of its stretches: what it is, since when, how often, and what to do.

Each stretch names a cause with a confidence c. The surest stretch that names a fault stands as it is; stretches of one
loop are no independent records, so each further one counts half, for it or against it:

    odds = c1 / (1 - c1)  x product over further ones that name it of sqrt(c / (1 - c))
                          x product over those that say "in order", or another fault, of sqrt((1 - c) / c)

A limit of co that binds for part of the time is told from the whole record, because no stretch need show it: with w of
the time at a limit, and l of the integral of |error| come up there, nearly all of it of one sign,

    odds = one-sidedness  x  (l / (1 - l)) / (w / (1 - w))

Stretches in order elsewhere do not speak against that. Where no stretch names a fault or "in order", the idle index of
the whole record may: a controller that waits for the process after every load is sluggish (Hagglund 1999), without
settings. "Unknown" and noise say nothing either way: a stretch at rest does not clear a valve that sticks when it
moves.

What a visit may bring is a share of the mean |error|. Where a process was identified, it is what other settings would
have made of parts spread over the record (choice/foreseen.py). A limit's is the error that comes up there. Elsewhere
the Harris index H of the variance stands in, of which the mean |error| feels 1 - sqrt(1 - H).
"""

import math
from collections.abc import Sequence
from enum import StrEnum
from types import MappingProxyType
from typing import Self

from retuner.adaptive.audit.loop_screen import LoopScreen
from retuner.adaptive.choice.foreseen import Foreseen
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause
from retuner.adaptive.indexes.condition import SENTENCES, Condition
from retuner.schedule.late_dataclass import dataclass, replace

HALF = 0.5  # what a further stretch counts
CONVINCED = 0.5  # joined confidence from which a fault is told
MOST_SURE = 0.98  # no more is claimed of any stretch: something else may always be the case
LEAST_AT_LIMIT, LEAST_LOSS, LEAST_ONE_SIDED = 0.02, 0.2, 0.7
"""Share of the time at a limit, share of the loss there, and one-sidedness, from which a limit is asked for."""
TWO_SIDED = 0.3
"""One-sidedness below which no limit binds, whatever a stretch says: co rests there, and the error has both signs."""
CALM = 0.5  # what a share of co's travel counts beside the same share of the error: an actuator wears
LEAST_BENEFIT = 0.05
"""A fault stays in the list even where settings that cure it take no error away: it is short of margin."""
SWINGS = 0.5  # share of the stretches in which an oscillation lasts from which the loop swings

WAITS = 0.25  # idle index of a whole record from which its controller waits for the process
SURE_IT_WAITS = 0.7


class AuditAction(StrEnum):
    """What to do about a loop.

    effort : work of a visit, in units of one retune at the desk; a judgement, to be fixed by the plant.
    """

    effort: float

    def __new__(cls, words: str, effort: float) -> Self:
        """A word that knows its effort."""
        made = str.__new__(cls, words)
        made._value_, made.effort = words, effort
        return made

    RETUNE = "retune", 1.0
    STEP = "record a setpoint step, then retune", 1.75
    VALVE = "repair the valve", 1.75
    SCHEDULE = "schedule the gains over pv", 1.5
    UPSTREAM = "look upstream", 1.5
    SIZE = "check actuator size and load", 2.25
    SIGNAL = "check the sensor or the tag", 1.5
    AUTOMATIC = "find out why it is in manual", 1.0
    RECORD = "record a setpoint step", 2.0
    EXPORT = "export its setpoint", 1.0
    SCREENED = "screened only", 1.0
    LOOK = "inspect", 2.0
    NOTHING = "nothing", 10.0


FOR_CAUSE = MappingProxyType(
    {
        Cause.AGGRESSIVE: AuditAction.RETUNE,
        Cause.SLUGGISH: AuditAction.RETUNE,
        Cause.SLOW_INTEGRATING: AuditAction.RETUNE,
        Cause.STICTION: AuditAction.VALVE,
        Cause.NONLINEAR: AuditAction.SCHEDULE,
        Cause.EXTERNAL: AuditAction.UPSTREAM,
        Cause.SATURATION: AuditAction.SIZE,
    }
)
FOR_CONDITION = MappingProxyType(
    {
        Condition.DEAD_PV: AuditAction.SIGNAL,
        Condition.DEAD_CO: AuditAction.AUTOMATIC,
        Condition.MANUAL: AuditAction.AUTOMATIC,
        Condition.NO_RESPONSE: AuditAction.SIGNAL,
        Condition.NOT_CONTROLLING: AuditAction.LOOK,
    }
)


@dataclass(frozen=True, slots=True)
class StretchVerdict:
    """What one stretch says: its time from the record's begin, s; cause, confidence, and the sentence."""

    begin_s: float
    end_s: float
    cause: Cause
    confidence: float
    reason: str


class VerdictBasis(StrEnum):
    """Where the avoidable error comes from."""

    SIMULATED = "simulated"
    LIMIT = "at the limit"
    HARRIS = "Harris"
    NONE = ""


@dataclass(frozen=True, slots=True)
class LoopVerdict:
    """What is behind a loop's behaviour over all of its record.

    cause : or unknown. confidence : joined over the stretches, 0 to 1. action : what to do. reason : one sentence.
    since_s : begin of the first stretch that shows it, from the begin of the record; None where nothing is shown.
    seen, looked_at : stretches that show it, and all. avoidable : share of the mean |error| that the action may take
    away, 0 to 1. rank : benefit times certainty over effort. basis : of avoidable.
    """

    cause: Cause
    confidence: float
    action: AuditAction
    reason: str
    since_s: float | None
    seen: int
    looked_at: int
    avoidable: float
    rank: float
    basis: VerdictBasis = VerdictBasis.NONE


def error_share(variance_share: float) -> float:
    """The share of the mean |error| that goes with a share of its variance, 0 to 1."""
    return 1 - math.sqrt(1 - min(max(variance_share, 0.0), 1.0))


def with_foreseen(verdict: LoopVerdict, found: Foreseen | None, *, proposed: bool) -> LoopVerdict:
    """A verdict of tuning whose benefit is what other settings would have made of the record.

    Less travel of co is a benefit as well; the error may even grow where a loop was too strong. Where the record does
    not show what the settings should be, it is what the worst model that it allows would have had.

    found : None where no process was identified. proposed : settings are proposed, and found is of them.
    """
    action = verdict.action if proposed else AuditAction.STEP
    saved = None if found is None else found.saved if proposed else found.least
    if saved is None or found is None or not math.isfinite(saved):
        return replace(verdict, action=action, rank=verdict.rank * verdict.action.effort / action.effort)
    saved = min(max(saved, 0.0), 1.0)
    benefit = max(saved, CALM * found.calmer if proposed else 0.0, LEAST_BENEFIT)
    rank = verdict.confidence * benefit / action.effort
    return replace(verdict, action=action, avoidable=saved, rank=rank, basis=VerdictBasis.SIMULATED)


def joined_confidence(cause: Cause, stretches: Sequence[StretchVerdict]) -> float:
    """How sure a cause is over several stretches; see the head of this file."""
    naming = sorted((_logit(s.confidence) for s in stretches if s.cause == cause), reverse=True)
    against = [
        _logit(s.confidence) for s in stretches if s.cause != cause and (s.cause == Cause.OK or s.cause in FOR_CAUSE)
    ]
    if not naming:
        return 0.0
    odds = naming[0] + HALF * sum(naming[1:]) - HALF * sum(against)
    return min(1 / (1 + math.exp(-odds)), MOST_SURE)


def _logit(confidence: float) -> float:
    """ln of the odds of a confidence, bounded."""
    sure = min(max(confidence, 1 - MOST_SURE), MOST_SURE)
    return math.log(sure / (1 - sure))


def loop_verdict(screen: LoopScreen, stretches: Sequence[StretchVerdict]) -> LoopVerdict:
    """The verdict of a loop.

    screen : its whole record. stretches : those that were diagnosed, in the order of time.
    """
    condition = FOR_CONDITION.get(screen.condition)
    faults = {s.cause for s in stretches} & FOR_CAUSE.keys()
    if screen.at_limits > 0 and screen.one_sided < TWO_SIDED:
        faults -= {Cause.SATURATION}
    if condition is not None and not faults:
        reason, n, worth = SENTENCES[screen.condition], len(stretches), 0.9 * 0.5 / condition.effort
        return LoopVerdict(Cause.UNKNOWN, 0.9, condition, reason, 0.0, n, n, 1.0, worth)
    best = max(faults, key=lambda c: joined_confidence(c, stretches), default=None)
    bound = limit_confidence(screen)
    if bound >= max(CONVINCED, joined_confidence(best, stretches) if best is not None else 0.0):
        # A limit that binds for part of the time
        action = FOR_CAUSE[Cause.SATURATION]
        w, loss = screen.at_limits, screen.loss_at_limits
        reason = f"co is at a limit for {w:.0%} of the time, where {loss:.0%} of the error arises, on one side"
        showing = [s for s in stretches if s.cause == Cause.SATURATION]
        since = showing[0].begin_s if showing else None
        rank, seen, basis = bound * loss / action.effort, len(showing), VerdictBasis.LIMIT
        return LoopVerdict(Cause.SATURATION, bound, action, reason, since, seen, len(stretches), loss, rank, basis)
    if best is not None and joined_confidence(best, stretches) >= CONVINCED:
        showing = [s for s in stretches if s.cause == best]
        sure = joined_confidence(best, stretches)
        action = FOR_CAUSE[best]
        clearest = max(showing, key=lambda s: s.confidence)
        often = max(len(showing) / len(stretches), screen.swinging if best not in TUNING_CAUSES else 0)
        avoidable, seen, since = error_share(screen.harris) * often, len(showing), showing[0].begin_s
        rank = sure * max(avoidable, LEAST_BENEFIT) / action.effort
        basis = VerdictBasis.HARRIS
        return LoopVerdict(best, sure, action, clearest.reason, since, seen, len(stretches), avoidable, rank, basis)
    if _waits(screen, stretches):
        # sluggish by the idle index, without settings
        action = AuditAction.RECORD
        reason = (
            f"after loads co and pv return together (idle index {screen.idle:.2f}): the loop waits for the process. "
            "A setpoint step would give the settings"
        )
        sure, avoidable, basis = SURE_IT_WAITS, error_share(screen.harris), VerdictBasis.HARRIS
        rank = sure * max(avoidable, LEAST_BENEFIT) / action.effort
        return LoopVerdict(Cause.SLUGGISH, sure, action, reason, None, 0, len(stretches), avoidable, rank, basis)
    # at rest nothing speaks against what the other stretches are suspected of
    calm = [s for s in stretches if s.cause is Cause.OK or (s.cause is Cause.NOISE and not faults)]
    if calm and screen.swinging < SWINGS:
        sure = 1 - joined_confidence(best, stretches) if best is not None else max(s.confidence for s in calm)
        sure, count = min(sure, MOST_SURE), len(calm)
        return LoopVerdict(
            calm[-1].cause, sure, AuditAction.NOTHING, calm[-1].reason, None, count, len(stretches), 0.0, 0.0
        )
    # Nothing can be named; a loop that swings is worth a look all the same
    swings = screen.swinging >= SWINGS
    told_by_itself = AuditAction.RECORD if stretches else AuditAction.SCREENED
    action = AuditAction.LOOK if swings else told_by_itself if screen.setpoint else AuditAction.EXPORT
    reason = stretches[-1].reason if stretches else _of_screen(screen)
    avoidable = error_share(screen.harris * screen.strength) if swings else 0.0
    rank, basis = HALF * avoidable / action.effort, VerdictBasis.HARRIS if swings else VerdictBasis.NONE
    return LoopVerdict(Cause.UNKNOWN, HALF, action, reason, None, 0, len(stretches), avoidable, rank, basis)


def asks(screen: LoopScreen) -> float:
    """How much a screening asks for a diagnosis, 0 to 1; nothing where it tells the fault itself, or has no setpoint.

    Any of three raises it: error that a controller could take away, a controller that waits or swings in parts with
    constant setpoint (idle index), an oscillation that lasts.
    """
    if not screen.setpoint or screen.condition in FOR_CONDITION:
        return 0.0
    signs = (screen.harris, abs(screen.idle or 0.0), screen.swinging * screen.strength)
    return 1 - math.prod(1 - min(max(sign, 0.0), 1.0) for sign in signs)


def _waits(screen: LoopScreen, stretches: Sequence[StretchVerdict]) -> bool:
    """Whether a loop that swings not and binds not waits for its process, and no stretch says that it is in order."""
    idle = screen.idle if screen.setpoint else None
    open_ = all(s.cause in {Cause.NOISE, Cause.UNKNOWN} for s in stretches)
    calm = screen.swinging < SWINGS and screen.at_limits < LEAST_AT_LIMIT
    return bool(stretches) and open_ and calm and idle is not None and idle >= WAITS


def limit_confidence(screen: LoopScreen) -> float:
    """How sure a limit of co binds for part of the record; see the head of this file."""
    w, loss = screen.at_limits, screen.loss_at_limits
    if not screen.setpoint or w < LEAST_AT_LIMIT or loss < LEAST_LOSS or screen.one_sided < LEAST_ONE_SIDED:
        return 0.0
    odds = screen.one_sided * loss * (1 - w) / max((1 - loss) * w, 1e-6)
    return min(odds / (1 + odds), MOST_SURE)


def _of_screen(screen: LoopScreen) -> str:
    period = f"oscillates with a period of {screen.period_s:.4g} s" if screen.period_s else "nothing stands out"
    if screen.setpoint:
        return f"screened only: {period}"
    at_limits = f", co is at a limit for {screen.at_limits:.0%} of the time" if screen.at_limits else ""
    return f"no setpoint in the record, so only pv and co were screened: {period}{at_limits}"
