"""Phases, causes and whatever else may happen, one after the other in every order: what runs is never less robust.

A region of two is put into each undecided phase; then two things happen to it or to the other region, in every order
(slow), and with hypothesis up to a dozen. After each of them what is to run is compared with what was to run before it.
"""

import itertools
import json
import math
from collections.abc import Callable
from functools import cache, partial

import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner import LinearProcess, LoopMode, LoopSample, PidGains, ProcessModel, ProcessType
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.trial.judge import Judgement, TrialFinding, TrialNumbers
from retuner.adaptive.trial.phase import ABORTS, ROLLBACK_CAUSES, SILENT, TO_BE_SEEN, UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.prediction import Prediction, predict
from retuner.adaptive.trial.rollback import StillAllowed
from retuner.adaptive.trial.supervisor import TrialSupervisor
from retuner.adaptive.trial.trial import Trial
from retuner.adaptive.trial.trial_settings import TrialSettings

P, E = TrialPhase, TrialEvent
PROCESSES = (LinearProcess(1.0, (50.0,), (), 5.5), LinearProcess(1.6, (50.0,), (), 5.5))
RIGHT, WEAK = PidGains(3.0, 0.07), PidGains(1.0, 0.02)
SWINGING, UNSTABLE = PidGains(9.5, 0.3), PidGains(20.0, 0.5)
PERSONS = PidGains(2.0, 0.05)
HARMLESS = TrialSettings().harmless_ms
PAIRS = [(RIGHT, SWINGING), (SWINGING, RIGHT), (UNSTABLE, RIGHT), (WEAK, RIGHT), (SWINGING, UNSTABLE), (RIGHT, WEAK)]
"""The set before and the tried one."""


@cache
def ms(process: LinearProcess, gains: PidGains) -> float:
    return sensitivity_peak(process, gains)


class Known(StillAllowed):
    """Models, with Ms looked up."""

    def ms(self, stored: PidGains) -> tuple[float, ...]:
        return tuple(ms(process, stored) for process in self.processes)


@cache
def said(old: PidGains, tried: PidGains) -> Prediction:
    return predict([Plausible(ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0), 0.0)], old, tried, 1.0)


class World:
    """Two regions, the table, and everything that may happen."""

    def __init__(self, phase: TrialPhase, old: PidGains, tried: PidGains, known: StillAllowed, *, asks: bool) -> None:
        self.known, self.asks, self.t_s = known, asks, 1.0
        self.table = {0: old if phase is P.WRITING else tried, 1: old}
        ran = phase is not P.WRITING
        trial = Trial(phase, old, tried, said(old, tried), ran, cause=None if phase is P.TRIAL else E.GAP)
        self.begin({"at": 0, "trials": {"0": trial.to_dict()}})
        self.fresh = False
        """Whether the last thing was somebody's choice, which no model had to be asked about."""

    def begin(self, body: dict[str, object]) -> None:
        """A session with this memory."""
        self.trials = TrialSupervisor(
            TrialSettings(inconclusive=2), 1.0, self.table.__setitem__, lambda _: self.known, lambda _: self.asks
        )
        self.trials.resume(json.loads(json.dumps(body)))

    def cause(self, region: int, cause: TrialEvent) -> None:
        self.fresh = cause is E.ORDERED_BACK
        self.trials.event(region, cause, self.t_s)

    def ends(self) -> None:
        self.trials.abort(E.STOPPED, self.t_s)

    def restart(self) -> None:
        self.begin(self.trials.to_dict())

    def sample(self, elapsed_s: float = 1.0, region: int = 0, limited: int = 0, mode: LoopMode = LoopMode.AUTO) -> None:
        self.t_s += elapsed_s
        seen = LoopSample(self.t_s, 1.0, 0.0, 0.0, mode, limited, 1.0, 0)
        self.trials.watch(seen, region, 0.01, elapsed_s, 50.0, blended=False)

    def at_limit(self) -> None:
        for _ in range(4):
            self.sample(elapsed_s=40.0 * 50, limited=1)

    def restored(self) -> None:
        self.trials.restored(self.t_s)

    def later(self) -> None:
        self.t_s += 1e6
        self.trials.may_change(0, self.t_s)

    def written(self, region: int) -> None:
        """The write under way is read back; also one that was given up."""
        trial = self.trials.of(region)
        if trial.new is not None and not trial.ran:
            stays = self.trials.written(region, trial.new, self.t_s)
            given_up = trial.phase is P.RESTORING and trial.cause not in ROLLBACK_CAUSES
            assert not stays or trial.phase is P.WRITING or given_up, f"{trial.phase}: nothing was written there"
            self.fresh = stays
            if stays:
                self.table[region] = trial.new

    def edited(self) -> None:
        self.fresh = True
        self.trials.edited(0, PERSONS, self.table[0], self.t_s)
        self.table[0] = PERSONS

    def silent(self) -> None:
        self.trials.silent(0, Judgement(TrialFinding.INCONCLUSIVE, "noise", TrialNumbers(1.0)), self.t_s)

    def passed(self) -> None:
        self.trials.event(0, E.PASSED_FOR_APPROVAL if self.asks else E.PASSED, self.t_s)

    def proposed(self, region: int) -> None:
        """A change is asked for wherever it may be: never while another one is being written or put back."""
        if not self.trials.may_change(region, self.t_s):
            return
        phases = [self.trials.phase(at) for at in (0, 1)]
        assert not {P.WRITING, *TO_BE_SEEN} & set(phases), phases
        self.trials.begin(region, self.table[region], RIGHT, said(self.table[region], RIGHT), self.t_s)


