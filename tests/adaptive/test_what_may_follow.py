"""What identification may say beside its model: what stands shows none, a first step, a bound, a start in motion."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.fit.dynamics import Dynamics, SamplingInstants
from retuner.adaptive.identification.identify import Fits, FitSettings, identify_window
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import Window
from retuner.api import _unless_pv_stands, identify, identify_record
from retuner.commands.recorded.identify import described
from retuner.commands.recorded.other_cause import contradiction
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.schedule.gains import SeriesGains

PLANT = Path(__file__).parent.parent / "data" / "plant"


def test_far_more_gain_from_one_event_is_a_first_step_with_the_aim_behind_it(loop: Callable) -> None:
    window = loop(sp=1.0, kc=0.8, tau_i=40.0, noise=0.005, n=1500).run(1)
    found = identify_record(window, gains=SeriesGains(0.8, 40.0).to_parallel())
    assert found.settings.tuning.gains.kp == pytest.approx(3 * 0.8, rel=0.01)
    assert found.aim.tuning.gains.kp == pytest.approx(5.0, rel=0.1)
    assert "first step" in found.step_reason
    assert any("final settings" in line for line in described(found))
    assert found.to_dict()["aim"] is not None


def test_what_is_in_reach_is_given_at_once(loop: Callable) -> None:
    window = loop(sp=1.0, kc=2.5, tau_i=40.0, noise=0.005, n=1500).run(1)
    found = identify_record(window, gains=SeriesGains(2.5, 40.0).to_parallel())
    assert found.settings is not None
    assert found.aim is None
    assert found.step_reason == ""


def test_a_model_of_a_valve_that_stands_is_not_believed(loop: Callable) -> None:
    estimate = identify_window(loop(sp=1.0, noise=0.01).run(1))
    assert estimate.identifiable
    stands = read_loop_record((PLANT / "FIC20102_1016_12.csv",)).recording.window()
    found = _unless_pv_stands(stands, None, replace(estimate, residual_std=0.5 * float(np.std(stands.pv))))
    assert not found.identifiable
    assert "does not move while co moves" in found.reason


def test_where_diagnosis_sees_another_cause_the_command_says_so() -> None:
    told = Diagnosis(Cause.STICTION, 0.8, {}, "a valve that sticks")
    assert "STICTION" in contradiction(told)[0]
    assert contradiction(None) == []
    untold = " ".join(contradiction(replace(told, cause=Cause.UNKNOWN)))
    assert "look at the record" in untold
    assert "resolve this" not in untold  # nothing is named that could be resolved


def manual(cut: int, steps: tuple[tuple[int, float], ...] = ((50, 1.0), (200, -0.5), (400, 0.6))) -> list[np.ndarray]:
    """A lag of 40 s with gain 2 and 6 s of dead time in manual, the rows before `cut` not recorded."""
    t, u, rng = np.arange(600.0), np.zeros(600), np.random.default_rng(5)
    for at, value in steps:
        u[at:] = value
    pv = 2 * Dynamics(0.0, 1 / 40).held(SamplingInstants.of(t), u, 6.0) / 40 + 0.01 * rng.standard_normal(600)
    return [x[cut:] for x in (t, np.zeros(600), pv + 30, u + 20)]


@pytest.mark.parametrize("cut", [0, 50, 60, 120, 199, 215, 399])
def test_a_manual_record_may_begin_in_motion_or_with_its_step(cut: int) -> None:
    found = identify(*manual(cut), open_loop=True)
    model, std = found.estimate.log.model(), found.estimate.log.std()
    assert found.estimate.identifiable
    assert model.k == pytest.approx(2.0, abs=max(0.03, 4 * std["k"]))
    assert model.theta_s + model.tau2_s / 2 == pytest.approx(6.0, rel=0.1)


def test_a_lag_without_visible_dead_time_gets_settings_from_the_bound(loop: Callable) -> None:
    window = loop(tau=30.0, theta=0.4, kc=1.0, tau_i=30.0, dt=4.0, n=400, sp=1.0, at=160.0, noise=0.004).run(2)
    found = identify_record(window)
    assert found.estimate.identifiable, found.estimate.reason
    assert "one sampling interval" in found.estimate.reason
    gains = found.settings.tuning.gains
    assert gains.kp == pytest.approx(30.0 / (2 * 6.0), rel=0.05)  # SIMC with a dead time of 4 s, and half a sample
    assert found.settings.margins.ms < 1.8


def test_the_freer_search_is_never_worse_than_the_one_without_coincident_loads(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.01, load=0.4, at=45.0).run(7)
    fits = Fits(window, (1,), FitSettings())
    assert fits.free[0].criterion <= fits.barred[0].criterion


def test_a_drifting_load_on_an_integrator_is_a_parabola_not_a_lag() -> None:
    rng, rows = np.random.default_rng(2), []
    x, integral, past = 0.0, 0.0, [0.0] * 5
    for i in range(900):
        sp, load = float(i >= 200), 0.004 * i
        pv = x + 0.01 * rng.standard_normal()
        integral += 0.05 * (sp - pv)
        past.append(2.0 * (sp - pv) + integral)
        rows.append((float(i), sp, pv, past[-1]))
        x += 0.05 * (past.pop(0) + load)
    found = identify_window(Window(*np.array(rows).T), 1)
    model = found.log.model()
    assert model.type == ProcessType.INTEGRATING
    assert model.slope == pytest.approx(0.05, rel=0.03)
    assert model.theta_s == pytest.approx(5.0, rel=0.15)


def test_a_model_that_leaves_much_beside_what_it_explains_is_not_identified(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.005, n=1200).run(3)
    swing = 0.12 * np.sign(np.sin(window.t_s / 9.0)) * np.abs(np.sin(window.t_s / 31.0))
    found = identify_window(Window(window.t_s, window.sp, window.pv + swing, window.co), 1)
    assert not found.identifiable
