"""The retuner with a cure on trial, as a user of the library has it: it stays; what a person sets is his."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rig import GOOD, MODEL, PROMISE, Rig

from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.orders.operator_orders import approve_proposal, found_running
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.signals.sample import LoopMode
from retuner.adaptive.supervision.decision import Action, Decision, Mode, Outcome
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

P, E = TrialPhase, TrialEvent
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
