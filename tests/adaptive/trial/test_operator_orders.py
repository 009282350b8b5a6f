"""What people order: proved again, whole or not at all, on trial or the way back; and why not."""

import itertools
import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import BAD, GOOD, MODEL, PROMISE, Rig

from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.orders.operator_orders import (
    accept,
    approve,
    approve_proposal,
    found_running,
    propose,
    revert,
    unlock,
)
from retuner.adaptive.orders.pending_proposal import Proposal, ProposalStanding
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.region_model.from_neighbours import spread
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Action, Decision, Mode, Outcome
from retuner.adaptive.supervision.known_processes import KnownProcesses, known_of
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.adaptive.trial import rollback
from retuner.adaptive.trial.phase import SILENT, UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.prediction import predict
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

P, E = TrialPhase, TrialEvent
SLOW = PidGains(GOOD.kp / 3, GOOD.ki / 3)
BETTER = PidGains(GOOD.kp / 1.6, GOOD.ki / 1.6)
OFFERED = Proposal("ab" * 32, 3, "all", 100.0, SLOW, BETTER, PROMISE.to_dict())


class Bench:
    """A loop on sluggish gains in advise mode; the retuner has seen some samples, and responses if asked to."""

    def __init__(self, gains: PidGains = SLOW, *, taught: bool = False) -> None:
        table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (gains,))
        self.retuner = Retuner(table, RetunerSettings(1.0, 100.0, Mode.ADVISE, band=0.1))
        self.rig = Rig(gains, noise=0.02)
        self.decisions: list[Decision] = list(self.run(60))
        if taught:
            self.rig.sp = 10.0
            self.decisions += itertools.islice(self.run(3000), 1)

    def run(self, samples: int) -> Iterator[Decision]:
        for sample in self.rig.run(samples):
            decision = self.retuner.observe(sample)
            if decision is not None:
                yield decision

    @property
    def t_s(self) -> float:
        return self.rig.t_s


def test_an_approved_proposal_is_written_as_it_was_and_on_trial() -> None:
    bench = Bench(taught=True)
    offered = Proposal.of(bench.decisions[0])
    assert offered.digest == bench.decisions[0].digest()
    again = Proposal.from_dict(offered.to_dict())
    decision = approve(bench.retuner, again, bench.t_s)
    assert (decision.action, decision.code) == (Action.WRITE, "approved")
    assert decision.gains_after == offered.after
    assert decision.proof.accepted
    assert bench.retuner.trials.phase(0) is P.WRITING
    bench.retuner.committed(0, offered.after)
    assert bench.retuner.trials.phase(0) is P.TRIAL
    assert bench.retuner.trials.of(0).old == SLOW
    assert approve(bench.retuner, again, bench.t_s).code == "approval_refused"


def test_a_persons_own_gains_are_proposed_where_the_guard_proves_them_whole() -> None:
    bench = Bench(taught=True)
    own = PidGains(SLOW.kp * 1.2, SLOW.ki * 1.2)
    decision = propose(bench.retuner, 0, own, bench.t_s)
    assert (decision.action, decision.code, decision.gains_after) == (Action.ADVISE, "order_proposed", own)
    offered = Proposal.of(decision)
    assert offered is not None
    assert bench.retuner.table.gains[0] == SLOW
    written = approve(bench.retuner, offered, bench.t_s)
    assert (written.action, written.gains_after) == (Action.WRITE, own)


@pytest.mark.parametrize(
    ("factor", "taught", "told"),
    [(1.2, False, "not known yet"), (3.9, True, "smaller change is proved now: kp"), (-1.0, True, "opposite")],
)
def test_a_persons_own_gains_are_refused_with_the_reason(factor: float, taught: bool, told: str) -> None:
    bench = Bench(taught=taught)
    decision = propose(bench.retuner, 0, PidGains(SLOW.kp * factor, SLOW.ki * factor), bench.t_s)
    assert (decision.action, decision.code, decision.gains_after) == (Action.NONE, "order_refused", None)
    assert told in decision.reason


def test_a_proposal_of_an_earlier_session_is_held_to_the_limits_per_change() -> None:
    assert approve(Bench().retuner, OFFERED, 60.0).action is Action.WRITE
    far = replace(OFFERED, after=PidGains(SLOW.kp * 5, SLOW.ki * 5))
    refused = approve(Bench().retuner, far, 60.0)
    assert refused.action is Action.NONE
    assert "outside the present limits" in refused.reason


