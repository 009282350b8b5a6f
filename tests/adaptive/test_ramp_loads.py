"""A load that moves along a ramp is two corners, not a row of steps; and the process is found beside it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.diagnosis.oscillation_online import SwingSettings
from retuner.adaptive.diagnosis.second_opinion import last_two
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import EXACT, refine
from retuner.adaptive.identification.candidate import judged
from retuner.adaptive.identification.identify import FitSettings, fitted, identify_window
from retuner.adaptive.identification.loads import (
    _load_elsewhere,
    _merged,
    _with_load,
    _with_rounding,
    _without_load,
    _without_rounding,
)
from retuner.adaptive.identification.structure_choice import asked_for
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import LoopSample, Window

K, LAG_S, THETA_S = 2.0, 30.0, 6.0
BEGINS_S, LASTS_S = 60.0, 90.0
DT, N = 1.0, 400


def recorded(*, ramp_s: float = LASTS_S, sp: float = 0.0, seed: int = 2) -> Window:
    """PI on a lag with dead time; the load moves to 1 along a ramp, and stays."""
    rng, t = np.random.default_rng(seed), DT * np.arange(N)
    load = np.clip((t - BEGINS_S) / max(ramp_s, 1e-9), 0.0, 1.0)
    y, integral, late = 0.0, 0.0, int(THETA_S / DT)
    pv, co, u = np.zeros(N), np.zeros(N), np.zeros(N + late)
    target = np.where(t >= BEGINS_S, sp, 0.0)
    for i in range(N):
        pv[i] = y + 0.004 * rng.standard_normal()
        error = target[i] - pv[i]
        integral += 1.6 / 25 * error * DT
        co[i] = 1.6 * error + integral
        u[i + late] = co[i]
        drive = (u[i] if i >= late else 0.0) + load[i]
        y += (1 - math.exp(-DT / LAG_S)) * (K * drive - y)
    return Window(t, target, pv, co)


def test_a_ramp_is_found_as_two_corners_and_the_process_beside_it() -> None:
    best = fitted(recorded(), (1,), FitSettings())[0].fit
    model = identify_window(recorded(), 1).log.model()

    assert (best.misfit.loads, best.misfit.corners) == (2, 2)
    assert best.load_times_s == pytest.approx((BEGINS_S, BEGINS_S + LASTS_S), abs=4.0)
    assert best.ramp_s == pytest.approx(LASTS_S, rel=0.05)
    assert model.theta_s == pytest.approx(THETA_S, rel=0.2)
    assert model.k / (model.tau1_s + model.tau2_s) == pytest.approx(K / LAG_S, rel=0.1)


@pytest.mark.parametrize(("ramp_s", "sp"), [(0.0, 0.0), (LASTS_S, 1.0)])
def test_a_sharp_load_and_a_setpoint_step_are_not_explained_by_ramps(ramp_s: float, sp: float) -> None:
    found = fitted(recorded(ramp_s=ramp_s, sp=sp), (1,), FitSettings())
    assert all(c.fit.misfit.corners == 0 for c in found)
    assert found[0].fit.ramp_s == 0.0


def test_ramps_are_asked_for_where_one_sharp_step_does_not_do() -> None:
    sharp, slow = (fitted(recorded(ramp_s=s), (1,), FitSettings())[0] for s in (0.0, LASTS_S))
    assert not asked_for(sharp)
    assert asked_for(slow)
    plain = replace(sharp.fit.misfit, rounded=True)
    assert asked_for(replace(sharp, fit=replace(sharp.fit, misfit=plain)))


def test_a_record_that_any_step_explains_is_searched_as_before() -> None:
    found = fitted(recorded(ramp_s=0.0), (1,), FitSettings())[0]
    assert found.fit.misfit.loads == 1
    assert found.fit.load_times_s[0] == pytest.approx(BEGINS_S, abs=2.0)


def test_moves_keep_steps_before_corners() -> None:
    record = Record.of(recorded())
    misfit = Misfit(record, ProcessType.FOPDT, 1, 4, record.noise_std, 0.3, corners=3, rounded=True)
    p = np.array([math.log(K / LAG_S), math.log(THETA_S), math.log(LAG_S), 20.0, 60.0, 150.0, 390.0, math.log(3.0)])
    at = judged(refine(misfit, p, enough=EXACT, evaluations=0))

    sharp, moved = _without_rounding(at) or pytest.fail("no such move")
    assert (sharp.loads, sharp.corners, sharp.rounded) == (4, 3, False)
    np.testing.assert_allclose(moved[3:], [23.0, 60.0, 150.0, 390.0])
    less, kept = _without_load(at, 0) or pytest.fail("no such move")
    assert (less.loads, less.corners, less.rounded) == (3, 3, False)
    np.testing.assert_allclose(kept[3:], [60.0, 150.0, 390.0])
    fewer, kept = _without_load(at, 3) or pytest.fail("no such move")
    assert (fewer.loads, fewer.corners, fewer.rounded) == (3, 2, True)
    np.testing.assert_allclose(kept[3:], [20.0, 60.0, 150.0, math.log(3.0)])
    assert _merged(at) is None
    assert _load_elsewhere(at, 0) is None
    only = judged(refine(less, np.array([*p[:3], 60.0, 150.0, 390.0]), evaluations=0))
    assert _with_rounding(only) is None
    more, longer = _with_load(only, 4) or pytest.fail("no such move")
    assert (more.loads, more.corners) == (4, 3)
    np.testing.assert_allclose(longer[-3:], [60.0, 150.0, 390.0])


def test_the_last_two_responses_are_what_is_looked_at_again() -> None:
    moves = {*range(20, 30), *range(60, 70), *range(100, 120)}
    samples = [LoopSample(float(i), 0.0, 1.0 if i in moves else 0.0, 0.0) for i in range(120)]
    response = Response(100.0, 119.0, (), Ending.QUIET, sp_changed=False, band=0.1)
    kept = last_two(samples, response, SwingSettings())
    assert 30 <= kept[0].t_s < 60.0  # the second of three
    restless = [sample._replace(pv=1.0) for sample in samples]
    assert last_two(restless, response, SwingSettings()) == restless