HAPPENS: dict[str, Callable[[World], None]] = {
    **{cause.name: partial(World.cause, region=0, cause=cause) for cause in ABORTS},
    "ends": World.ends,
    "session restarts": World.restart,
    "sample": World.sample,
    "manual": partial(World.sample, mode=LoopMode.MANUAL),
    "gap": partial(World.sample, elapsed_s=200.0),
    "elsewhere": partial(World.sample, region=1),
    "at a limit": World.at_limit,
    "restored": World.restored,
    "later": World.later,
    "written": partial(World.written, region=0),
    "other written": partial(World.written, region=1),
    "edited": World.edited,
    "silent": World.silent,
    "passed": World.passed,
    "proposed": partial(World.proposed, region=0),
    "other proposed": partial(World.proposed, region=1),
    "other runs away": partial(World.cause, region=1, cause=E.RUNAWAY),
}
ASKED = {cause.name for cause in SILENT}  # After these it is asked which of the two sets is the more robust
KNOWN = {"one model": Known(PROCESSES[:1]), "two models": Known(PROCESSES), "none": Known(())}


def robustness(gains: PidGains, models: list[LinearProcess]) -> tuple[int, float]:
    """On how many models it is unstable, and the greatest Ms on the others; up to HARMLESS all are alike."""
    found = [ms(process, gains) for process in models]
    finite = [value for value in found if math.isfinite(value)]
    return len(found) - len(finite), max([HARMLESS, *finite])


def do(world: World, name: str) -> None:
    """One thing; and what runs after it is held against what ran before it."""
    before, trials = dict(world.table), {at: world.trials.of(at) for at in (0, 1)}
    world.fresh = False
    HAPPENS[name](world)
    for at, was in before.items():
        now, trial, refuted = world.table[at], trials[at], name in {cause.name for cause in ROLLBACK_CAUSES}
        undecided = trial.phase in UNDECIDED and trial.ran
        silent = undecided and not refuted and not world.fresh and world.known.processes and was == trial.new
        if silent and robustness(was, list(PROCESSES)) == (0, HARMLESS):
            assert now == was, f"{name} says nothing of a robust set, and took it away"
        again = world.trials.of(at)
        if again.phase is P.RESTORING and again.back is not None:
            assert now == again.back.gains, "what was decided is not what the table has"
        models = [p for p in world.known.processes if not refuted or ms(p, was) > HARMLESS]
        if name in ASKED and at == 0 and trial.phase is P.TRIAL and was == trial.new and trial.old and models:
            best = min(robustness(one, models) for one in (trial.old, was))
            assert robustness(now, models) <= best, f"{name}: the less robust of two sets stays"
        if now == was or world.fresh:
            continue
        assert now in {trial.old, trial.new, *trial.earlier}, f"{name}: a set that never ran"
        assert robustness(now, models) <= robustness(was, models), f"{name}: {was} -> {now}"
        assert world.trials.phase(at) in TO_BE_SEEN, "what is to run must be seen to run"


@pytest.mark.slow
@pytest.mark.parametrize("known", KNOWN)
@pytest.mark.parametrize("phase", UNDECIDED, ids=lambda p: p.name)
def test_everything_that_may_happen_in_every_phase(phase: TrialPhase, known: str) -> None:
    for pair, name in itertools.product(PAIRS, HAPPENS):
        do(World(phase, *pair, KNOWN[known], asks=False), name)


@pytest.mark.slow
@pytest.mark.uncounted
@pytest.mark.parametrize("phase", UNDECIDED, ids=lambda p: p.name)
def test_two_things_in_every_order(phase: TrialPhase) -> None:
    for pair, first, second in itertools.product(PAIRS[:2], HAPPENS, HAPPENS):
        world = World(phase, *pair, KNOWN["two models"], asks=False)
        do(world, first)
        do(world, second)


@settings(max_examples=examples(300))
@given(
    st.sampled_from(UNDECIDED),
    st.sampled_from(PAIRS),
    st.sampled_from(sorted(KNOWN)),
    st.booleans(),
    st.lists(st.sampled_from(sorted(HAPPENS)), min_size=3, max_size=12),
)
def test_many_things_in_any_order(phase, pair, known, asks, names):
    world = World(phase, *pair, KNOWN[known], asks=asks)
    for name in names:
        do(world, name)