def test_less_of_everything_is_not_held_to_the_limits_per_change() -> None:
    calmer = replace(OFFERED, after=PidGains(SLOW.kp / 30, SLOW.ki / 30))
    written = approve(Bench().retuner, calmer, 60.0)
    assert (written.action, written.gains_after) == (Action.WRITE, calmer.after)
    mixed = replace(OFFERED, after=PidGains(SLOW.kp / 30, SLOW.ki * 5))
    assert approve(Bench().retuner, mixed, 60.0).action is Action.NONE


def test_what_is_known_now_decides_and_not_what_was_known() -> None:
    bench = Bench(taught=True)
    wild = replace(OFFERED, after=PidGains(SLOW.kp * 1.9, SLOW.ki * 30.0))
    refused = approve(bench.retuner, wild, bench.t_s)
    assert refused.action is Action.NONE
    assert refused.gains_after is None
    assert refused.code == "approval_refused"
    assert bench.retuner.trials.phase(0) is P.IDLE


def test_other_gains_or_no_promise_end_a_proposal() -> None:
    bench = Bench(GOOD)
    assert str(ProposalStanding.OTHER_GAINS) in approve(bench.retuner, OFFERED, 60.0).reason
    bare = replace(OFFERED, prediction=None)
    assert "it has no prediction to judge a trial by" in approve(Bench().retuner, bare, 60.0).reason
    with pytest.raises(ValueError, match="does not exist"):
        approve(bench.retuner, replace(OFFERED, region="elsewhere"), 60.0)


@pytest.mark.parametrize(
    ("in_force", "t_s", "standing"),
    [(SLOW, 100.0, "OPEN"), (SLOW, 200.0, "OPEN"), (SLOW, 200.1, "EXPIRED"), (GOOD, 150.0, "OTHER_GAINS")],
)
def test_a_proposal_stands_until_its_time_or_its_gains_are_over(in_force: PidGains, t_s: float, standing: str) -> None:
    assert OFFERED.standing(in_force, t_s, 100.0) is ProposalStanding[standing]


