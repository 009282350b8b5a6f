"""Less action that was no cure: a tone that goes on through the cut brings the set before it back, on trial."""

import math

from test_online_cause import GOOD, Rig

from retuner.adaptive.diagnosis.oscillation_online import through_a_change
from retuner.adaptive.diagnosis.settings import DiagnosisSettings
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.supervision.decision import Action, Basis, Mode
from retuner.adaptive.trial.expectation import promise_without_model
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import change, law

CUT = PidGains(GOOD.kp / 3, GOOD.ki / 6)
TONE_S = 40.0
SWUNG = Response(0.0, 60.0, (Peak(10.0, 1.0), Peak(35.0, -1.0), Peak(60.0, 1.0)), Ending.COMPLETE, False, 0.1)


def cut(rig: Rig, gains: PidGains) -> None:
    """As after a cut that passed its trial."""
    before = rig.retuner.table.gains_of(0)
    promise = promise_without_model(SWUNG, before, gains)
    trial = Trial(TrialPhase.IDLE, before, gains, promise, ran=True, since_s=rig.t, earlier=(before,))
    rig.retuner.trials.resume({"at": 0, "trials": {"0": trial.to_dict()}})
    rig.retuner.committed(0, gains)
    new = law(gains, co_min=rig.limits[0], co_max=rig.limits[1])
    rig.state, rig.rules = change(rig.rules, new, rig.state, 0.0, rig.y, 1.0), new
    rig.revision += 1


def test_a_tone_that_goes_on_through_a_cut_brings_the_set_before_back() -> None:
    rig = Rig(GOOD)
    rig.run(60)
    rig.run(int(5 * TONE_S), amplitude=1.0, period_s=TONE_S)
    cut(rig, CUT)
    decisions = rig.run(int(12 * TONE_S), amplitude=1.0, period_s=TONE_S)
    back = [d for d in decisions if d.action is Action.COMMIT]
    assert [d.basis for d in back] == [Basis.RAN]
    assert back[0].gains_after == GOOD
    assert "goes on as before the last change" in back[0].reason
    assert rig.retuner.foreign[0] > 0, "what is alive stays so under a set that comes back"


def test_a_swing_that_the_cut_has_cured_was_the_loops_own() -> None:
    rig = Rig(PidGains(3.3 * GOOD.kp, 3.3 * GOOD.ki), mode=Mode.ADVISE)
    rig.run(60)
    rig.run(200, sp=0.5)
    cut(rig, GOOD)
    rig.run(100, sp=0.5)
    assert through_a_change(list(rig.retuner._finder.samples), GOOD, DiagnosisSettings()) is None


def test_one_set_alone_tells_nothing() -> None:
    rig = Rig(GOOD, mode=Mode.OFF)
    rig.run(int(4 * TONE_S), amplitude=1.0, period_s=TONE_S)
    samples = list(rig.retuner._finder.samples)
    assert through_a_change(samples, GOOD, DiagnosisSettings()) is None
    assert math.isclose(samples[-1].t_s, 4 * TONE_S)
