"""Ends that a person gives are of the places: the fit, and what counts as visited, are of the records."""

from types import SimpleNamespace

import numpy as np
import pytest
from schedule_cases import record

from retuner.adaptive.schedule_choice import design as designing
from retuner.adaptive.schedule_choice.candidates import Candidate
from retuner.adaptive.schedule_choice.design import _able, _Chosen, _visited, design
from retuner.adaptive.schedule_design.places import DesignLimits
from retuner.adaptive.schedule_design.stretches import Axis

PV = Candidate("pv", (np.linspace(20.0, 80.0, 500),))
FLOW = Candidate("flow", (np.repeat([1.0, 2.0, 3.0], 200),))
STILL = Candidate("F", (np.ones(500),))


def test_the_fit_is_over_all_that_the_records_visit(monkeypatch: pytest.MonkeyPatch) -> None:
    axes = []

    def seen(_windows: object, _candidate: object, axis: Axis, _told: object) -> None:
        axes.append((axis.low, axis.high))
        raise InterruptedError

    monkeypatch.setattr(designing, "curves_along", seen)
    for span in ((30.0, 50.0), (0.0, 400.0), (None, None)):
        with pytest.raises(InterruptedError):
            design([record()], [PV], DesignLimits(), "auto", span, lambda *_: None)
    assert axes == [PV.span()] * 3


def test_wide_ends_make_nothing_far_off_known() -> None:
    axis, axis2 = Axis(*PV.span()), SimpleNamespace(axis=Axis(*FLOW.span()))
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
