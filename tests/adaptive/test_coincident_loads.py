"""Load steps at setpoint changes: recognised, and a model that rests on them refused where another one differs."""

import csv
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from retuner import api, diagnosing
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.fit.record import apart, near, setpoint_changes
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.region_model.update import update_region_model
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.supervision import confirmation
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import Findings
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.gains import PidGains

PLANT = Path(__file__).parents[1] / "data" / "plant"


def recorded(name: str) -> list[FloatArray]:
    with (PLANT / name).open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    return [np.array([float(row[key]) for row in rows]) for key in ("t", "sp", "pv", "co")]


def window(sp: FloatArray, pv: FloatArray | None = None) -> Window:
    t = np.arange(len(sp), dtype=np.float64)
    return Window(t + 1000.0, sp, sp.copy() if pv is None else pv, np.zeros_like(sp))


def test_instants_of_the_setpoint_changes():
    sp = np.repeat([0.0, 5.0, 5.01, -3.0], 50)
    assert setpoint_changes(window(sp)) == (50.0, 150.0)
    assert setpoint_changes(window(np.arange(200.0))) == ()
    assert setpoint_changes(window(np.zeros(50), np.arange(50.0))) == ()


def test_near_a_setpoint_change():
    instants = np.array([0.0, 60.0, 96.9, 97.1, 100.0, 122.9, 123.1, 180.0])
    assert near(instants, (100.0,), lag_s=0.0, theta_s=20.0, dt_s=1.0).tolist() == [
        False, False, False, True, True, True, False, False,
    ]  # fmt: skip
    assert near(instants, (100.0,), lag_s=10.0, theta_s=20.0, dt_s=1.0)[2]
    assert not near(instants, (), lag_s=10.0, theta_s=20.0, dt_s=1.0).any()


def test_models_apart():
    one = ProcessModel(ProcessType.FOPDT, 2.0, 50.0, 0.0, 9.5)
    assert apart(one, one, 1.0) == 0.0
    other = ProcessModel(ProcessType.FOPDT, 4.0, 50.0, 0.0, 9.5)
    assert apart(one, other, 1.0) == pytest.approx(math.log(2.0))
    assert apart(one, ProcessModel(ProcessType.FOPDT, -2.0, 50.0, 0.0, 9.5), 1.0) == math.inf
    late = ProcessModel(ProcessType.FOPDT, 2.0, 50.0, 0.0, 19.5)
    assert apart(one, late, 1.0) == pytest.approx(math.log(2.0))  # the gain follows 1 / theta


@pytest.mark.slow
def test_a_healthy_flow_loop_does_not_become_a_fiction():
    """A load bought at the one setpoint change makes a dead time of 110 s of a loop that answers within 30 s."""
    record = recorded("FIC46002_1102_1.csv")
    found = api.identify(*record)
    assert not found.estimate.identifiable
    assert found.settings is None
    told = found.to_dict()["rival"]
    assert told["apart"] > 3
    assert told["at"] == pytest.approx(1370.0, abs=20.0)
    assert found.estimate.rival.model.theta_s < 0.2 * found.estimate.log.model().theta_s
    diagnosed = diagnosing.diagnose(*record)
    assert not diagnosed.diagnosis.retune
    assert diagnosed.cause == Cause.OK
    assert diagnosed.diagnosis.causes["ok"] < 0.8
    assert diagnosed.to_dict()["rival"] is not None
    t_s, *rest = record
    settings = RetunerSettings(float(np.median(np.diff(t_s))), 100.0)
    learned = update_region_model(None, Window(t_s, *rest), PidGains(0.0138, 0.00034), settings.tracker, settings.fit)
    assert learned.contested


@pytest.mark.parametrize("contested", [False, True])
def test_a_setpoint_response_that_load_steps_explain_in_two_ways_is_not_as_good_as_a_clear_one(monkeypatch, contested):
    for name in ("is_known", "exempt_from_confirmation", "stands"):
        monkeypatch.setattr(confirmation, name, lambda *_: False)
    monkeypatch.setattr(confirmation, "doubt_of", lambda *_: None)
    told = Diagnosis(Cause.AGGRESSIVE, 0.9, {}, "too much gain")
    question: Any = SimpleNamespace(
        record=SimpleNamespace(crossed=False, response=SimpleNamespace(sp_changed=True)), spoilt=""
    )
    found = Findings(
        question,
        learned=cast("Any", SimpleNamespace(contested=contested, valve=None)),
        in_use=cast("Any", SimpleNamespace()),
        excitation=Excitation(setpoints=1),
    )
    change = Outcome("", "", diagnosis=told)
    made = confirmation.confirmation(found, change, cast("Any", SimpleNamespace(code="urgent")), "", 0)
    assert made.code == "urgent"
    assert (made.excitation is not None and made.excitation.clear == 1) is not contested
