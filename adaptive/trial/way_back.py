"""Where a change that is not decided by a response leads: which of the sets that ran is to run from now on.

    r(set)  =  (models on which it is unstable, greatest Ms on the others)       over the models that are still allowed

The less, the more robust. A set whose Ms is at most harmless_ms on every model counts as robust: among such sets it is
not Ms that decides. The commissioned set has no privilege, nor has the one before.

    a cause that says nothing of the set       the tried set stays, unless the one before is more robust
    evidence against it (worse, runaway)       the set before; where that is not robust on the models that the evidence
                                               leaves, the most robust of all that ran, the tried one among them

Models on which the tried set is robust do not count after evidence against it: they are refuted. One thing they still
say: where the set before is not robust on any of them, and acts more in everything, a swing under the tried one is no
reason to go back to it (a loop whose gain grew in the meantime became unstable by that). The same holds where every
model calls the set before unstable, also after a runaway: then an earlier set that acts less still and is robust
runs, else the tried one until a safer one is proved. A set before that every model calls unstable, and that was seen
to swing on, does not come back for a worse response, whatever the tried one acts. Nor do models that
now say of the set before what neither was seen of it nor was known when the change was proved: it has worked. Where
both are no robust sets, those that ran before are asked as well. Without a model the set before has been seen to work
and the tried one has not, unless the one before was seen to swing on and the tried one is less of everything;
and the tried one stays where many responses were watched under it and none spoke against it.
So what runs after it is never less robust, on the models that are still allowed, than what ran before it.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.trial.phase import UNDOS, TrialEvent
from retuner.adaptive.trial.settings import TrialSettings
from retuner.adaptive.weighed import Numbers
from retuner.schedule.gains import PidGains

SWINGS_ON = 0.9
"""Ratio of successive peaks from which a response was no decaying one (as the guard's urgent_damping)."""


class StillAllowed(NamedTuple):
    """What is known of a region's process.

    processes : the models that are still allowed where the region's own set runs alone, as a sampled controller sees
        them; empty where nothing is known.
    filter_s : filter time of the controller's derivative, s.
    between : of an interpolated table, processes between this knot and others, each with what runs there for a set
        that the region stores.
    """

    processes: tuple[LinearProcess, ...] = ()
    filter_s: float = 0.0
    between: tuple[tuple[LinearProcess, Callable[[PidGains], PidGains]], ...] = ()

    def ms(self, stored: PidGains) -> tuple[float, ...]:
        """Ms on each model, infinite where unstable."""
        alone = [sensitivity_peak(process, stored, self.filter_s) for process in self.processes]
        mixed = [sensitivity_peak(process, runs(stored), self.filter_s) for process, runs in self.between]
        return (*alone, *mixed)


NOTHING_KNOWN = StillAllowed()


class Robustness(NamedTuple):
    """Of one set; sorts from robust to not robust. unstable : on so many models. ms : greatest on the others."""

    unstable: int
    ms: float

    @classmethod
    def of(cls, ms: Iterable[float], harmless_ms: float = 0.0) -> "Robustness":
        """From Ms on each model; harmless_ms : up to this sets count as alike."""
        values = tuple(ms)
        finite = [value for value in values if math.isfinite(value)]
        return cls(len(values) - len(finite), max([harmless_ms, *finite]))


@dataclass(frozen=True, slots=True)
class WayBackNumbers(Numbers):
    """models : how many were asked. ms_tried, ms_before : greatest where stable; unstable_* : on so many models."""

    models: float
    ms_tried: float
    unstable_tried: float
    ms_before: float
    unstable_before: float


class SetsThatRan(NamedTuple):
    """before : the set before the trial. tried : None while it is not known to have run. earlier : the newest first.

    swung : ratio of successive peaks that was seen of the set before, None when nothing was. swings : as seen, else as
    the models said that the change was proved on.
    """

    before: PidGains
    tried: PidGains | None
    earlier: tuple[PidGains, ...] = ()
    swung: float | None = None
    swings: float = 0.0


class WayBack(NamedTuple):
    """gains : the set that is to run. stays : it is the tried one. reason : why, empty where nothing was weighed."""

    gains: PidGains
    stays: bool
    reason: str = ""
    numbers: WayBackNumbers | None = None


def way_back(cause: TrialEvent, ran: SetsThatRan, known: StillAllowed, settings: TrialSettings) -> WayBack:
    """Which set is to run after a cause that ends trials; see the head of this file."""
    has_worked = cause in UNDOS and ran.swings <= settings.harmless_decay
    if ran.tried is None or cause is TrialEvent.ORDERED_BACK:
        return WayBack(ran.before, stays=False)
    ms_tried, ms_before = known.ms(ran.tried), known.ms(ran.before)
    left = [i for i, ms in enumerate(ms_tried) if cause not in UNDOS or ms > settings.harmless_ms]
    if has_worked or not left:
        least_ms, most = min(ms_before, default=0.0), math.inf if left else settings.harmless_ms
        worse = cause in UNDOS and least_ms >= most and least_ms > settings.harmless_ms
        if worse and (_acts_less(ran) or (math.isinf(least_ms) and cause is TrialEvent.WORSE and _swung_on(ran))):
            return _calmer(cause, ran, ran.tried, known, least_ms, settings)
        return WayBack(ran.before, stays=False) if has_worked else _without_model(cause, ran, ran.tried)

    def robustness(ms: Sequence[float]) -> Robustness:
        return Robustness.of((ms[i] for i in left), settings.harmless_ms)

    tried, before = robustness(ms_tried), robustness(ms_before)
    stays = tried < before or (tried == before and cause not in UNDOS)
    gains, least = (ran.tried, tried) if stays else (ran.before, before)
    if least.unstable or least.ms > settings.harmless_ms:
        for other in ran.earlier:
            found = robustness(known.ms(other))
            gains, least = (other, found) if found < least else (gains, least)
    numbers = _numbers(len(left), ms_tried, ms_before, left)
    return WayBack(gains, gains == ran.tried, _words(numbers, gains, ran, settings), numbers)


def _acts_less(ran: SetsThatRan) -> bool:
    """Whether the tried set is less of everything than the one before."""
    return ran.tried is not None and less_of_everything(ran.before, ran.tried)


def _calmer(
    cause: TrialEvent, ran: SetsThatRan, tried: PidGains, known: StillAllowed, least_ms: float, settings: TrialSettings
) -> WayBack:
    """Where the set before acts more and no model holds it for robust: the tried set, or after a runaway the newest
    earlier one that acts less still and is robust on every model.
    """
    reason = _no_way_back(least_ms, ran)
    for one in ran.earlier if cause is TrialEvent.RUNAWAY else ():
        if less_of_everything(tried, one) and max(known.ms(one)) <= settings.harmless_ms:
            return WayBack(one, stays=False, reason=f"{reason}; an earlier gain set acts less still")
    return WayBack(tried, stays=True, reason=reason)


def _no_way_back(least_ms: float, ran: SetsThatRan) -> str:
    """Why a trial set that swings stays where the set before is worse on every model."""
    ms = "are unstable" if math.isinf(least_ms) else f"have Ms of at least {least_ms:.2f}"
    why = "the trial gains act less" if _acts_less(ran) else f"kept oscillating ({_ratio(ran)})"
    return f"on every plausible model the previous gains {ms}, and {why}"


def _swung_on(ran: SetsThatRan) -> bool:
    """Whether the set before was seen to swing on."""
    return ran.swung is not None and ran.swung >= SWINGS_ON


def _ratio(ran: SetsThatRan) -> str:
    """How it swung, for people."""
    return f"half-cycle decay ratio {ran.swung:.2f}" if ran.swung is not None else "not seen"


def _without_model(cause: TrialEvent, ran: SetsThatRan, tried: PidGains) -> WayBack:
    """What was seen is all there is: responses that were watched to no end have spoken for neither set."""
    if cause is TrialEvent.TIMED_OUT:
        return WayBack(tried, stays=True, reason="no response spoke against the trial gains")
    if cause not in UNDOS and _swung_on(ran) and less_of_everything(ran.before, tried):
        words = f"the previous gains kept oscillating ({_ratio(ran)}), the trial gains act less"
        return WayBack(tried, stays=True, reason=words)
    return WayBack(ran.before, stays=False)


def _numbers(models: int, tried: Sequence[float], before: Sequence[float], left: Sequence[int]) -> WayBackNumbers:
    """What was weighed."""
    one, other = (Robustness.of(ms[i] for i in left) for ms in (tried, before))
    return WayBackNumbers(models, one.ms, one.unstable, other.ms, other.unstable)


def _words(found: WayBackNumbers, gains: PidGains, ran: SetsThatRan, settings: TrialSettings) -> str:
    """The reason for people."""
    tried = robustness_words(found.ms_tried, found.unstable_tried, found.models)
    before = robustness_words(found.ms_before, found.unstable_before, found.models)
    words = f"over {models_words(found.models)}: trial gains {tried}, previous gains {before}"
    if not (found.unstable_tried or found.unstable_before) and max(found.ms_tried, found.ms_before) <= (
        settings.harmless_ms
    ):
        words += f"; both are robust (up to {settings.harmless_ms:g})"
    if gains in {ran.before, ran.tried}:
        return words
    return f"{words}; an earlier gain set was the most robust"


def models_words(models: float) -> str:
    """How many are asked."""
    return "the one plausible model" if models == 1 else f"the {models:.0f} plausible models"


def robustness_words(ms: float, unstable: float, models: float) -> str:
    """What is said of one set."""
    if unstable == models:
        return "unstable"
    some = f"unstable on {unstable:.0f}, otherwise " if unstable else ""
    return f"{some}Ms at most {ms:.2f}"
