"""When to bump the setpoint, by how much, and when it goes back: one enum of phases, one of inputs, one table.

    WATCHING -> ANNOUNCED -> GOING -> HOLDING -> RETURNING -> WATCHING
                               ^_________|  to and fro

A bump is a step of the setpoint and, once the loop has come to rest, the step back: two ordinary responses, which go
the ordinary way through admission, proof and trial. A record of loads alone leaves open what is load and what is
process (docs/developers/online.md has the Cramer-Rao bounds); a step whose cause is known does not.

A loop that loads move all the time is never at rest, and one step shows its loads as much as its process. There the
bump goes to and fro about the old setpoint, at times that are not even, and the whole of it is fitted as one record
(identification/by_setpoint.py).

A bump is announced by `_announced_if_due`, and begun by `_begins_or_is_put_off`; both ask whether it would teach
anything (loop_bumps.py). The planner moves nothing itself: it hands out the setpoint to be sent. It believes only what
comes back in the samples. A setpoint that is neither the old one nor the bump's is a person's or another loop's: it
stays, and the bump is over. Whatever else ends a bump puts the old setpoint back.
"""

import math
from enum import StrEnum

from retuner.adaptive.setpoint_bumps.bump_settings import HOURS, BumpSettings
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.signals.step_sequence import STANDS
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values

SECONDS_PER_HOUR = 3600.0
SAME = 0.05  # Share of a bump within which a setpoint is the one that was asked for: devices round
SENT_AGAIN_SAMPLES = 10  # samples after which a setpoint that has not come back is sent once more
NOT_TAKEN_SAMPLES = 40  # samples after which a bump that was not taken is given up
SHORTEST_SAMPLES = 20  # samples for which a bump is held at least, or its response would not have begun
CALM = 0.5  # share of a bump by which pv may be off the setpoint when it begins
RESTLESS = 0.02
"""Share of the samples outside the noise band, since the last evidence, from which loads move a loop all the time."""
STAYS_SAMPLES = 5
"""Samples for which the error must have fallen to half of a bump: noise and loads take it there by themselves."""
HOLDS = (5.0, 1.2, 2.4, 0.6, 3.5, 1.8, 0.9, 5.0, 1.2, 3.0, 0.6, 2.4, 1.2, 1.8)
"""Times for which each setpoint of a bump to and fro is held, in times that the error takes to fall to half of a bump.

Long and short ones in turn show slow and fast parts of the process. By the Cramer-Rao bound 86 % of loops under a walk
and 67 % under coloured loads can be known after six such bumps, 73 and 56 % by five even holds in the same time
(100 loops each; 42 and 30 % by one step)."""
RESET_SHARE = 0.1  # share of the integral time: a loop is hardly faster than that, whatever a load makes of the error
MOST_SAMPLES = 2000  # samples of a bump in all; as many before it are to be kept beside it


class BumpPhase(StrEnum):
    """Phases; the value is what people read."""

    WATCHING = "no bump"
    ANNOUNCED = "a setpoint bump is announced"
    GOING = "the setpoint bump was sent"
    HOLDING = "the setpoint is bumped"
    RETURNING = "the setpoint goes back"


class BumpEvent(StrEnum):
    """Everything that can happen; the value is the clause that people read."""

    TOO_SMALL = "the allowed bump would be lost in the noise"
    DUE = "nothing has shown the process recently"
    PUT_OFF = "the loop is not at rest, or something else is in progress"
    BEGUN = "nobody objected"
    TAKEN = "the controller has taken it"
    NOT_TAKEN = "the controller has not taken it"
    AT_REST = "the loop has come to rest"
    NEXT = "the setpoint goes to the other side"
    TOO_LONG = "it has lasted as long as it may"
    EXCURSION = "the control error is larger than a bump should make it"
    LIMITED = "the output stands at a limit"
    NOT_IN_AUTO = "the loop is not in automatic"
    NOT_ALLOWED = "the mode does not allow it any more"
    ENDED = "the session ends"
    LEFT_OUT = "the previous session left it active; the setpoint goes back"
    OTHERS = "someone else has moved the setpoint: it stays as it is"
    BACK = "the setpoint is back"


