"""Less action that was no cure: a tone that goes on through the cut brings the set before it back, on trial."""

import math

import pytest
from test_online_cause import GOOD, Rig

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.oscillation_online import alike_on_both_sides, through_a_change
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Action, Mode
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.prediction import predict_without_model
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import change, law

CUT = PidGains(GOOD.kp / 3, GOOD.ki / 6)
TONE_S = 40.0
SWUNG = Response(0.0, 60.0, (Peak(10.0, 1.0), Peak(35.0, -1.0), Peak(60.0, 1.0)), Ending.COMPLETE, False, 0.1)


def cut(rig: Rig, gains: PidGains) -> None:
    """As after a cut that passed its trial."""
    before = rig.retuner.table.gains_of(0)
    prediction = predict_without_model(SWUNG, before, gains)
    trial = Trial(TrialPhase.IDLE, before, gains, prediction, ran=True, since_s=rig.t, earlier=(before,))
    rig.retuner.trials.resume({"at": 0, "trials": {"0": trial.to_dict()}})
    rig.retuner.committed(0, gains)
    new = law(gains, co_min=rig.limits[0], co_max=rig.limits[1])
    rig.state, rig.rules = change(rig.rules, new, rig.state, 0.0, rig.y, 1.0), new
    rig.revision += 1


@pytest.mark.slow
def test_a_tone_that_goes_on_through_a_cut_brings_the_set_before_back() -> None:
    rig = Rig(GOOD)
    rig.run(60)
    rig.run(int(5 * TONE_S), amplitude=1.0, period_s=TONE_S)
    cut(rig, CUT)
    decisions = rig.run(int(4 * TONE_S), amplitude=1.0, period_s=TONE_S)
    rig.retuner.region_models.clear()  # of the tone itself, by which the set before would be unstable
    decisions += rig.run(int(8 * TONE_S), amplitude=1.0, period_s=TONE_S)
    back = [d for d in decisions if d.action is Action.WRITE]
    assert [d.basis for d in back] == [Basis.RAN]
    assert back[0].gains_after == GOOD
    assert "goes on as before the last change" in back[0].reason
    assert rig.retuner.foreign[0] > 0, "what is alive stays so under a set that comes back"


@pytest.mark.slow
def test_a_set_that_is_less_stable_by_what_is_known_does_not_come_back() -> None:
    """Whatever the tone: the door is closed, and the decision says so."""
    rig = Rig(GOOD)
    rig.run(60)
    rig.run(int(5 * TONE_S), amplitude=1.0, period_s=TONE_S)
    cut(rig, CUT)
    decisions = rig.run(int(12 * TONE_S), amplitude=1.0, period_s=TONE_S)
    known = next(d.known for d in decisions if d.known is not None)
    assert math.isinf(sensitivity_peak(known.model().seen_by_controller(1.0).linear(), GOOD))
    assert rig.retuner.table.gains_of(0) == CUT
    told = [d for d in decisions if d.code == "tone_goes_on"]
    assert told
    assert "do not come back: they are less stable on the 6 plausible models: unstable" in told[0].reason


SHORTER, LONGER = [30.0] * 6, [52.0] * 5


@pytest.mark.parametrize(
    ("before", "after", "growth", "alike"),
    [
        ([40.0] * 5, [40.0] * 6, 1.0, True),
        ([40.0] * 5, SHORTER, 1.0, False),
        ([40.0] * 5, LONGER, 1.0, False),
        ([40.0] * 5, [40.0] * 6, 1.15, False),
        ([40.0], [40.0] * 6, 1.0, False),
    ],
)
def test_only_an_even_tone_of_one_period_goes_on_through_a_change(
    before: list[float], after: list[float], growth: float, alike: bool
) -> None:
    """Another period, or a swing that grows, is the loop's own: the unstable set was written again for one."""
    swing, t = [], 0.0
    for revision, periods in enumerate((before, after)):
        height = 1.0
        for period_s in periods:
            for i in range(int(period_s)):
                pv = height * math.sin(2.0 * math.pi * i / period_s)
                swing.append(LoopSample(t, 0.0, pv, 50.0, LoopMode.AUTO, 0, 0.0, revision))
                t += 1.0
            height *= growth
    assert alike_on_both_sides(swing, 40.0, 0.1) is alike


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
