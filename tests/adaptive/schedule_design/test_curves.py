"""Curves through records of a process whose course is known."""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from schedule_cases import GROWTH, THETA_S, C, record, slow_sine, tau_s

import retuner
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.schedule_choice import schedule_from_records as designing
from retuner.adaptive.schedule_choice.schedule_from_records import _able, _Chosen, _pairs, _visited, design
from retuner.adaptive.schedule_choice.scheduling_variables import SchedulingVariable, direction, follows_loop
from retuner.adaptive.schedule_design.agreement import agreement
from retuner.adaptive.schedule_design.joint import At, CurveForm
from retuner.adaptive.schedule_design.motion import Batch, Local, response
from retuner.adaptive.schedule_design.places import SECOND_LAG, DesignLimits, moved
from retuner.adaptive.schedule_design.record_stretches import KNOTS, LEVEL_STD, CurveAxis, CurveShape, cut, signals_of
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.scheduling import ScheduleDesign


@cache
def found(growth: float = GROWTH, load: float = 0.0) -> ScheduleDesign:
    return retuner.design_schedule(record(growth, load=load), "pv")


def truth(y: float, growth: float) -> ProcessModel:
    return ProcessModel(ProcessType.FOPDT, C * tau_s(y, growth), tau_s(y, growth), 0.0, THETA_S)


@pytest.mark.slow
@pytest.mark.uncounted
def test_the_course_of_the_lag_lies_inside_its_band_and_the_rest_is_constant() -> None:
    design = found()
    curves = design.design.curves
    for x in np.linspace(22, 78, 8).tolist():
        ln, std = curves.ln(np.array([x]))[0], np.sqrt(np.diag(curves.ln_covariance(x)))
        wanted = np.log([C, THETA_S, tau_s(x)])
        assert np.all(np.abs(ln[:3] - wanted) < 3 * std + 0.05), x
    assert curves.form.shapes[2] > CurveShape.CONSTANT
    assert curves.form.shapes[:2] == (CurveShape.CONSTANT, CurveShape.CONSTANT)
    assert curves.evidence > 10


@pytest.mark.slow
def test_every_place_of_the_true_process_is_in_spec_with_the_schedule() -> None:
    design = found()
    for place in design.places:
        assert place.known
        assert sensitivity_peak(truth(place.x, GROWTH).seen_by_controller(1.0).linear(), design.gains_at(place.x)) < 1.8
        assert place.judged(design.gains_at(place.x)).j <= 1.25


@pytest.mark.slow
@pytest.mark.uncounted
@pytest.mark.parametrize("load", [0.0, 15.0])
def test_a_process_that_is_the_same_everywhere_gets_one_region(load: float) -> None:
    design = found(0.0, load)
    assert set(design.design.curves.form.shapes) == {CurveShape.CONSTANT}
    assert len(design.table.gains) == 1
    assert design.model_at(50.0).slope == pytest.approx(C, rel=0.1)


@pytest.mark.slow
def test_a_load_step_is_found_and_not_taken_for_the_process() -> None:
    design = found(0.0, 15.0)
    joint, sizes = design.design.curves.joint, design.design.curves.now.sizes
    entered = [
        (float(stretch.t_s[rows[0]]), float(np.sum(size)))
        for stretch, rows, size in zip(joint.stretches, joint.loads, sizes, strict=True)
        if rows
    ]
    assert any(abs(t - 675) < 12 and abs(size - 15) < 2 for t, size in entered), entered


@pytest.mark.slow
def test_the_variable_that_matters_is_chosen_among_others() -> None:
    window = record()
    n = len(window.t_s)
    design = retuner.design_schedule(window, ["room", "pv"], values={"room": [100 + slow_sine(n)]})
    assert design.variable == "pv"
    assert [e.variable for e in design.design.candidates][:2] == ["room", "pv"]
    assert not design.second


def test_a_reverse_acting_process_is_seen_as_one() -> None:
    window = record()
    mirrored = Window(window.t_s, window.sp, window.pv, 100 - window.co)
    assert direction([window]) == 1
    assert direction([mirrored]) == -1


@pytest.mark.slow
def test_gains_in_force_are_read_off_and_judged() -> None:
    design = found()
    before = design.before_at(50.0)
    assert (before.kp, before.kp / before.ki) == pytest.approx((1.2, 40.0), rel=0.05)


@pytest.mark.slow
def test_the_next_experiment_moves_pv_visibly_and_ends() -> None:
    wanted = found().next_experiment
    assert min(abs(p.x - wanted.x) for p in found().places) == 0
    assert abs(wanted.sp_step) >= 20 * 0.1
    assert math.isfinite(wanted.hold_s)
    assert wanted.hold_s > THETA_S


# ---- Stretches that differ by more than their samples explain make the curves through them less sure, and only
# these

FORM = CurveForm(CurveAxis(0.0, 1.0), (CurveShape.CONSTANT, CurveShape.CONSTANT), (0.0, 0.0), 1)
ROWS, STRETCHES = 100, 40


