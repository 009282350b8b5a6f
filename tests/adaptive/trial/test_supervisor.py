"""The trials of a loop: entering the restoring phase puts the verified set back, whatever led there."""

import json
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from rig import GOOD, PROMISE, Rig, responses

from retuner import LinearProcess, PidGains
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopMode, LoopSample, Window
from retuner.adaptive.trial.judge import JudgedResponse, Judgement, TrialFinding, TrialNumbers
from retuner.adaptive.trial.phase import ABORTS, ROLLBACK_CAUSES, UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, SetsThatRan, StillAllowed, rollback
from retuner.adaptive.trial.supervisor import DECIDED, WITH_GAINS, TrialSupervisor
from retuner.adaptive.trial.trial_settings import TrialSettings

P, E = TrialPhase, TrialEvent
OLD, NEW, PERSONS = PidGains(1.0, 0.1), PidGains(2.0, 0.2), PidGains(1.5, 0.1)
KNOWN = StillAllowed((LinearProcess(1.0, (10.0,), (), 1.0),))  # on which all of them are robust
STAYS = (P.PAUSED, P.ENSURING)  # Phases that only a set comes into that stays by what is known
TAU_I_S = 10.0


@dataclass
class Bench:
    """The trials, the table that it puts sets back into, and the way into every phase."""

    trial_settings: TrialSettings = field(default_factory=TrialSettings)
    table: dict[int, PidGains] = field(default_factory=lambda: {0: OLD, 1: OLD})
    t_s: float = 0.0
    known: StillAllowed = NOTHING_KNOWN
    asks: bool = False

    def __post_init__(self) -> None:
        self.trials = TrialSupervisor(
            self.trial_settings, 1.0, self.table.__setitem__, lambda _: self.known, lambda _: self.asks
        )

    def write(self, region: int = 0, new: PidGains = NEW) -> None:
        self.trials.begin(region, self.table[region], new, PROMISE, self.t_s)
        if self.trials.written(region, new, self.t_s):
            self.table[region] = new

    def edit(self, gains: PidGains) -> None:
        self.trials.edited(0, gains, self.table[0], self.t_s)
        self.table[0] = gains

    def undo(self, cause: TrialEvent = E.WORSE) -> None:
        self.write()
        self.trials.event(0, cause, self.t_s)
        self.trials.restored(self.t_s)

    def into(self, phase: TrialPhase) -> None:
        if phase is P.WRITING:
            self.trials.begin(0, OLD, NEW, PROMISE, self.t_s)
        elif phase in {P.TRIAL, P.AWAY, P.WAITING, P.RESTORING}:
            self.write()
            step = {P.AWAY: E.LEFT, P.WAITING: E.PASSED_FOR_APPROVAL, P.RESTORING: E.WORSE}
            if phase in step:
                self.trials.event(0, step[phase], self.t_s)
        elif phase in {P.PAUSED, P.ENSURING}:
            self.write()
            self.trials.event(0, E.MANUAL if phase is P.PAUSED else E.LINK_LOST, self.t_s)
        elif phase is P.HELD:
            self.edit(PERSONS)
        elif phase is P.COOLING:
            self.undo()
        elif phase is P.LOCKED:
            while self.trials.phase(0) is not P.LOCKED:
                self.undo()
                self.t_s += 1e6
        assert self.trials.phase(0) is phase


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("phase", [p for p in TrialPhase if p not in STAYS], ids=lambda p: p.name)
@pytest.mark.parametrize("cause", [c for c in ABORTS if c is not E.TIMED_OUT], ids=lambda c: c.name)
def test_with_nothing_known_every_cause_in_every_phase_ends_on_the_set_that_was_seen_to_work(bench, phase, cause):
    bench.into(phase)
    now = bench.table[0] if phase in {P.WAITING, P.HELD} else OLD
    bench.trials.event(0, cause, bench.t_s)
    verified = OLD if phase is P.WAITING and cause is E.ORDERED_BACK else now
    assert bench.table[0] == verified
    assert bench.trials.phase(0) not in UNDECIDED
    assert (bench.trials.phase(0) is P.RESTORING) == (
        phase in {*UNDECIDED, P.RESTORING} or (phase is P.WAITING and cause is E.ORDERED_BACK)
    )
    bench.trials.restored(bench.t_s)
    assert not bench.trials.restoring
    assert bench.table[0] == verified