@given(
    st.text("0123456789abcdef", min_size=64, max_size=64),
    st.integers(1, 10**6),
    st.floats(0, 1e9),
    *(st.floats(1e-6, 1e6) for _ in range(4)),
)
def test_a_proposal_comes_back_from_its_document(digest, number, t_s, a, b, c, d):
    offered = Proposal(digest, number, "low", t_s, PidGains(a, b), PidGains(c, d), None)
    assert Proposal.from_dict(offered.to_dict()) == offered


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"digest": "ab"}, "no SHA-256"),
        ({"digest": "G" * 64}, "no SHA-256"),
        ({"t_s": math.nan}, "finite"),
        ({"after": PidGains(-1.0, -0.1)}, "opposite control action"),
    ],
)
def test_what_is_no_proposal_is_refused(changed: dict[str, object], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        replace(OFFERED, **changed)


def test_the_rollback_is_whole_and_not_on_trial() -> None:
    bench = Bench(GOOD)
    decision = revert(bench.retuner, 0, BAD["kc /4"], 60.0)
    assert (decision.action, decision.code) == (Action.WRITE, "ordered_back")
    assert decision.gains_after == BAD["kc /4"]
    bench.retuner.committed(0, BAD["kc /4"])
    assert bench.retuner.trials.phase(0) is P.IDLE
    assert bench.retuner.table.gains == (BAD["kc /4"],)


def test_the_rollback_from_a_change_that_is_not_decided_is_to_undo_it() -> None:
    bench = Bench(GOOD)
    bench.retuner.ordered(0, Outcome("injected", "for a test"), BAD["kc x4"], PROMISE)
    bench.retuner.committed(0, BAD["kc x4"])
    decision = revert(bench.retuner, 0, GOOD, 60.0)
    assert (decision.action, decision.code) == (Action.RESTORE, "undo_ordered_back")
    assert decision.gains_after == GOOD
    assert bench.retuner.table.gains == (GOOD,)
    assert bench.retuner.trials.phase(0) is P.RESTORING


@pytest.mark.parametrize(
    ("gains", "told"),
    [
        (PidGains(-1.0, -0.1), "opposite control action"),
        (SLOW, "they are active already"),
        (PidGains(90.0, 1.0), "kc_max"),
    ],
)
def test_a_rollback_that_leads_nowhere_is_refused(gains: PidGains, told: str) -> None:
    bench = Bench()
    retuner = Retuner(
        bench.retuner.table, replace(bench.retuner.settings, guard=replace(bench.retuner.settings.guard, kc_max=50.0))
    )
    for sample in bench.rig.run(2):
        retuner.observe(sample)
    decision = revert(retuner, 0, gains, 62.0)
    assert decision.action is Action.NONE
    assert told in decision.reason


@pytest.mark.parametrize(
    ("wanted", "unstable"), [(PidGains(0.1, 0.1), True), (PidGains(1.5, 0.02), False), (PidGains(0.2, 0.01), False)]
)
def test_the_rollback_is_judged_on_a_swinging_process_with_its_damping(wanted: PidGains, unstable: bool) -> None:
    # without its poles it would be a gain with dead time: the first set is stable there, the second is not
    swinging = ProcessModel(ProcessType.SOPDT, 1.0, 20.0, 20.0, 2.0, 0.4)
    bench = Bench(PidGains(0.1, 0.005))
    log = LogModel(parameters_of(swinging), np.eye(4) * 1e-4, 1, ProcessType.SOPDT)
    bench.retuner.region_models[0] = RegionModel((StructureModel(log, 0.0),), 3, bench.t_s)
    assert math.isinf(sensitivity_peak(replace(swinging, theta_s=2.5).linear(), wanted)) is unstable
    decision = revert(bench.retuner, 0, wanted, bench.t_s)
    assert decision.code == ("revert_refused" if unstable else "ordered_back")


def test_a_lock_is_taken_off_and_a_change_that_waits_is_accepted() -> None:
    bench = Bench(GOOD)
    assert not unlock(bench.retuner, 0, 60.0)
    assert not accept(bench.retuner, 0, 60.0)
    bench.retuner.ordered(0, Outcome("injected", "for a test"), BETTER, PROMISE)
    bench.retuner.committed(0, BETTER)
    bench.retuner.trials.event(0, E.PASSED_FOR_APPROVAL, 60.0)
    assert bench.retuner.trials.phase(0) is P.WAITING
    assert accept(bench.retuner, 0, 61.0)
    assert bench.retuner.trials.phase(0) is P.IDLE
    bench.retuner.ordered(0, Outcome("injected", "for a test"), GOOD, PROMISE)
    bench.retuner.committed(0, GOOD)
    bench.retuner.abort(E.WORSE)
    bench.retuner.restored()
    bench.retuner.trials.event(0, E.TOO_MANY_UNDOS, 62.0)
    assert bench.retuner.trials.phase(0) is P.LOCKED
    held = revert(bench.retuner, 0, SLOW, 63.0)
    assert held.action is Action.WRITE  # a lock holds the retuner's changes, not the way back
    assert approve(bench.retuner, replace(OFFERED, before=BETTER, after=GOOD), 63.0).code == "held_locked"
    assert unlock(bench.retuner, 0, 64.0)
    assert bench.retuner.trials.phase(0) is P.IDLE


# A whole retuner with changes under way where the loop is and where it is not, interrupted by anything at any moment.
#
# Causes, samples of every kind, restarts from memory, a person's edit, late and lost writes come in any order. What the
# table has for each region afterwards is never less robust, on the models allowed, than what it had before: of a region
# without records these are the models that the others lend, on which its gains were proved.


REGIONS = Regions("pv", "-", ("a", "b", "c"), 0.0, (30.0, 70.0), 100.0)
PLACES = (15.0, 50.0, 85.0)
SETTINGS = RetunerSettings(1.0, 100.0, Mode.AUTO)
HARMLESS = SETTINGS.trial.harmless_ms
LOG = LogModel(np.log([0.02, 5.0, 50.0]), 1e-4 * np.eye(3), 1)
KNOWN = RegionModel((StructureModel(LOG, 0.0),), 3, 0.0, plausible=spread(LOG))
RIGHT = simc(LOG.model().seen_by_controller(1.0)).gains
FACTORS = (0.25, 1.0, 2.2, 8.0)  # Sluggish, right, swinging, unstable


def times(factor: float) -> PidGains:
    return PidGains(RIGHT.kp * factor, RIGHT.ki * factor)


class World:
    """The retuner and its controller; c has no records."""

    def __init__(self, before: tuple[float, ...]) -> None:
        self.retuner = Retuner(GainTable("loop", REGIONS, tuple(times(each) for each in before)), SETTINGS)
        self.retuner.region_models = {0: KNOWN, 1: KNOWN}
        self.t_s, self.at, self.chosen = 0.0, 0, False
        """chosen : the last thing was somebody's choice, or a write that came through."""
        self.sample()

    def sample(self, elapsed_s: float = 1.0, mode: LoopMode = LoopMode.AUTO, limited: int = 0) -> None:
        self.t_s += elapsed_s
        pv = PLACES[self.at]
        self.retuner.step(LoopSample(self.t_s, pv, pv, 0.0, mode, limited, pv))

    def go(self, region: int) -> None:
        self.at = region
        self.sample()

    def asks(self, region: int, factor: float) -> None:
        """A change is written there, as far as another does not forbid it; it is read back later, or never."""
        trials, old, new = self.retuner.trials, self.retuner.table.gains_of(region), times(factor)
        if old != new and trials.may_change(region, self.t_s):
            models = KNOWN.plausible
            trials.begin(region, old, new, predict(models, old, new, 1.0), self.t_s)

    def written(self, region: int) -> None:
        trial = self.retuner.trials.of(region)
        if trial.new is not None and trial.phase is TrialPhase.WRITING:
            self.chosen = True
            self.retuner.committed(region, trial.new)

    def lost(self, region: int) -> None:
        self.retuner.not_written(region)

    def restart(self) -> None:
        self.retuner = restore(json.loads(json.dumps(remember(self.retuner))), SETTINGS)

    def edited(self) -> None:
        self.chosen = True
        self.retuner.edited(times(1.3))


def cause(event: TrialEvent) -> Callable[[World], object]:
    return lambda world: world.retuner.abort(event)


HAPPENS: dict[str, Callable[[World], object]] = {
    **{event.name: cause(event) for event in SILENT},
    **{f"go to {name}": lambda world, i=i: world.go(i) for i, name in enumerate("abc")},
    **{f"{name} x {f:g}": lambda world, i=i, f=f: world.asks(i, f) for i, name in enumerate("abc") for f in FACTORS},
    **{f"{name} written": lambda world, i=i: world.written(i) for i, name in enumerate("abc")},
    **{f"{name} lost": lambda world, i=i: world.lost(i) for i, name in enumerate("abc")},
    "restart": World.restart,
    "restored": lambda world: world.retuner.restored(),
    "edited": World.edited,
    "sample": World.sample,
    "manual": lambda world: world.sample(mode=LoopMode.MANUAL),
    "gap": lambda world: world.sample(elapsed_s=500.0),
    "limit": lambda world: [world.sample(elapsed_s=20.0, limited=1) for _ in range(8)],
    "long after": lambda world: world.sample(elapsed_s=1e6),
}


def robustness(world: World, region: int, gains: PidGains) -> tuple[int, float]:
    known = known_of(KnownProcesses(world.retuner.table, world.retuner.region_models, world.t_s, SETTINGS), region)
    assert known.processes
    greatest, unstable = rollback.robustness(known.ms(gains))
    return unstable, max(greatest, HARMLESS)


def do(world: World, name: str) -> None:
    """One thing, and what the table has then is held against what it had."""
    before, world.chosen = world.retuner.table, False
    undecided = {at for at in range(3) if world.retuner.trials.phase(at) in UNDECIDED}
    HAPPENS[name](world)
    for region in range(3):
        was, now = before.gains_of(region), world.retuner.table.gains_of(region)
        if now == was or world.chosen:
            continue
        assert region in undecided, f"{name}: {REGIONS.names[region]} was not on trial"
        assert robustness(world, region, now) <= robustness(world, region, was), f"{name}: {was} -> {now}"


@pytest.mark.uncounted
@settings(max_examples=examples(100))
@given(
    st.tuples(*[st.sampled_from(FACTORS)] * 3),
    st.sampled_from("abc"),
    st.sampled_from(FACTORS),
    st.lists(st.sampled_from(sorted(HAPPENS)), min_size=3, max_size=10),
)
def test_what_runs_is_never_less_robust_after_anything(before, region, factor, names):
    world = World(before)
    for name in (f"{region} x {factor:g}", f"{region} written", *names):
        do(world, name)


def test_gains_for_a_region_without_records_stay_where_those_before_are_unstable() -> None:
    """An interruption before the loop has ever come says nothing of them."""
    for event in SILENT:
        world = World((1.0, 1.0, 8.0))
        for name in ("c x 1", "c written", event.name, "restored", "go to c"):
            do(world, name)
        assert world.retuner.table.gains_of(2) == times(1.0), event
        ms = known_of(KnownProcesses(world.retuner.table, world.retuner.region_models, world.t_s, SETTINGS), 2).ms(
            times(8.0)
        )
        assert all(map(math.isinf, ms))


# The retuner with a cure on trial, as a user of the library has it: it stays; what a person sets is his.


UNSTABLE = PidGains(6 * GOOD.kp, 6 * GOOD.ki)
WEAK = PidGains(GOOD.kp / 5, GOOD.ki / 5)


class Stand:
    """A loop at rest, and its retuner, which knows the process."""

    def __init__(self, first: PidGains, mode: Mode = Mode.AUTO, **trial: float) -> None:
        table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (first,))
        self.retuner = Retuner(table, RetunerSettings(1.0, 100.0, mode, band=0.1, trial=TrialSettings(**trial)))
        x = parameters_of(MODEL)
        log = StructureModel(LogModel(x, 1e-4 * np.eye(len(x)), 1, MODEL.type), 0.0)
        self.retuner.region_models = {0: RegionModel((log,), 2, 0.0, plausible=(Plausible(MODEL, 0.0),))}
        self.rig = Rig(GOOD, noise=0.02)
        assert list(self.run(60)) == []

    def cure(self) -> "Stand":
        """What is in force is unstable by all that is known; a cure comes on trial."""
        made = self.retuner.ordered(0, Outcome("injected", "for a test"), GOOD, PROMISE)
        assert made.action is Action.WRITE
        self.retuner.committed(0, GOOD)
        assert self.retuner.trials.phase(0) is P.TRIAL
        return self

    def samples(self, n: int, **changes: float) -> list[Decision]:
        return [d for s in self.rig.run(n) if (d := self.retuner.observe(s._replace(**changes))) is not None]

    def run(self, n: int) -> Iterator[Decision]:
        yield from self.samples(n)