def fitted(std):
    """Linear responses of which ln p of the first parameter differs by std between the stretches; white noise of 1."""
    rng = np.random.default_rng(7)
    first, second = np.sin(np.arange(ROWS) / 7), np.cos(np.arange(ROWS) / 3)
    jacobian = np.tile(10 * LEVEL_STD * np.stack([first, second], axis=1), (STRETCHES, 1))
    off = np.repeat(std * rng.standard_normal(STRETCHES), ROWS)
    r = rng.standard_normal(ROWS * STRETCHES) - jacobian[:, 0] / LEVEL_STD * off
    z = np.zeros(2)
    return At(z, r, (), jacobian, np.zeros(STRETCHES), ())


@pytest.mark.parametrize("std", [0.0, 0.25])
def test_differences_are_found_where_they_are(std):
    found = agreement(FORM, fitted(std), [ROWS] * STRETCHES, 1.0)

    assert found.differences == pytest.approx((std, 0.0), abs=0.03)
    told = LEVEL_STD * np.sqrt(np.diag(np.linalg.inv(found.normal)))
    sampling = 1 / math.sqrt(100 * ROWS / 2 * STRETCHES)
    assert told[0] == pytest.approx(math.hypot(sampling, std / math.sqrt(STRETCHES)), rel=0.2)
    assert told[1] == pytest.approx(sampling, rel=0.2)


# ---- The process in motion against exact responses, and the shapes of curves


def stepped(n: int, at: int) -> Window:
    t = np.arange(n, dtype=np.float64)
    co = np.where(t < at, 0.0, 1.0)
    return Window(t, np.zeros(n), np.sin(t), co)


@given(st.floats(0.2, 6.0), st.floats(3.0, 200.0), st.floats(0.1, 5.0))
def test_a_constant_process_answers_as_a_first_order_lag_with_dead_time(theta: float, tau: float, b: float) -> None:
    window = stepped(200, 10)
    stretch = cut(signals_of(window, window.pv, 1))[0]
    batch = Batch.of([stretch])
    shape = (len(batch.pv), 1, 1)
    local = Local(*(np.full(shape, np.log(p)) for p in (b, theta, tau)), None)
    y = response(local, batch.arriving(np.full(shape, theta)), batch.h_s)[:, 0, 0]
    since = np.maximum(np.arange(200) - 10 - theta, 0.0)
    exact = b * tau * (1 - np.exp(-since / tau))
    assert np.max(np.abs(y - exact)) < 0.13 * b  # a step within an interval is one of its mean: second order in 1/tau
    assert y[-1] == pytest.approx(exact[-1], rel=0.02)


def test_a_second_lag_delays_by_itself() -> None:
    window = stepped(300, 10)
    batch = Batch.of([cut(signals_of(window, window.pv, 1))[0]])
    shape = (300, 1, 1)
    local = Local(*(np.full(shape, np.log(p)) for p in (0.1, 2.0, 30.0, 6.0)))
    y = response(local, batch.arriving(np.full(shape, 2.0)), batch.h_s)[:, 0, 0]
    since = np.maximum(np.arange(300) - 12.0, 0.0)
    exact = 3.0 * (1 - (30 * np.exp(-since / 30) - 6 * np.exp(-since / 6)) / 24)
    assert np.max(np.abs(y - exact)) < 0.01


@given(st.floats(-50, 50), st.floats(0.1, 100))
def test_bends_hold_no_line_and_shapes_are_nested(low: float, width: float) -> None:
    axis = CurveAxis(low, low + width)
    x = axis.grid(KNOTS)
    bent = axis.columns(x, CurveShape.BENT)
    line = axis.columns(x, CurveShape.LINE)
    assert bent[:, :2] == pytest.approx(line)
    assert np.abs(line.T @ bent[:, 2:]).max() < 1e-9
    assert axis.columns(np.array([low - 9.0]), CurveShape.BENT)[0] == pytest.approx(bent[0])


def test_stretches_begin_before_setpoint_changes_and_end_with_the_record() -> None:
    t = np.arange(1000, dtype=np.float64)
    window = Window(t, np.where(t < 300, 1.0, 2.0), np.sin(t), np.cos(t))
    stretches = cut(signals_of(window, window.pv, 1))
    assert stretches[1].changed
    assert stretches[1].t_s[0] == 296.0
    assert sum(map(len, stretches)) == 1000
    assert max(map(len, stretches)) <= 400


def test_means_keep_the_integral_of_the_output() -> None:
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.5, 1.5, 600))
    co = rng.normal(size=600)
    signals = signals_of(Window(t, np.zeros(600), rng.normal(size=600), co), co, 4)
    assert signals.fired[-1] == pytest.approx(float(np.sum(co * np.diff(t, append=t[-1] + np.median(np.diff(t))))))


# ---- Models that are still allowed at a place: as far from the likeliest as the record's own derivatives say