def test_with_nothing_known_responses_that_say_nothing_leave_the_set_that_they_ran_under(bench: Bench) -> None:
    bench.write()
    for _ in range(bench.trial_settings.inconclusive):
        bench.trials.silent(0, Judgement(TrialFinding.INCONCLUSIVE, "too small", TrialNumbers(1.0)), bench.t_s)
    assert bench.table[0] == NEW
    assert bench.trials.phase(0) is P.IDLE
    back = bench.trials.of(0).back
    assert back.reason == "no response spoke against the trial gains"


@pytest.mark.parametrize(("by_loads", "stays"), [(True, True), (False, False)])
def test_a_swing_that_all_samples_give_to_loads_brings_back_no_earlier_set(by_loads: bool, stays: bool) -> None:
    earlier = PidGains(0.25 * OLD.kp, 0.25 * OLD.ki)
    ran = SetsThatRan(OLD, NEW, (earlier,), swung=0.95, swings=0.9)
    found = rollback(E.TIMED_OUT, ran, KNOWN._replace(by_loads=by_loads), TrialSettings())
    assert found.stays is stays
    assert found.gains == (NEW if stays else earlier)


def test_a_swing_of_the_set_before_brings_back_no_earlier_one_where_the_tried_set_is_robust_by_all_samples() -> None:
    """Under a tone a loop went from J 1.5 back to 4.5 although the judge had just held its set for robust."""
    bench = Bench(table={0: PidGains(0.25 * OLD.kp, 0.25 * OLD.ki)})
    bench.edit(OLD)
    bench.t_s = 1e9
    swung = replace(PROMISE, decay_seen=0.95)
    bench.trials.begin(0, OLD, NEW, swung, bench.t_s)
    assert bench.trials.written(0, NEW, bench.t_s)
    bench.table[0] = NEW
    for _ in range(bench.trial_settings.inconclusive):
        silent = Judgement(TrialFinding.INCONCLUSIVE, "a tone", TrialNumbers(1.0))
        bench.trials.silent(0, silent, bench.t_s, robust=True)
    assert bench.trials.of(0).earlier
    assert bench.table[0] == NEW


@pytest.mark.parametrize(("asks", "phase"), [(False, P.IDLE), (True, P.TRIAL)])
def test_a_safer_change_that_is_due_ends_a_trial_that_no_person_has_to_approve(asks: bool, phase: TrialPhase) -> None:
    bench = Bench(asks=asks)
    bench.write()
    response = Response(0.0, 50.0, (Peak(5.0, 0.01),), Ending.QUIET, sp_changed=True, band=0.1)
    window = Window(*(np.arange(60.0) + shift for shift in (-5.0, 0.0, 0.0, 0.0)))
    seen = JudgedResponse(response, window, next_due=True)
    found = bench.trials.judge(0, seen, NEW, 60.0, ask=asks)
    assert ("another change is due" in found.reason) is not asks
    assert bench.trials.phase(0) is phase
    assert bench.table[0] == NEW


@pytest.mark.parametrize("cause", [c for c in ABORTS if c is not E.TIMED_OUT], ids=lambda c: c.name)
def test_a_write_that_comes_through_after_all_is_not_taken_for_a_trial(bench: Bench, cause: TrialEvent) -> None:
    bench.into(P.WRITING)
    assert bench.trials.abort(cause, 1.0) == (0,)
    assert not bench.trials.written(0, NEW, 2.0)
    assert bench.trials.phase(0) is P.RESTORING
    assert bench.table[0] == OLD


