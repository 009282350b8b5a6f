"""A response that crosses a boundary is fitted in motion, and teaches the regions on its way what it shows of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from retuner import PidGains, ProcessModel, ProcessType, Regions
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.identify import Fits, FitSettings
from retuner.adaptive.identification.structure_choice import ON_LINE
from retuner.adaptive.region_model.boundary_crossing import (
    Crossing,
    FittedCrossing,
    fitted_crossing,
    in_motion,
    taught_beside,
    update_across,
)
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import Agreement, TrackerSettings
from retuner.adaptive.schedule_design.record_stretches import CurveAxis
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.regions import Axis as TableAxis

REGIONS = Regions("pv", "-", ("low", "middle", "high"), 0.0, (40.0, 60.0), 100.0)
GAINS = PidGains(2.0, 0.05)
FIT = FitSettings(ON_LINE, gain_std_limit=0.3)
TAU_S, THETA_S = 40.0, 8.0
AT_REST = 50


def steep(y: float) -> float:
    """Gain of a process whose gain falls by four from 0 to 100."""
    return 2.0 * 4.0 ** (-y / 100.0)


def resting(y: float) -> float:
    """What holds it: the integral of dy/k."""
    return 100.0 / (2.0 * math.log(4.0)) * (4.0 ** (y / 100.0) - 1.0)


def step(low: float, high: float, seconds: int = 500) -> Window:
    """tau dy/dt = k(y) (u(t - theta) - rest(y)) under PI, a setpoint step, noise of 0.05."""
    rng = np.random.default_rng(3)
    y, integral, past, rows = low, resting(low), [resting(low)] * int(THETA_S), []
    for t in range(seconds):
        sp, pv = high if t >= AT_REST else low, y + 0.05 * rng.standard_normal()
        integral += GAINS.ki * (sp - pv)
        co = integral + GAINS.kp * (sp - pv)
        rows.append((float(t), sp, pv, co))
        past.append(co)
        u = past.pop(0)
        for _ in range(4):
            y += 0.25 / TAU_S * steep(y) * (u - resting(y))
    return Window(*(np.array(column) for column in zip(*rows, strict=True)))


def crossing(window: Window, known: dict[int, RegionModel] | None = None, regions: Regions = REGIONS) -> Crossing:
    ways: tuple[FloatArray, ...] = (window.pv,) if regions.second is None else (window.pv, 0 * window.pv + 30.0)
    return Crossing(window, ways, float(AT_REST), GAINS, regions, known or {}, TrackerSettings(), FIT)


@pytest.fixture(scope="module")
def record() -> Window:
    return step(35.0, 85.0)


@pytest.fixture(scope="module")
def shown(record: Window) -> FittedCrossing:
    return fitted_crossing(crossing(record))


def test_a_linear_model_of_a_long_step_is_a_fiction_and_one_in_motion_is_not(record: Window) -> None:
    alone = Fits(record, (1,), FIT).estimate()
    linear = alone.log.model()
    assert not 0.85 < linear.tau1_s / TAU_S < 1.2
    found = in_motion(record, record.pv, CurveAxis(0.0, 100.0), alone)[0]
    for place in (40.0, 55.0, 75.0):
        model = found.at(place).model()
        assert model.k == pytest.approx(steep(place), rel=0.2)
        assert model.tau1_s == pytest.approx(TAU_S, rel=0.2)
        assert model.theta_s + model.tau2_s / 2 == pytest.approx(THETA_S, rel=0.2)


def test_what_lies_beyond_the_way_is_known_less(shown: FittedCrossing) -> None:
    unsure = [shown.found[0].at(place).gain_uncertainty() for place in (60.0, 90.0, 100.0)]
    assert unsure[0] < unsure[1] < unsure[2]
    assert unsure[0] < 0.35  # half way, a valve's curve may stand for what pv does (0.22 if there were none)


R = math.log(30.0)


@pytest.mark.parametrize(("low", "high"), [(26.0, 46.0), (73.0, 50.0)])
def test_a_curve_of_the_valve_is_not_taken_for_lags_and_bends(low: float, high: float) -> None:
    rng, theta, opened = np.random.default_rng(5), 10, lambda h: 100.0 + 100.0 * math.log(math.sqrt(h) / 10) / R
    h, integral, past, rows = low, opened(low), [opened(low)] * theta, []
    for t in range(900):
        sp, pv = high if t >= AT_REST else low, h + 0.05 * rng.standard_normal()
        integral += 0.012 * (sp - pv)
        co = integral + 1.0 * (sp - pv)
        rows.append((float(t), sp, pv, co))
        past.append(co)
        u = past.pop(0)
        for _ in range(4):
            h += 0.25 * (10.0 * math.exp(R * (u / 100 - 1)) - math.sqrt(h)) / 12
    window = Window(*(np.array(column) for column in zip(*rows, strict=True)))
    found = in_motion(window, window.pv, CurveAxis(8.0, 90.0), Fits(window, (1,), FIT).estimate())[0]
    for level in (low, high):
        here = found.at(level).model()
        assert here.k / (here.tau1_s + here.tau2_s) == pytest.approx(math.sqrt(level) * R / 1200, rel=0.25)
        assert here.theta_s + here.tau2_s / 2 == pytest.approx(10.5, rel=0.25)


def test_it_teaches_the_region_where_it_ends_and_those_on_its_way(record: Window, shown: FittedCrossing) -> None:
    whole = crossing(record)
    assert whole.passed() == [0, 1, 2]
    learned, beside = update_across(whole, shown, 2, None), taught_beside(whole, shown, 2)
    assert learned.agreement is Agreement.FIRST
    assert set(beside) <= {0, 1}
    assert 1 in beside
    assert beside[1].log.model().k == pytest.approx(steep(50.0), rel=0.2)
    assert (learned.region_model.records, learned.region_model.points[0].x) == (1, 80.0)


def test_a_second_one_agrees_and_makes_it_surer(record: Window, shown: FittedCrossing) -> None:
    first = update_across(crossing(record), shown, 1, None).region_model
    assert first is not None
    back = replace(step(85.0, 35.0), t_s=record.t_s + 600.0)
    again = replace(crossing(back, {1: first}), start_s=650.0)
    learned = update_across(again, fitted_crossing(again), 1, first)
    assert learned.agreement is Agreement.AGREES
    assert learned.region_model.records == 2


@pytest.mark.parametrize(("std", "leads"), [(0.3, ProcessType.FOPDT), (0.05, ProcessType.TOPDT)])
def test_a_structure_that_it_cannot_show_leads_on_only_where_it_is_known(record, shown, std, leads):
    first = update_across(crossing(record), shown, 1, None).region_model
    assert first is not None
    third = parameters_of(ProcessModel(ProcessType.TOPDT, steep(50.0), 20.0, 15.0, 3.0, tau3_s=5.0))
    led = StructureModel(LogModel(third, std**2 * np.eye(5), 1, ProcessType.TOPDT), -500.0)
    odd = replace(first, known=(led, *first.known))
    learned = update_across(crossing(record, {1: odd}), shown, 1, odd)
    assert learned.agreement is Agreement.AGREES
    assert learned.region_model.log.type is leads
    assert learned.region_model.identifiable
    assert learned.region_model.log.gain_uncertainty() < first.log.gain_uncertainty()


def test_it_never_overrules_what_the_region_has_shown_itself(record: Window, shown: FittedCrossing) -> None:
    own = update_across(crossing(record), shown, 1, None).region_model
    assert own is not None
    other = tuple(
        replace(k, log=replace(k.log, x=k.log.x + math.log(3.0), p=1e-4 * np.eye(len(k.log.x)))) for k in own.known
    )
    wrong = replace(own, known=other)
    learned = update_across(crossing(record, {1: wrong}), shown, 1, wrong)
    assert learned.agreement is Agreement.CONTRADICTS
    assert learned.region_model is wrong
    assert 1 not in taught_beside(crossing(record, {1: wrong}), shown, 2)


def test_without_anything_to_see_it_teaches_nothing() -> None:
    quiet = step(50.0, 50.0)
    learned = update_across(crossing(quiet), fitted_crossing(crossing(quiet)), 1, None)
    assert learned.agreement is Agreement.SILENT
    assert learned.region_model is None


def test_on_a_map_the_other_axis_makes_it_less_sure(record: Window, shown: FittedCrossing) -> None:
    flow = TableAxis("can", "%", 0.0, (50.0,), 100.0, signal="flow")
    first = TableAxis("pv", "-", 0.0, (40.0, 60.0), 100.0)
    whole = crossing(record, regions=Regions.along(tuple("abcdef"), first, flow))
    assert whole.along == 0
    assert whole.passed() == [0, 2, 4]
    one, two = (update_across(whole, shown, region, None).estimate.log.gain_uncertainty() for region in (2, 3))
    assert one < two
