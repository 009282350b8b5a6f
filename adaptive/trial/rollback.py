"""Which of the sets that ran is to run from now on, where a trial ends otherwise than by a response that confirms it.

What ends it: a response (judge.py), or samples that run away (diverging_trial.py); supervisor.py puts both here.

    expected(set) = sum_m P(m | seen) loss(set, m)  +  P(something else | seen) chance(set)

    loss(set, m)  = 1 - harmless_ms / Ms     share of the distance to instability that is lost: 0 where robust, 1 where
                                             unstable
    P(m | seen)   ~ weight(m)  prod over the sets seen   b where it was bad, 1 - b where it was calm
    b(set, m)     = by loads + (1 - 2 by loads) loss(set, m)

m are the models that are still allowed, with their likelihoods. A set is bad if it swung on or if there is evidence
against it (worse, runaway). It is calm if the loop did not swing under it, or if no response decided its trial. Loads
make a robust loop look bad now and then, and the process may have changed since the set before was calm. So evidence
weighs the models and strikes none out. If no model explains what was seen, only what was seen counts, by Laplace's rule
of succession, (1 + bad) / (2 + bad + calm); a set that acts more in everything than a bad one is as bad.

After evidence against the tried set the one before runs, also where there is no model; after a cause that says nothing
of it the tried one stays. Another set takes their place if it is expected to lose less by more than the price of a
change. The commissioned set has no privilege.

`less_stable` guards every way back: a set stays out if it is likelier to be unstable than the one that runs or to lose
more, by the models' weights from before the trial (at Ms 100 the loss is nearly that of an unstable loop). A
person's order is held to the first alone. Where no model is left, the models on which the tried set was proved decide.
One case asks no model: if pv left its range under the tried set only, the set before runs, unless it swung on or was
called unstable from the start.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from operator import mul
from typing import NamedTuple

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.trial.phase import ROLLBACK_CAUSES, TrialEvent
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

SWINGS_ON = 0.9  # ratio of successive peaks from which a response was no decaying one (as the guard's urgent_damping)
BY_LOADS = 0.05  # chance that loads make a robust loop look bad, or a bad one calm
BY_LOADS_AFTER = {TrialEvent.RUNAWAY: 0.01, TrialEvent.TIMED_OUT: 0.5}
"""The probability of a run of growing half waves, and of responses that decided nothing: every model explains these."""
CHANGED = 0.2  # chance that the process is another one than when the set before was calm
SOMETHING_ELSE = 0.1  # Probability, before anything is seen of a set, that none of the models is the process
PRICE = 0.05
"""Expected loss by which a set must be better to take the place of the one that would run: as Ms 2.1 to 2.2."""


class StillAllowed(NamedTuple):
    """What is known of a region's process.

    processes : the models that are still allowed where the region's own set runs alone, as a sampled controller sees
        them; empty where nothing is known. weights : how likely each is; empty for all alike.
    filter_s : filter time of the controller's derivative, s.
    between : of an interpolated table, processes between this knot and others, each with what runs there for a set
        that the region stores; each as likely as the likeliest.
    by_loads : they follow from all samples, under a load that wanders: it explains what swung.
    """

    processes: tuple[LinearProcess, ...] = ()
    filter_s: float = 0.0
    between: tuple[tuple[LinearProcess, Callable[[PidGains], PidGains]], ...] = ()
    weights: tuple[float, ...] = ()
    by_loads: bool = False

    def ms(self, stored: PidGains) -> tuple[float, ...]:
        """Ms on each model, infinite where unstable."""
        alone = [sensitivity_peak(process, stored, self.filter_s) for process in self.processes]
        mixed = [sensitivity_peak(process, runs(stored), self.filter_s) for process, runs in self.between]
        return (*alone, *mixed)

    def likely(self) -> tuple[float, ...]:
        """Weight of each model, their sum 1."""
        alone = self.weights or (1.0,) * len(self.processes)
        all_of_them = (*alone, *(max(alone) for _ in self.between))
        return tuple(weight / sum(all_of_them) for weight in all_of_them)

    def unstable(self, stored: PidGains) -> float:
        """Probability that the loop is unstable."""
        return math.fsum(map(mul, self.likely(), map(math.isinf, self.ms(stored))))


NOTHING_KNOWN = StillAllowed()


def robustness(each: Sequence[float]) -> tuple[float, int]:
    """The greatest Ms where the loop is stable, and on how many models it is not. each : Ms on each model."""
    finite = [ms for ms in each if math.isfinite(ms)]
    return max(finite, default=0.0), len(each) - len(finite)


@dataclass(frozen=True, slots=True)
class RollbackNumbers(Numbers):
    """models : how many were asked. ms_* : greatest where stable; unstable_* : on so many models.
    something_else : probability that none of the models is behind what was seen.
    """

    models: float
    ms_tried: float
    unstable_tried: float
    ms_before: float
    unstable_before: float
    something_else: float = 0.0


class SetsThatRan(NamedTuple):
    """before : the set before the trial. tried : None while it is not known to have run. earlier : the newest first.

    swung : ratio of successive peaks seen under the set before, None when none was. swings : the same, or else what the
    models predicted on which the change was proved. unstable_before : they called the set before unstable, and the
    tried one not. left_range : pv left its range under the tried set only.
    """

    before: PidGains
    tried: PidGains | None
    earlier: tuple[PidGains, ...] = ()
    swung: float | None = None
    swings: float = 0.0
    unstable_before: bool = False
    left_range: bool = False


class Rollback(NamedTuple):
    """gains : the set that is to run. stays : it is the tried one. reason : why, empty where nothing was weighed."""

    gains: PidGains
    stays: bool
    reason: str = ""
    numbers: RollbackNumbers | None = None


class SetRecord(NamedTuple):
    """How often one set was bad and calm, and the chance that what was seen is not its doing."""

    bad: int = 0
    calm: int = 0
    by_loads: float = BY_LOADS

    def likelihood(self, loss: float) -> float:
        """Likelihood of the record on a model on which the set has this loss."""
        bad = self.by_loads + (1.0 - 2.0 * self.by_loads) * loss
        return bad**self.bad * (1.0 - bad) ** self.calm

    @property
    def chance(self) -> float:
        """The chance that the set is bad, where no model says: rule of succession."""
        return (1.0 + self.bad) / (2.0 + self.bad + self.calm)


def rollback(cause: TrialEvent, ran: SetsThatRan, known: StillAllowed, settings: TrialSettings) -> Rollback:
    """Which set is to run after a cause that ends trials; see the head of this file."""
    swung = ran.swung is not None and ran.swung >= SWINGS_ON
    left, swung = ran.left_range and not (swung or ran.unstable_before), swung and not known.by_loads
    if ran.tried is None or ran.tried == ran.before:
        return Rollback(ran.before, stays=False)
    if cause is TrialEvent.ORDERED_BACK:
        why = unstable_again(ran, known)
        return Rollback(ran.tried if why else ran.before, bool(why), why)
    stays = cause not in ROLLBACK_CAUSES and (known.processes or cause is TrialEvent.TIMED_OUT)
    sets = [ran.tried, ran.before] if stays else [ran.before, ran.tried]
    ms = {gains: known.ms(gains) for gains in (*sets, *ran.earlier)}
    worked = SetRecord(0, ran.swings <= settings.harmless_decay, CHANGED)
    now = SetRecord(cause in ROLLBACK_CAUSES, cause is TrialEvent.TIMED_OUT, BY_LOADS_AFTER.get(cause, BY_LOADS))
    seen = {ran.before: SetRecord(1) if swung else worked, ran.tried: now}
    expected, else_ = expected_losses(ms, known.likely(), seen, settings.harmless_ms)
    shut = {one for one in ms if less_stable(one, ran.tried, known, settings.harmless_ms)}
    shut |= {ran.before} if ran.unstable_before and not known.processes else set()
    open_to = [ran.before] if left else [gains for gains in ms if gains not in shut]
    runs = sets[0] if sets[0] in open_to else ran.tried
    for other in open_to:
        runs = other if expected[other] < expected[runs] - PRICE else runs
    numbers = None
    if known.processes:
        tried, before = ms[ran.tried], ms[ran.before]
        numbers = RollbackNumbers(len(tried), *robustness(tried), *robustness(before), else_)
    return Rollback(runs, runs == ran.tried, _words(cause, numbers, runs, ran, settings), numbers)


def less_stable(to: PidGains, present: PidGains, known: StillAllowed, harmless_ms: float) -> str:
    """Why a set does not come back in place of the present one, by Ms on the allowed models; empty where it may.

    It is likelier to be unstable, or its expected loss is greater, by more than the price of a change. Where both are
    unstable on all of them Ms does not tell: then it must not act more in everything.
    """
    models = len(known.processes) + len(known.between)
    if not models or to == present:
        return ""
    each = [known.ms(gains) for gains in (to, present)]
    there, here = (robustness(ms) for ms in each)
    goes, stays = (sum(w * loss_of(one, harmless_ms) for w, one in zip(known.likely(), ms, strict=True)) for ms in each)
    neither = there[1] == here[1] == models and less_of_everything(to, present)
    if not (goes > stays + PRICE or known.unstable(to) > known.unstable(present) + PRICE or neither):
        return ""
    return (
        f"they are less stable on {models_words(models)}: {robustness_words(*there, models)}, "
        f"active gains {robustness_words(*here, models)}"
    )


def unstable_again(ran: SetsThatRan, known: StillAllowed) -> str:
    """Why not even a person's order leads back to the set before; empty where it does.

    A larger Ms is his to choose, a loop that is likelier to be unstable is not: he may set such gains by hand.
    """
    if ran.tried is None:
        return ""
    there = known.unstable(ran.before)
    if there > known.unstable(ran.tried) + PRICE:
        return f"the previous gains would be unstable with {there:.0%} probability"
    return UNSTABLE_BEFORE if ran.unstable_before and not known.processes else ""


UNSTABLE_BEFORE = "the previous gains were unstable on the model on which the trial gains were proved"
"""Why a set does not come back where no model is left."""


def loss_of(ms: float, harmless_ms: float) -> float:
    """Share of the distance to instability that is lost."""
    return 1.0 - harmless_ms / max(ms, harmless_ms)


def expected_losses(
    ms: Mapping[PidGains, Sequence[float]],
    likely: Sequence[float],
    seen: Mapping[PidGains, SetRecord],
    harmless_ms: float,
) -> tuple[dict[PidGains, float], float]:
    """The expected loss of each set, and the probability of something else; see the head of this file.

    ms : of each set on each model. likely : of each model. seen : of those sets of which anything was.
    """
    losses = {gains: [loss_of(one, harmless_ms) for one in row] for gains, row in ms.items()}
    weights = [
        (1.0 - SOMETHING_ELSE) * weight * math.prod(one.likelihood(losses[gains][i]) for gains, one in seen.items())
        for i, weight in enumerate(likely)
    ]
    else_ = SOMETHING_ELSE * math.prod(0.5 ** (one.bad + one.calm) for one in seen.values())
    whole = sum(weights) + else_
    expected = {}
    for gains, row in losses.items():
        less = [one for other, one in seen.items() if one.bad and less_of_everything(gains, other)]
        chance = max(one.chance for one in (seen.get(gains, SetRecord()), *less))
        expected[gains] = (sum(w * x for w, x in zip(weights, row, strict=True)) + else_ * chance) / whole
    return expected, else_ / whole


def _words(
    cause: TrialEvent, found: RollbackNumbers | None, runs: PidGains, ran: SetsThatRan, settings: TrialSettings
) -> str:
    """The reason for people; empty where nothing was weighed and the set before runs, as is usual then."""
    if found is None and runs == ran.before:
        return ""
    if found is None and cause is TrialEvent.TIMED_OUT:
        return "no response spoke against the trial gains"
    if found is None and ran.unstable_before:
        return UNSTABLE_BEFORE
    if found is None:
        return f"the previous gains kept oscillating (half-cycle decay ratio {ran.swung or math.nan:.2f})"
    tried = robustness_words(found.ms_tried, found.unstable_tried, found.models)
    before = robustness_words(found.ms_before, found.unstable_before, found.models)
    words = f"over {models_words(found.models)}: trial gains {tried}, previous gains {before}"
    robust = max(found.ms_tried, found.ms_before) <= settings.harmless_ms
    if robust and not (found.unstable_tried or found.unstable_before):
        words += f"; both are robust (up to {settings.harmless_ms:g})"
    worst_against = (found.unstable_tried, found.ms_tried) > (found.unstable_before, found.ms_before)
    if cause in ROLLBACK_CAUSES and runs == ran.tried and worst_against:
        words += "; by how likely each is, the trial gains lose less"
    if found.something_else > SOMETHING_ELSE:
        words += f"; {found.something_else:.0%} chance that something else explains this"
    return words if runs in {ran.before, ran.tried} else f"{words}; an earlier set is expected to be best"


def models_words(models: float) -> str:
    """How many are asked."""
    return "the one plausible model" if models == 1 else f"the {models:.0f} plausible models"


def robustness_words(ms: float, unstable: float, models: float) -> str:
    """What is said of one set."""
    if unstable == models:
        return "unstable"
    some = f"unstable on {unstable:.0f}, otherwise " if unstable else ""
    return f"{some}Ms at most {ms:.2f}"