def test_the_cool_down_doubles_with_each_undo_and_a_region_is_locked_after_too_many() -> None:
    bench, base = Bench(), TrialSettings().cool_down_tau_i * TAU_I_S
    for doubled in (1.0, 2.0):
        bench.undo()
        assert not bench.trials.may_change(0, bench.t_s + doubled * base - 1.0)
        bench.t_s += doubled * base
        assert bench.trials.may_change(0, bench.t_s)
    bench.undo()
    assert bench.trials.phase(0) is P.LOCKED
    assert not bench.trials.may_change(0, 1e12)
    assert not bench.trials.may_change(0, 1e12, urgent=True)
    assert bench.trials.may_change(1, bench.t_s)
    bench.trials.event(0, E.UNLOCKED, bench.t_s)
    assert bench.trials.may_change(0, bench.t_s)
    assert bench.trials.of(0).rollbacks == 0


@pytest.mark.parametrize("cause", [c for c in ABORTS if c not in ROLLBACK_CAUSES], ids=lambda c: c.name)
def test_what_does_not_speak_against_the_set_neither_doubles_nor_locks(bench: Bench, cause: TrialEvent) -> None:
    for _ in range(10):
        bench.undo(cause)
        bench.t_s = bench.trials.of(0).until_s
        assert bench.trials.may_change(0, bench.t_s)
    assert bench.trials.of(0).rollbacks == 0


def test_an_urgent_change_need_not_wait_for_the_cool_down(bench: Bench) -> None:
    bench.undo()
    assert not bench.trials.may_change(0, bench.t_s)
    assert bench.trials.may_change(0, bench.t_s, urgent=True)
    bench.trials.begin(0, OLD, NEW, PROMISE, bench.t_s, urgent=True)
    assert bench.trials.phase(0) is P.WRITING
    assert bench.trials.of(0).rollbacks == 1


def test_passing_resets_the_count_and_a_person_has_the_next_word_where_asked() -> None:
    seen = responses(Rig(GOOD), 300, load=10.0)[0]
    bench = Bench()
    bench.undo()
    bench.t_s = 1e5
    bench.write(new=GOOD)
    assert bench.trials.judge(0, seen, GOOD, bench.t_s, ask=True).finding is not TrialFinding.WORSE
    assert bench.trials.phase(0) is P.WAITING
    assert bench.table[0] == GOOD
    assert bench.trials.of(0).rollbacks == 0
    assert not bench.trials.may_change(0, 1e9)
    bench.trials.event(0, E.APPROVED, bench.t_s)
    bench.write(new=GOOD)
    bench.trials.judge(0, seen, GOOD, bench.t_s, ask=False)
    assert bench.trials.phase(0) is P.IDLE
    assert bench.trials.judge(0, seen, GOOD, bench.t_s, ask=False) is None


def test_several_responses_may_have_to_keep_the_promise() -> None:
    seen = responses(Rig(GOOD), 300, load=10.0)[0]
    bench = Bench(TrialSettings(responses=3))
    bench.write(new=GOOD)
    for phase in (P.TRIAL, P.TRIAL, P.IDLE):
        bench.trials.judge(0, seen, GOOD, 1.0, ask=False)
        assert bench.trials.phase(0) is phase


def sample(t_s: float, **values: float) -> LoopSample:
    return LoopSample(t_s, 0.0, 0.0, 0.0)._replace(**values)


def look(bench: Bench, s: LoopSample, region: int = 0, elapsed_s: float = 1.0, *, blended: bool = False) -> object:
    return bench.trials.watch(s, region, 0.1, elapsed_s, 5.0, blended=blended)


