"""A shift of a plain loop as a historian exports it: setpoint steps, loads, noise, raw counts, few points."""

import numpy as np
import pytest

from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.tuning_verdict import _unexplained
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.indexes.recording_quality import hidden_sigma, recording_quality
from retuner.adaptive.signals.sample import Window

DT, KC, TAU_I = 2.0, 0.6, 60.0
SETPOINTS = ((1000, 8.0), (3000, -8.0), (5500, 8.0), (8000, -5.0), (10000, 3.0))
LOADS = ((2000, 6.0), (4200, -6.0), (7000, 8.0), (9000, -8.0))


def made(step: float = 0.0) -> Window:
    """e^-14s / (60 s + 1) under PI control, 3 h 20 min. step : of a coarse sensor, which has little noise."""
    rng, n = np.random.default_rng(3), 6000
    t = np.arange(n) * DT
    sp, load = (sum(np.where(t >= at, size, 0.0) for at, size in steps) for steps in (SETPOINTS, LOADS))
    pv, co = np.empty(n), np.empty(n)
    past, x, integral = [0.0] * 7, 0.0, 0.0
    for i in range(n):
        pv[i] = x + (0.05 if step else 0.15) * rng.standard_normal()
        pv[i] = round(pv[i] / step) * step if step else pv[i]
        integral += KC / TAU_I * (sp[i] - pv[i]) * DT
        co[i] = KC * (sp[i] - pv[i]) + integral
        past.append(co[i])
        x += DT / 60.0 * (past.pop(0) + load[i] - x)
    return Window(t, 45.0 + sp, 45.0 + pv, 40.0 + co)


RECORD = made()


def test_loads_of_a_long_record_are_found_and_not_taken_for_coloured_noise() -> None:
    found = identify_window(RECORD, 1)
    assert found.identifiable
    assert found.log.model().k == pytest.approx(1.0, rel=0.03)
    assert sorted(found.load_times_s) == pytest.approx([at for at, _ in LOADS], abs=10.0)
    assert found.residual_std < 1.1 * found.noise_std


def test_as_many_loads_as_explain_anything_need_more_setpoint_steps() -> None:
    settings = DiagnosisSettings()
    assert _unexplained(5.0, 4.0, 1.0, settings) == ""
    assert "so many would explain any" in _unexplained(4.0, 4.0, 1.0, settings)


def test_counts_of_a_converter_make_no_derivative_of_a_slow_filter() -> None:
    per = 276.48
    counts = Window(RECORD.t_s, *(np.round(per * x) for x in (RECORD.sp, RECORD.pv, RECORD.co)))
    found = settings_in_force(counts)
    assert found.gains.kd == 0.0
    assert found.gains.kp == pytest.approx(KC, rel=0.05)


def test_of_few_points_nobody_says_that_there_is_only_noise() -> None:
    rng = np.random.default_rng(1)
    few = Window(np.arange(30.0), np.full(30, 1.0), 1 + rng.standard_normal(30), 5 + rng.standard_normal(30))
    assert diagnose_window(few, None).diagnosis.cause is Cause.UNKNOWN


def test_lines_of_a_historian_are_seen_though_they_were_printed_with_three_decimals() -> None:
    kept = np.unique(np.random.default_rng(5).choice(6000, 60, replace=False))
    drawn = np.interp(np.arange(6000.0), kept, RECORD.pv[kept])
    quality = recording_quality(np.round(drawn, 3))
    assert quality.compression > 5.0
    assert hidden_sigma(np.round(drawn, 3)) > 0.005
    smooth = np.round(50 + 8 * np.exp(-np.arange(200) / 60.0), 3)
    for honest in (np.round(RECORD.pv, 3), smooth):
        told = recording_quality(honest)
        assert told.compression < 2.0


def test_straight_lines_of_co_under_a_coarse_sensor_are_integral_action_and_no_compression() -> None:
    coarse = made(step=0.5)
    found = settings_in_force(coarse)
    assert found.gains.ki == pytest.approx(KC / TAU_I, rel=0.05)