def test_the_end_leaves_it_running_and_the_next_session_goes_on_with_its_trial() -> None:
    stand = Stand(UNSTABLE).cure()
    decision = stand.retuner.abort(E.STOPPED)
    assert (decision.action, decision.code, decision.gains_after) == (Action.RESTORE, "kept_stopped", GOOD)
    assert stand.retuner.restored() == (0,)
    assert stand.retuner.abort(E.STOPPED) is None
    memory = json.loads(json.dumps(remember(stand.retuner), allow_nan=False))
    stand.retuner = restore(memory, stand.retuner.settings)
    stand.rig.t_s += 1000.0
    stand.samples(2)
    assert stand.retuner.trials.phase(0) is P.TRIAL
    stand.samples(200)
    stand.rig.load = 10.0
    judged = [d.judgement for d in stand.samples(300) if d.judgement]
    assert judged
    assert stand.retuner.table.gains_of(0) == GOOD


def test_the_same_cause_ends_the_trial_of_a_set_that_is_worse() -> None:
    stand = Stand(GOOD)
    stand.retuner.ordered(0, Outcome("injected", "for a test"), UNSTABLE, PROMISE)
    stand.retuner.committed(0, UNSTABLE)
    (decision,) = stand.samples(1, mode=LoopMode.MANUAL)
    assert decision.code == "undo_manual"
    assert decision.gains_after == GOOD
    assert "trial gains unstable" in decision.reason