def test_a_trial_waits_while_the_loop_is_elsewhere_unless_the_table_interpolates(bench: Bench) -> None:
    bench.write()
    assert look(bench, sample(1.0), region=1) == {}
    assert bench.trials.phase(0) is P.AWAY
    assert bench.trials.may_change(1, 1.0)
    assert look(bench, sample(2.0), region=0) == {}
    assert bench.trials.phase(0) is P.TRIAL
    assert look(bench, sample(3.0), region=1, blended=True) == {0: E.LEFT_INTERPOLATED}
    assert bench.table[0] == OLD


def test_a_write_that_is_done_when_the_loop_has_left_waits_for_its_return(bench: Bench) -> None:
    bench.trials.begin(0, OLD, NEW, PROMISE, 0.0)
    look(bench, sample(1.0), region=1)
    assert bench.trials.written(0, NEW, 1.0)
    assert bench.trials.phase(0) is P.AWAY


def test_one_write_at_a_time() -> None:
    for phase in (P.WRITING, P.RESTORING, P.ENSURING):
        bench = Bench(known=KNOWN if phase in STAYS else NOTHING_KNOWN)
        bench.into(phase)
        assert not bench.trials.may_change(1, 0.0)
        with pytest.raises(ValueError, match="may not be changed now"):
            bench.trials.begin(1, OLD, NEW, PROMISE, 0.0)


@pytest.mark.parametrize("phase", TrialPhase, ids=lambda p: p.name)
def test_a_restart_of_the_host_goes_on_where_it_stood(phase: TrialPhase) -> None:
    bench, other = (Bench(known=KNOWN if phase in STAYS else NOTHING_KNOWN) for _ in range(2))
    bench.into(phase)
    look(bench, sample(bench.t_s + 1.0, pv=3.0))
    other.trials.resume(json.loads(json.dumps(bench.trials.to_dict(), allow_nan=False)))
    assert other.trials.to_dict() == bench.trials.to_dict()
    assert other.trials.of(0) == bench.trials.of(0)
    assert other.trials.busy == bench.trials.busy


@pytest.mark.parametrize("event", WITH_GAINS)
def test_what_comes_with_gains_has_a_door_of_its_own(event: TrialEvent) -> None:
    with pytest.raises(ValueError, match="comes with gains"):
        Bench().trials.event(0, event, 0.0)


@pytest.mark.parametrize("event", DECIDED)
def test_what_is_decided_is_not_told(event: TrialEvent) -> None:
    with pytest.raises(ValueError, match="tell the cause"):
        Bench().trials.event(0, event, 0.0)


@pytest.mark.parametrize(("cause", "refuted"), [(E.ORDERED_BACK, False), (E.WORSE, True)])
def test_a_region_is_idle_after_its_cool_down_but_not_for_gains_like_those_that_were_refuted(bench, cause, refuted):
    bench.into(P.TRIAL)
    bench.trials.event(0, cause, 0.0)
    bench.trials.restored(0.0)
    until_s = bench.trials.of(0).until_s
    assert not bench.trials.idle(0, until_s - 1.0)
    assert bench.trials.idle(0, until_s) is not refuted
    assert bench.trials.phase(0) is P.IDLE


@pytest.mark.parametrize(("mode", "elapsed_s"), [(LoopMode.MANUAL, 1.0), (LoopMode.AUTO, 100.0)])
@pytest.mark.parametrize(("region", "blended"), [(1, False), (1, True), (0, False), (None, False)])
def test_manual_and_gaps_do_not_end_the_trial_of_a_set_that_does_not_run(bench, mode, elapsed_s, region, blended):
    bench.trials.watch(LoopSample(0.0, 1.0, 1.0, 1.0), 1, 0.1, 1.0, 3.0, blended=False)
    bench.into(P.AWAY)
    sample = LoopSample(100.0, 1.0, 1.0, 1.0, mode)
    ended = bench.trials.watch(sample, region, 0.1, elapsed_s, 3.0, blended=blended)
    stays = region == 1 and not blended
    assert bool(ended) is not stays
    assert (bench.table[0] == NEW) is stays
    assert (bench.trials.phase(0) is P.AWAY) is stays