LN = np.log(np.array([0.004, 90.0, 600.0, 2.0]))


def test_a_second_lag_that_is_hardly_known_is_no_lag_of_minutes() -> None:
    way = np.array([0.0, -0.05, 0.0, 5.3])

    far = np.exp(moved(LN, way))

    assert far[SECOND_LAG] == pytest.approx(2.0 * 6.3)
    assert far[1] == pytest.approx(90.0 * math.exp(-0.05))
    assert np.exp(moved(LN, -way))[SECOND_LAG] == pytest.approx(2.0 * math.exp(-5.3))


def test_what_is_known_well_moves_as_its_logarithm_does() -> None:
    way = np.array([0.04, 0.02, -0.03, 0.01])

    assert moved(LN, way) == pytest.approx(LN + way, abs=1e-4)
    assert moved(LN[:3], way[:3]) == pytest.approx((LN + way)[:3], abs=1e-12)


# ---- Ends that a person gives are of the places: the fit, and what counts as visited, are of the records

PV = SchedulingVariable("pv", (np.linspace(20.0, 80.0, 500),))
FLOW = SchedulingVariable("flow", (np.repeat([1.0, 2.0, 3.0], 200),))
STILL = SchedulingVariable("F", (np.ones(500),))


def test_the_fit_is_over_all_that_the_records_visit(monkeypatch: pytest.MonkeyPatch) -> None:
    axes = []

    def seen(_windows: object, _candidate: object, axis: CurveAxis, _told: object) -> None:
        axes.append((axis.low, axis.high))
        raise InterruptedError

    monkeypatch.setattr(designing, "curves_along", seen)
    for span in ((30.0, 50.0), (0.0, 400.0), (None, None)):
        with pytest.raises(InterruptedError):
            design([record()], [PV], DesignLimits(), "auto", span, lambda *_: None)
    assert axes == [PV.span()] * 3


def test_wide_ends_make_nothing_far_off_known() -> None:
    axis, axis2 = CurveAxis(*PV.span()), SimpleNamespace(axis=CurveAxis(*FLOW.span()))
    been = SimpleNamespace(x=np.array([20.0, 50.0, 80.0]), x2=np.array([1.0, 2.0, 3.0]))
    curves = SimpleNamespace(form=SimpleNamespace(axis=axis, second=axis2), joint=SimpleNamespace(stretches=[been] * 2))
    chosen = _Chosen(PV, FLOW, curves)
    places = [SimpleNamespace(x=x, x2=x2) for x, x2 in ((50.0, 2.0), (20.0, 3.0), (80.0, 3.1), (93.0, 3.0))]
    assert _visited(chosen, places) == [True, False, True, False]
    assert _visited(_Chosen(PV, None, curves), places) == [True, True, True, False]


def test_ends_are_of_the_variable_that_is_named_first() -> None:
    assert _able([STILL, PV], (None, None)) == [PV]
    assert _able([PV, STILL], (0.0, 100.0)) == [PV]
    with pytest.raises(ValueError, match=r"F: does not move.*low and high are its ends"):
        _able([STILL, PV], (0.0, 100.0))
    with pytest.raises(ValueError, match="F: moves no more than its noise"):
        _able([STILL], (None, None))


# A variable that goes after the loop is told from one that comes from outside


def lagged(x: FloatArray, lag_s: float) -> FloatArray:
    found = np.empty_like(x)
    found[0] = x[0]
    for i in range(1, len(x)):
        found[i] = found[i - 1] + (x[i] - found[i - 1]) / lag_s
    return found


@pytest.mark.parametrize("lag_s", [1.0, 20.0, 60.0])
def test_a_filtered_signal_of_the_loop_follows_it(lag_s: float) -> None:
    window = record()
    for signal in (window.pv, window.co):
        assert follows_loop([window], [3.0 * lagged(signal, lag_s) - 7.0])
    assert not SchedulingVariable("T2", (window.pv,), follows=True).outside


def test_a_signal_from_outside_does_not() -> None:
    window = record()
    n = len(window.t_s)
    walk = np.cumsum(np.random.default_rng(2).normal(size=n))
    for other in (slow_sine(n), walk, np.repeat([10.0, 30.0, 20.0, 40.0], n // 4)):
        assert not follows_loop([window], [other])
    assert SchedulingVariable("flow", (walk,)).outside


def test_what_shows_nothing_alone_is_tried_beside_the_best_where_that_does_not_settle() -> None:
    sp, pv, flow, load = (SchedulingVariable(name, (np.arange(9.0),)) for name in ("sp", "pv", "flow", "load"))
    able = [sp, pv, flow, load]

    assert _pairs(flow, able, {"flow"}, settles=False) == [(sp, flow), (pv, flow), (flow, load)]
    assert _pairs(pv, able, set(), settles=False) == [(pv, flow), (pv, load)]
    assert _pairs(pv, able, {"pv", "load"}, settles=True) == [(pv, load)]
    assert _pairs(pv, able, set(), settles=True) == []