P, E = BumpPhase, BumpEvent
ENDINGS = (E.NOT_TAKEN, E.AT_REST, E.TOO_LONG, E.EXCURSION, E.LIMITED, E.NOT_IN_AUTO, E.NOT_ALLOWED, E.ENDED)
COURSE: dict[tuple[BumpPhase, BumpEvent], BumpPhase] = {
    (P.WATCHING, E.DUE): P.ANNOUNCED,
    (P.ANNOUNCED, E.PUT_OFF): P.WATCHING,
    (P.ANNOUNCED, E.OTHERS): P.WATCHING,
    (P.ANNOUNCED, E.ENDED): P.WATCHING,
    (P.ANNOUNCED, E.BEGUN): P.GOING,
    (P.GOING, E.TAKEN): P.HOLDING,
    **{(P.GOING, cause): P.RETURNING for cause in ENDINGS if cause is not E.AT_REST},
    (P.GOING, E.OTHERS): P.WATCHING,
    (P.HOLDING, E.NEXT): P.GOING,
    **{(P.HOLDING, cause): P.RETURNING for cause in ENDINGS if cause is not E.NOT_TAKEN},
    (P.HOLDING, E.OTHERS): P.WATCHING,
    (P.RETURNING, E.LEFT_OUT): P.RETURNING,
    (P.RETURNING, E.OTHERS): P.WATCHING,
    (P.RETURNING, E.BACK): P.WATCHING,
}
"""Everything that is not here leaves the phase as it is."""


@dataclass(frozen=True, slots=True)
class LoopAround:
    """What a planner cannot see in a sample.

    at_rest : no response is under way. wanted : why a bump would teach something, empty where it would not or must not
    be made. hour : of the day, 0 to 24. band : noise band, pv units. low, high : setpoints that keep the loop inside
    its region and pv inside its range. allowed : by the mode of the region. reset_s : integral time in force.
    """

    at_rest: bool
    wanted: str
    hour: float
    band: float
    low: float
    high: float
    allowed: bool = True
    reset_s: float = 0.0


@dataclass(frozen=True, slots=True)
class BumpNews:
    """What is to be recorded, and done. cause : what happened. phase : where that led to.

    setpoint : what is to be sent now, None for nothing. before, to : the setpoint and what it is bumped to, pv units.
    """

    cause: BumpEvent
    phase: BumpPhase
    setpoint: float | None
    before: float
    to: float
    reason: str

    def to_dict(self) -> dict[str, object]:
        """Keys cause, phase, setpoint, before, to, reason."""
        said = {"cause": self.cause.name.lower(), "phase": self.phase.name.lower()}
        return said | plain_values(self, "setpoint before to reason")