def test_gains_of_the_other_sign_are_refused_at_the_door() -> None:
    stand = Stand(GOOD)
    with pytest.raises(ValueError, match="acts in the other direction than the configured Kc"):
        stand.retuner.edited(PidGains(-GOOD.kp, -GOOD.ki))
    assert stand.retuner.table.gains == (GOOD,)
    assert stand.retuner.trials.phase(0) is P.IDLE


def again(stand: Stand) -> Retuner:
    """The retuner of a session that goes on from the memory of this one."""
    return restore(json.loads(json.dumps(remember(stand.retuner))), stand.retuner.settings)


@pytest.mark.parametrize("came_about", [True, False])
def test_a_write_in_which_a_session_died_is_known_by_what_runs(*, came_about: bool) -> None:
    stand = Stand(UNSTABLE)
    stand.retuner.ordered(0, Outcome("injected", "for a test"), GOOD, PROMISE)
    after = again(stand)
    assert after.trials.phase(0) is P.WRITING
    assert found_running(after, GOOD if came_about else UNSTABLE) is None
    assert after.trials.phase(0) is (P.TRIAL if came_about else P.IDLE)
    assert after.table.gains == (GOOD if came_about else UNSTABLE,)


def test_what_nobody_of_ours_wrote_meanwhile_is_a_persons() -> None:
    for stand in (Stand(GOOD), Stand(UNSTABLE).cure()):
        after = again(stand)
        told = found_running(after, WEAK)
        assert told.code == "edited"
        assert after.table.gains == (WEAK,)
    assert found_running(after, WEAK) is None


