"""Real records: a servo under PID is admitted and read, a heater's step makes the first model and settings."""

from pathlib import Path

import numpy as np
import pytest

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.orders.operator_orders import pretune
from retuner.adaptive.signals.sample import FloatArray, LoopSample, Window
from retuner.adaptive.supervision.admission import AdmissionSettings, admit
from retuner.adaptive.supervision.decision import Action, Mode
from retuner.adaptive.supervision.response_finder import Completed, ResponseFinder
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.without_model.pattern_rule import MOVING, PatternReading, PatternSettings, pattern_rule
from retuner.adaptive.without_model.proposal_without_model import SlowReading, SlowSettings, slow_oscillation_online
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

DATA = Path(__file__).parents[1] / "data"


def columns(name: str) -> FloatArray:
    return np.loadtxt(DATA / name, delimiter=",", skiprows=1).T


def table(gains: PidGains) -> GainTable:
    return GainTable("real", Regions("sp", "-", ("all",), -1e6, (), 1e6), (gains,))


@pytest.fixture(scope="module")
def servo() -> tuple[ResponseFinder, Completed, PidGains]:
    """The first completed response of the servo's record (its gains are not told; these have its time scale)."""
    gains = PidGains(1.0, 1.0 / 0.04)
    finder = ResponseFinder(table(gains).regions, table(gains).at, RetunerSettings(0.002, 130.0))
    for t, sp, pv, co in columns("servo/pid_step.csv").T:
        seen = finder.step(LoopSample(float(t), float(sp), float(pv), float(co)))
        if isinstance(seen, Completed):
            return finder, seen, gains
    raise AssertionError("no response was recognised")


def test_a_real_response_is_admitted_and_its_pattern_read(servo: tuple[ResponseFinder, Completed, PidGains]) -> None:
    finder, seen, gains = servo
    window = finder.window(seen.response)
    assert admit(window, finder.samples, seen.response, AdmissionSettings()).admitted
    advice = pattern_rule(seen.response, window, gains, None, PatternSettings())
    assert advice.reading is PatternReading.CALM  # it overshoots by two percent
    assert advice.numbers.to_dict()["overshoot"] == pytest.approx(0.02, abs=0.01)
    assert advice.reading in MOVING


def test_the_slow_oscillation_rule_says_why_it_is_silent_on_it(servo):
    _, seen, gains = servo
    advice = slow_oscillation_online(seen.response, gains, None, SlowSettings())
    assert advice.reading is not SlowReading.APPLIES
    assert advice.tuning is None


def test_a_real_step_of_a_heater_makes_the_first_settings() -> None:
    t, pv, co = columns("heater/open_loop_step.csv")
    gains = PidGains(2.0, 2.0 / 300)
    retuner = Retuner(table(gains), RetunerSettings(1.0, 100.0, Mode.AUTO))
    retuner.observe(LoopSample(float(t[-1]) + 10.0, float(pv[0]), float(pv[0]), float(co[0])))
    decision = pretune(retuner, 0, Window(t, np.full_like(pv, pv[0]), pv, co))
    model = retuner.region_models[0].log.model()
    assert model.k / (model.tau1_s + model.theta_s) == pytest.approx(0.361 / 152, rel=0.15)  # the record's own notes
    assert decision.basis is Basis.PRETUNE
    assert decision.action is Action.WRITE
    assert decision.gains_after.ki > gains.ki
