"""The retuner with its trials: what samples tell ends a trial by itself, and the response under way teaches."""

import json
import math
from collections.abc import Iterator

import pytest
from rig import BAD, GOOD, MODEL, PROMISE, Rig

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.signals.sample import LoopMode
from retuner.adaptive.supervision.decision import Action, Decision, Mode, Outcome
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.adaptive.trial.prediction import predict
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

P, E = TrialPhase, TrialEvent
NEW = BAD["kc x4"]


class Stand:
    """A loop at rest, its retuner, and a change that has just been committed."""

    def __init__(self, new: PidGains = NEW, mode: Mode = Mode.AUTO) -> None:
        table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (GOOD,))
        self.retuner = Retuner(table, RetunerSettings(1.0, 100.0, mode, band=0.1))
        self.rig = Rig(GOOD, noise=0.02)
        assert list(self.run(60)) == []
        made = self.retuner.ordered(0, Outcome("injected", "for a test"), new, PROMISE)
        assert made.action is Action.WRITE
        assert self.retuner.trials.phase(0) is P.WRITING
        self.retuner.committed(0, new)
        self.rig.change(new)
        assert self.retuner.trials.phase(0) is P.TRIAL

    def run(self, samples: int) -> Iterator[Decision]:
        for sample in self.rig.run(samples):
            decision = self.retuner.observe(sample)
            if decision is not None:
                yield decision

    def run_away(self) -> Decision:
        """A setpoint step under the set on trial, until it is given up."""
        assert list(self.run(40)) == []
        self.rig.sp = 5.0
        return next(self.run(100))


def learned_by_a_runaway() -> RegionModel:
    stand = Stand()
    stand.run_away()
    return stand.retuner.region_models[0]


def test_a_loop_that_runs_away_is_taken_back_in_mid_response_and_the_record_teaches() -> None:
    stand = Stand()
    decision = stand.run_away()
    assert decision.action is Action.RESTORE
    assert decision.code == "undo_runaway"
    assert (decision.gains_before, decision.gains_after) == (NEW, GOOD)
    assert decision.prediction == PROMISE
    assert stand.retuner.table.gains == (GOOD,)
    assert decision.response.ending.name == "UNDONE"
    assert 0 in stand.retuner.region_models
    assert stand.retuner.region_models[0].log.model().theta_s == pytest.approx(5.0, rel=0.2)
    assert json.loads(decision.canonical())["trial"] == "rolling back to the verified gains"


def test_a_model_that_promised_wrongly_is_not_believed_any_more() -> None:
    """The record of the undo agrees with it: what the two say together is forgotten, the next one begins anew."""
    for before, kept in ((learned_by_a_runaway(), False), (None, True)):
        stand = Stand()
        stand.retuner.region_models = {} if before is None else {0: before}
        decision = stand.run_away()
        assert decision.code == "undo_runaway"
        assert decision.agreement is (Agreement.FIRST if before is None else Agreement.AGREES)
        assert (0 in stand.retuner.region_models, 0 in stand.retuner.excitation) == (kept, kept)


def test_a_tone_that_speaks_against_a_cure_does_not_give_a_rescued_loop_back_to_the_unstable_set() -> None:
    """A far too short tau_I is unstable on every model, the cure is on trial, and a tone from outside rises."""
    lost = PidGains(0.8 * GOOD.kp, 14.0 * GOOD.ki)
    process = MODEL.seen_by_controller(1.0).linear()
    assert math.isinf(sensitivity_peak(process, lost))
    table = GainTable("loop", Regions("sp", "-", ("all",), -100.0, (), 100.0), (lost,))
    retuner, rig = Retuner(table, RetunerSettings(1.0, 100.0, Mode.AUTO, band=0.1)), Rig(GOOD, noise=0.02)
    for sample in rig.run(60):
        retuner.observe(sample)
    retuner.region_models = {0: learned_by_a_runaway()}
    prediction = predict([Plausible(MODEL, 0.0)], lost, GOOD, 1.0)
    retuner.ordered(0, Outcome("injected", "for a test"), GOOD, prediction)
    retuner.committed(0, GOOD)
    ended: list[Decision] = []
    for t in range(400):
        rig.load = 0.05 * 1.12 ** min(t, 90) * math.sin(2.0 * math.pi * t / 30.0)
        ended += [made for made in map(retuner.observe, rig.run(1)) if made and made.action is Action.RESTORE]
        if ended:
            break
    assert ended[0].code == "undo_runaway"
    assert ended[0].gains_after == GOOD
    assert "no earlier gains are expected to be better" in ended[0].reason
    assert "previous gains unstable" in ended[0].reason
    assert retuner.table.gains[0] == GOOD


def test_an_undo_that_does_not_speak_against_the_gains_forgets_nothing() -> None:
    known, stand = learned_by_a_runaway(), Stand()
    stand.retuner.region_models = {0: known}
    decision = stand.retuner.observe(next(stand.rig.run(1))._replace(mode=LoopMode.MANUAL))
    assert decision.code == "undo_manual"
    assert stand.retuner.region_models == {0: known}


def test_a_gap_or_manual_mode_ends_the_trial() -> None:
    stand = Stand()
    sample = next(stand.rig.run(1))
    decision = stand.retuner.observe(sample._replace(t_s=sample.t_s + 9.0))
    assert decision.code == "undo_gap"
    stand = Stand()
    decision = stand.retuner.observe(next(stand.rig.run(1))._replace(mode=LoopMode.MANUAL))
    assert decision.code == "undo_manual"
    assert stand.retuner.table.gains == (GOOD,)


def test_a_change_is_held_while_another_is_on_trial() -> None:
    made = Stand().retuner.ordered(0, Outcome("injected", "for a test"), GOOD, PROMISE)
    assert (made.action, made.code) == (Action.NONE, "held_trial")


def test_a_restart_of_the_host_in_mid_trial_loses_nothing() -> None:
    stand, twin = Stand(), Stand()
    for one in (stand, twin):
        one.rig.load = 10.0
        assert list(one.run(25)) == []
    memory = json.loads(json.dumps(remember(stand.retuner), allow_nan=False))
    stand.retuner = restore(memory, stand.retuner.settings)
    assert stand.retuner.trials.to_dict() == twin.retuner.trials.to_dict()
    assert next(stand.run(100)).canonical() == next(twin.run(100)).canonical()
