"""Curves through records of a process whose course is known."""

import math
from functools import cache

import numpy as np
import pytest
from schedule_cases import GROWTH, THETA_S, C, record, slow_sine, tau_s

import retuner
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.schedule_choice.candidates import direction
from retuner.adaptive.schedule_design.stretches import Shape
from retuner.adaptive.signals.sample import Window
from retuner.scheduling import ScheduleDesign


@cache
def found(growth: float = GROWTH, load: float = 0.0) -> ScheduleDesign:
    return retuner.design_schedule(record(growth, load=load), "pv")


def truth(y: float, growth: float) -> ProcessModel:
    return ProcessModel(ProcessType.FOPDT, C * tau_s(y, growth), tau_s(y, growth), 0.0, THETA_S)


@pytest.mark.uncounted
def test_the_course_of_the_lag_lies_inside_its_band_and_the_rest_is_constant() -> None:
    design = found()
    curves = design.design.curves
    for x in np.linspace(22, 78, 8).tolist():
        ln, std = curves.ln(np.array([x]))[0], np.sqrt(np.diag(curves.ln_covariance(x)))
        wanted = np.log([C, THETA_S, tau_s(x)])
        assert np.all(np.abs(ln[:3] - wanted) < 3 * std + 0.05), x
    assert curves.form.shapes[2] > Shape.CONSTANT
    assert curves.form.shapes[:2] == (Shape.CONSTANT, Shape.CONSTANT)
    assert curves.evidence > 10


def test_every_place_of_the_true_process_is_in_spec_with_the_schedule() -> None:
    design = found()
    for place in design.places:
        assert place.known
        assert sensitivity_peak(truth(place.x, GROWTH).seen_by_controller(1.0).linear(), design.gains_at(place.x)) < 1.8
        assert place.judged(design.gains_at(place.x)).j <= 1.25


@pytest.mark.uncounted
@pytest.mark.parametrize("load", [0.0, 15.0])
def test_a_process_that_is_the_same_everywhere_gets_one_region(load: float) -> None:
    design = found(0.0, load)
    assert set(design.design.curves.form.shapes) == {Shape.CONSTANT}
    assert design.table is not None
    assert len(design.table.gains) == 1
    assert design.model_at(50.0).slope == pytest.approx(C, rel=0.1)


def test_a_load_step_is_found_and_not_taken_for_the_process() -> None:
    design = found(0.0, 15.0)
    joint, sizes = design.design.curves.joint, design.design.curves.now.sizes
    entered = [
        (float(stretch.t_s[rows[0]]), float(np.sum(size)))
        for stretch, rows, size in zip(joint.stretches, joint.loads, sizes, strict=True)
        if rows
    ]
    assert any(abs(t - 675) < 12 and abs(size - 15) < 2 for t, size in entered), entered


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


def test_gains_in_force_are_read_off_and_judged() -> None:
    design = found()
    before = design.before_at(50.0)
    assert before is not None
    assert (before.kp, before.kp / before.ki) == pytest.approx((1.2, 40.0), rel=0.05)


def test_the_next_experiment_moves_pv_visibly_and_ends() -> None:
    wanted = found().next_experiment
    assert min(abs(p.x - wanted.x) for p in found().places) == 0
    assert abs(wanted.sp_step) >= 20 * 0.1
    assert math.isfinite(wanted.hold_s)
    assert wanted.hold_s > THETA_S