def test_a_rollback_in_which_a_session_died_is_asked_for_again() -> None:
    stand = Stand(GOOD)
    stand.retuner.ordered(0, Outcome("injected", "for a test"), UNSTABLE, PROMISE)
    stand.retuner.committed(0, UNSTABLE)
    assert stand.retuner.rolled_back(0) is not None
    after = again(stand)
    told = found_running(after, UNSTABLE)
    assert (told.action, told.gains_after) == (Action.RESTORE, GOOD)
    assert after.restored() == (0,)
    assert found_running(after, GOOD) is None


def test_a_proposal_is_approved_while_it_stands() -> None:
    stand = Stand(WEAK, Mode.ADVISE)
    stand.rig.change(WEAK)
    stand.rig.sp = 5.0
    (proposed,) = [d for d in stand.samples(1500) if d.gains_after]
    with pytest.raises(ValueError, match="it has expired"):
        approve_proposal(stand.retuner, proposed, expires_after_s=1.0)
    assert approve_proposal(stand.retuner, proposed).action is Action.WRITE
    with pytest.raises(ValueError, match="no proposal"):
        approve_proposal(stand.retuner, stand.retuner.ordered(0, Outcome("injected", "for a test")))


def test_after_its_time_the_loop_is_retuned_again_from_there() -> None:
    stand = Stand(GOOD, edit_hold_s=10.0)
    stand.retuner.edited(WEAK)
    stand.rig.change(WEAK)
    stand.samples(200)
    stand.rig.sp = 5.0
    (made,) = [d for d in stand.samples(1500) if d.gains_after]
    assert made.action is Action.WRITE
    assert made.gains_before == WEAK


def test_who_takes_ours_away_again_and_again_is_left_alone_for_longer() -> None:
    stand, holds = Stand(WEAK, edit_hold_s=100.0), []
    for _ in range(3):
        stand.retuner.ordered(0, Outcome("injected", "for a test"), GOOD, PROMISE)
        stand.retuner.committed(0, GOOD)
        stand.retuner.edited(WEAK)
        holds.append(stand.retuner.trials.of(0).until_s - stand.rig.t_s)
        stand.samples(500)
    assert holds == [100.0, 200.0, 400.0]


@pytest.mark.slow
def test_the_example_obeys_every_decision() -> None:
    """Its loop puts a bad set back that is on trial when it stops."""
    example = Path(__file__).parents[3] / "examples" / "one_sample_at_a_time.py"
    code = f"""
import runpy
page = runpy.run_path({str(example)!r})
from retuner import PidGains, Retuner
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.trial.phase import TrialEvent
from retuner import GainTable, RetunerSettings
from retuner.schedule.regions import Regions
from retuner.adaptive.trial.prediction import predict
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel, ProcessType
good, bad = PidGains(45.0, 1.0), PidGains(400.0, 10.0)
retuner = Retuner(GainTable("t", Regions("sp", "m", ("tank",), 0.0, (), 10.0), (good,)), RetunerSettings(1.0, 10.0))
tank = page["Tank"](good)
retuner.observe(tank.sample(0.0, 4.0))
said = predict([Plausible(ProcessModel(ProcessType.FOPDT, 0.1, 50.0, 0.0, 5.0), 0.0)], good, good, 1.0)
page["obey"](retuner.ordered(0, Outcome("injected", "for a test"), bad, said), tank, retuner)
assert tank._law.gains == bad
page["obey"](retuner.abort(TrialEvent.STOPPED), tank, retuner)
assert tank._law.gains == good and not retuner.trials.restoring
"""
    subprocess.run([sys.executable, "-P", "-W", "error", "-c", code], check=True, capture_output=True)
