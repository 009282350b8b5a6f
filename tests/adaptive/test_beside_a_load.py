"""A record of one load step: the fit finds what a start from the truth finds, and no dead time is made up as none."""

import csv
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from retuner import PidGains, ProcessModel, ProcessType, RetunerSettings, api, diagnosing
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.fit.dynamics import Dynamics, SamplingInstants
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record, apart, near, setpoint_changes
from retuner.adaptive.fit.refine import EXACT, refine
from retuner.adaptive.fit.search import _splits, with_second_lag
from retuner.adaptive.fit.structure import SECOND, THETA, model_at
from retuner.adaptive.identification.candidate import judged
from retuner.adaptive.identification.identify import FitSettings, fitted, identify_window
from retuner.adaptive.identification.loads import _load_elsewhere, _merged, _without_ramp, _without_rounding
from retuner.adaptive.identification.usual_dead_time import LEAST_SHARE, SPREAD, unusual, usual
from retuner.adaptive.region_model.update import update_region_model
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.supervision import confirmation
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import Findings

FIRST, SECOND_ORDER = ProcessType.FOPDT, ProcessType.SOPDT
THETA_S, TOTAL, C2, AT = 4.0, 40.0, 7.5, 60.0  # Lags of 30 and 10 s after 4 s, gain one; the load comes after 60 s
DT, N = 0.8, 500


@pytest.fixture(scope="module")
def record() -> Window:
    """PI on two lags with dead time, one load step, 1 % noise."""
    rng, t = np.random.default_rng(4), DT * np.arange(N)
    process = Dynamics(C2, 1 / TOTAL)
    load = process.step(t - AT) / TOTAL
    co, pv, integral = np.zeros(N), np.zeros(N), 0.0
    noise = 0.005 * rng.standard_normal(N)
    for i in range(N):
        moved = process.held(SamplingInstants.of(t[: i + 1]), co[: i + 1], THETA_S)[-1] if i else 0.0
        pv[i] = moved / TOTAL + load[i] + noise[i]
        integral -= 1.5 / 30 * pv[i] * DT
        co[i] = -1.5 * pv[i] + integral
    return Window(t, np.zeros(N), pv, co)


def at_truth(loads: int, *, rounded: bool = False) -> np.ndarray:
    lag = [math.log(5.0)] if rounded else []
    return np.array([-math.log(TOTAL), math.log(THETA_S), math.log(TOTAL), math.log(C2), *[AT] * loads, *lag])


def made(record: Window, loads: int, *, rounded: bool = False, ramp: bool = False) -> Misfit:
    of = Record.of(record)
    return Misfit(of, SECOND_ORDER, 1, loads, of.noise_std, 0.3, rounded=rounded, ramp=ramp)


def test_the_search_is_no_worse_than_a_start_from_the_truth(record: Window) -> None:
    best = judged(refine(made(record, 1), at_truth(1), enough=EXACT))
    found = fitted(record, (1,), FitSettings())[0]
    assert found.fit.misfit.loads == 1
    assert not found.fit.misfit.ramp
    assert not found.fit.misfit.rounded
    assert found.criterion < best.criterion + 3.0  # the usual dead time may cost a little


def test_a_second_lag_is_found_beside_a_load(record: Window) -> None:
    of = Record.of(record)
    first = refine(
        Misfit(of, FIRST, 1, 1, of.noise_std, 0.3),
        np.array([-math.log(TOTAL), math.log(THETA_S + C2), math.log(TOTAL), AT + C2]),
    )
    misfit = replace(first.misfit, type=SECOND_ORDER)
    for split in _splits(first, SECOND_ORDER)[:3]:
        kept = split.copy()
        kept[-1] = first.p[-1]  # the load where it was, though its response now comes later
        assert misfit.costs([split])[0] < misfit.costs([kept])[0]
    second = with_second_lag(first, SECOND_ORDER, [], 3)
    assert math.exp(second.x[SECOND[SECOND_ORDER]]) > C2 / 3


def test_needless_things_are_taken_back(record: Window) -> None:
    of = made(record, 1, rounded=True, ramp=True)
    drifting = judged(refine(of, at_truth(1, rounded=True)))
    plain, p = _without_ramp(drifting) or (of, drifting.fit.p)
    assert not plain.ramp
    assert np.array_equal(p, drifting.fit.p)
    step, q = _without_rounding(drifting) or (of, drifting.fit.p)
    assert not step.rounded
    assert q[4] == pytest.approx(drifting.fit.p[4] + math.exp(drifting.fit.p[5]))
    assert _without_ramp(judged(refine(made(record, 1), at_truth(1)))) is None
    assert _without_rounding(judged(refine(made(record, 1), at_truth(1)))) is None


def test_two_loads_may_be_one_that_comes_slowly(record: Window) -> None:
    p = at_truth(2)
    p[4:] = AT - 2.0, AT + 6.0
    one, q = _merged(judged(refine(made(record, 2), p, evaluations=0))) or (made(record, 2), p)
    assert one.loads == 1
    assert one.rounded
    assert q[4:] == pytest.approx([AT - 2.0, math.log(4.0)])
    assert _merged(judged(refine(made(record, 1), at_truth(1)))) is None


def test_a_load_at_a_wrong_place_is_moved(record: Window) -> None:
    more = Dynamics(C2, 1 / TOTAL).step(record.t_s - 200.0) / TOTAL  # a second load, for a model sees co as given
    twice = replace(record, pv=record.pv + more)
    p = at_truth(2)
    p[4:] = AT, 330.0
    moved = _load_elsewhere(judged(refine(made(twice, 2), p, evaluations=0)), 1)
    assert moved[1][-1] == pytest.approx(200.0, abs=15.0)
    assert _load_elsewhere(judged(refine(made(twice, 1), at_truth(1))), 0) is None


@pytest.mark.parametrize(("theta", "sigmas"), [(LEAST_SHARE * C2, 0.0), (20.0, 0.0), (0.5 * C2 / math.e, 1 / SPREAD)])
def test_how_unusual_a_dead_time_is(theta: float, sigmas: float) -> None:
    x = np.log([1.0, theta, TOTAL, C2])
    assert unusual(SECOND_ORDER, x) == pytest.approx(sigmas, abs=1e-12)
    known = usual(SECOND_ORDER, x)
    assert (known is None) == (sigmas == 0)
    if known is not None:
        assert abs(float(known.residuals(x)[0])) == pytest.approx(sigmas)
    assert unusual(FIRST, x[:3]) == 0
    assert usual(FIRST, x[:3]) is None


def test_loads_alone_do_not_end_at_no_dead_time(record: Window) -> None:
    found = identify_window(record, sign=1)
    x = next(a.log for a in found.alternatives if a.log.type == SECOND_ORDER).x
    assert math.exp(x[THETA]) > 0.1 * C2
    assert model_at(SECOND_ORDER, x, 1).theta_s < 3 * THETA_S


# Load steps at setpoint changes: recognised, and a model that rests on them refused where another one differs.


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