class BumpPlanner:
    """The bumps of one loop.

    settings : see BumpSettings. pv_span : range of pv. sample_time_s : of the controller.

    Its attribute `size` is that of a bump, pv units.
    """

    def __init__(self, settings: BumpSettings, pv_span: float, sample_time_s: float) -> None:
        self.settings = settings
        self.phase = BumpPhase.WATCHING
        self.made: list[float] = []
        """When the setpoint was bumped, sample times."""
        self.size, self._dt_s = settings.percent / 100 * pv_span, sample_time_s
        self._quiet_since_s: float | None = None
        self._sp = self._before = self._from = self._to = self._since_s = self._sent_s = 0.0
        self._up, self._told_small, self._left = True, False, False
        self._seen = self._outside = 0
        self._holds: tuple[float, ...] = ()
        self._squares = 0.0
        self._rested = False
        self._half_s = self._near_s = math.inf
        self._half = (-1, 0.0)
        """Gains' revision, and the longest half time seen under it: loads make the error cross by themselves."""

    @property
    def out(self) -> bool:
        """Whether the setpoint may stand where the bump has put it."""
        return self.phase in {BumpPhase.GOING, BumpPhase.HOLDING, BumpPhase.RETURNING}

    def evidence(self, t_s: float) -> None:
        """Something has shown the process: the waiting begins anew."""
        self._quiet_since_s = t_s
        self._seen, self._outside, self._squares, self._rested = 0, 0, 0.0, False

    def step(self, sample: LoopSample, around: LoopAround) -> BumpNews | None:
        """Take a sample; what it leads to, if anything."""
        if not self.settings.allowed:
            return None
        if self._quiet_since_s is None:
            self._quiet_since_s, self._sp = sample.t_s, sample.sp
        self._since_s = min(self._since_s, sample.t_s)
        moved = sample.sp != self._sp
        self._sp = sample.sp
        # What the evidence itself has left is passed over
        half_s = self.settings.after_h * SECONDS_PER_HOUR / 2
        self._rested = self._rested or around.at_rest or self._quiet_s(sample) > half_s
        if self._rested:
            self._seen += 1
            self._outside += abs(sample.sp - sample.pv) > around.band
            self._squares += (sample.sp - sample.pv) ** 2
        if self.phase is BumpPhase.WATCHING:
            if moved:
                self.evidence(sample.t_s)
            if self._quiet_s(sample) < self.settings.after_h * SECONDS_PER_HOUR:
                return None
            if (news := self._announced_if_due(sample, around)) is not None:
                return news
            # Tell once that a bump of the size that is allowed would teach nothing
            bands, least = self.size / around.band, self.settings.least_bands
            if self._told_small or not around.wanted or bands >= least:
                return None
            self._told_small = True
            enough = math.ceil(10 * self.settings.percent * least / bands) / 10
            reason = (
                f"a setpoint bump of {self.settings.percent:g} % is {bands:.1f} noise bands, and {least:g} are needed: "
                f"no bump is made; adaptation.bumps.percent = {enough:.1f} would be enough"
            )
            return BumpNews(BumpEvent.TOO_SMALL, self.phase, None, sample.sp, sample.sp, reason)
        cause = self._cause(sample, around)
        return None if cause is None else self._happened(cause, sample.t_s)

    def _quiet_s(self, sample: LoopSample) -> float:
        """Time since the process was shown last."""
        return sample.t_s - (self._quiet_since_s if self._quiet_since_s is not None else sample.t_s)

    def resume_bumped(self, before: float, to: float) -> None:
        """Put a setpoint back first that a session before this one has left bumped."""
        self._before, self._to = before, to
        self.phase, self._since_s, self._sent_s = BumpPhase.RETURNING, math.inf, -math.inf
        self._left = True

    def end(self, t_s: float) -> BumpNews | None:
        """Put the setpoint back at the end of the session, if it is out."""
        return self._happened(BumpEvent.ENDED, t_s)

    def again(self, t_s: float) -> float | None:
        """The setpoint to be sent once more because it has not come back yet; None for nothing."""
        asked = {BumpPhase.GOING: self._to, BumpPhase.RETURNING: self._before}.get(self.phase)
        if asked is None or t_s - self._sent_s < (SENT_AGAIN_SAMPLES - 0.5) * self._dt_s:
            return None
        self._sent_s = t_s
        return asked

    def _is_free(self, sample: LoopSample, around: LoopAround) -> bool:
        large = self.size >= self.settings.least_bands * around.band
        near = abs(sample.sp - sample.pv) <= max(CALM * self.size, around.band)
        calm = near and (around.at_rest or self.restless)
        ready = sample.mode == LoopMode.AUTO and not sample.limited and self.settings.is_time(around.hour)
        return bool(around.wanted) and large and calm and ready

    @property
    def restless(self) -> bool:
        """Whether loads move the loop all the time."""
        return self._outside > RESTLESS * self._seen

    def _aim(self, sp: float, around: LoopAround) -> float | None:
        """Where the setpoint would go: up and down in turn, as far as there is room; to and fro needs it on both."""
        sides = (sp + self.size, sp - self.size) if self._up else (sp - self.size, sp + self.size)
        if self.restless and not all(around.low <= to <= around.high for to in sides):
            return None
        return next((to for to in sides if around.low <= to <= around.high), None)

    def _announced_if_due(self, sample: LoopSample, around: LoopAround) -> BumpNews | None:
        """The announcement of a bump, where its budgets and how the loop stands allow one now."""
        s, to = self.settings, self._aim(sample.sp, around)
        lately = sum(1 for made in self.made if sample.t_s - made < HOURS * SECONDS_PER_HOUR)
        left = len(self.made) < s.most and lately < s.most_per_day
        if to is None or not left or not self._is_free(sample, around):
            return None
        self._before, self._from, self._to = sample.sp, sample.sp, to
        self._holds = HOLDS if self.restless else ()
        way = "until the loop is at rest, and back"
        if self._holds:
            way = (
                f"and {2 * sample.sp - to:g} in turn, {len(HOLDS)} times in all, and back, because loads move this loop"
            )
        reason = (
            f"{around.wanted}: in {s.announce_s:.0f} s the setpoint goes from {self._before:g} to {to:g} "
            f"{way}; to postpone it, move the setpoint or take the loop to manual"
        )
        return self._enter(BumpEvent.DUE, BumpPhase.ANNOUNCED, sample.t_s, reason)

    def _cause(self, sample: LoopSample, around: LoopAround) -> BumpEvent | None:
        """What a sample says while a bump is announced or out."""
        here, there = (abs(sample.sp - x) <= SAME * self.size for x in (self._before, self._to))
        other = abs(sample.sp - 2 * self._before + self._to) <= SAME * self.size
        since = sample.t_s - self._since_s
        if not around.allowed and self.phase in {BumpPhase.GOING, BumpPhase.HOLDING} and (here or there or other):
            return BumpEvent.NOT_ALLOWED
        match self.phase:
            case BumpPhase.ANNOUNCED if not here:
                return BumpEvent.OTHERS
            case BumpPhase.ANNOUNCED:
                return self._begins_or_is_put_off(sample, around, since)
            case BumpPhase.RETURNING if there and self._left:
                self._left = False  # told, for a session that is killed once more before the setpoint is back
                return BumpEvent.LEFT_OUT
            case BumpPhase.RETURNING if here and since > SENT_AGAIN_SAMPLES * self._dt_s:
                return BumpEvent.BACK
            case BumpPhase.RETURNING if here or there or other:
                return None
            case BumpPhase.GOING if abs(sample.sp - self._from) <= SAME * self.size:
                return BumpEvent.NOT_TAKEN if since > NOT_TAKEN_SAMPLES * self._dt_s else None
            case BumpPhase.GOING if there:
                return BumpEvent.TAKEN
            case BumpPhase.HOLDING if there:
                return self._enough(sample, around, since)
            case _:
                return BumpEvent.OTHERS

    def _begins_or_is_put_off(self, sample: LoopSample, around: LoopAround, since: float) -> BumpEvent | None:
        if not around.wanted or sample.mode != LoopMode.AUTO or not self.settings.is_time(around.hour):
            return BumpEvent.PUT_OFF
        if since < self.settings.announce_s:
            return None
        if self._is_free(sample, around):
            return BumpEvent.BEGUN
        return BumpEvent.PUT_OFF if since > self.settings.announce_s + self.settings.longest_s else None

    def _enough(self, sample: LoopSample, around: LoopAround, since: float) -> BumpEvent | None:
        if sample.mode != LoopMode.AUTO:
            return BumpEvent.NOT_IN_AUTO
        if sample.limited:
            return BumpEvent.LIMITED
        middle = self._before if self._holds else sample.sp  # to and fro, a step has put pv two bumps off by itself
        usual = math.sqrt(self._squares / self._seen) if self._seen else 0.0  # what loads do without any bump
        if abs(middle - sample.pv) > self.settings.excursion * math.hypot(self.size, usual):
            return BumpEvent.EXCURSION
        if sample.t_s - self.made[-1] > self.settings.longest_s:
            return BumpEvent.TOO_LONG
        if self._holds:
            # Whether it is time for the other side, or to go back; the first setpoint tells how long each is held
            if abs(sample.sp - sample.pv) >= self.size / 2:
                self._near_s = math.inf
            elif math.isinf(self._near_s):
                self._near_s = since
            longest = min(self.settings.longest_s, MOST_SAMPLES * self._dt_s) / sum(HOLDS)
            if math.isinf(self._half_s) and since - self._near_s >= STAYS_SAMPLES * self._dt_s:
                half_s = max(self._near_s, self._half[1] if self._half[0] == sample.revision else 0.0)
                self._half = sample.revision, half_s
                self._half_s = min(max(half_s, RESET_SHARE * around.reset_s, STAYS_SAMPLES * self._dt_s), longest)
            hold_s = max(self._holds[0] * min(self._half_s, longest), STANDS * self._dt_s)
            if since < hold_s - self._dt_s / 2:
                return None
            return BumpEvent.NEXT if len(self._holds) > 1 else BumpEvent.AT_REST
        return BumpEvent.AT_REST if around.at_rest and since > SHORTEST_SAMPLES * self._dt_s else None

    def _happened(self, cause: BumpEvent, t_s: float) -> BumpNews | None:
        new = COURSE.get((self.phase, cause))
        if new is None:
            return None
        told = str(cause)
        if self._holds and cause is BumpEvent.NEXT:
            told += f", from {self._to:g} to {2 * self._before - self._to:g}"
        elif self._holds and cause is BumpEvent.AT_REST:
            told = "the last of its steps is made"  # loads move the loop, so it never rests
        return self._enter(cause, new, t_s, f"setpoint bump: {told}")

    def _enter(self, cause: BumpEvent, new: BumpPhase, t_s: float, reason: str) -> BumpNews:
        if cause is BumpEvent.NEXT:
            self._from, self._to, self._holds = self._to, 2 * self._before - self._to, self._holds[1:]
        self.phase, self._since_s = new, t_s
        setpoint = {BumpPhase.GOING: self._to, BumpPhase.RETURNING: self._before}.get(new)
        if setpoint is not None:
            self._sent_s = t_s
        if cause is BumpEvent.BEGUN:
            self._half_s = self._near_s = math.inf
            self.made.append(t_s)
            self._up = self._to < self._before
        if new is BumpPhase.WATCHING:
            self.evidence(t_s)
        return BumpNews(cause, new, setpoint, self._before, self._to, reason)
