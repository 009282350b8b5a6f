"""Level loops that swing slowly because k' Kc tau_I is small: named, with settings at k' Kc tau_I of 4."""

import numpy as np
import pytest

from retuner import PidGains, RecordDiagnosis, diagnose, identify
from retuner.adaptive.diagnosis.cause import Cause

SLOPE, TAU_I, DT = 0.01, 60.0, 6.0


def swinging(product: float, *, setpoint: bool, loads: int = 1) -> tuple[tuple[np.ndarray, ...], PidGains]:
    """A tank behind a fast valve under PI with that k' Kc tau_I, every 6 s: a step of its setpoint, or of its load."""
    kc, parts, n = product / (SLOPE * TAU_I), 12, 500
    pushed = np.zeros(n)
    for at in np.linspace(60, 440, loads).round().astype(int) if not setpoint else ():
        pushed[at:] += 5.0 * (-1) ** (at % 3)
    rng, h = np.random.default_rng(5), DT / parts
    pv, co, sp = np.zeros(n), np.zeros(n), np.zeros(n)
    level = valve = total = 0.0
    for i in range(n):
        sp[i] = 5.0 if setpoint and i >= 60 else 0.0
        pv[i] = level + 0.05 * rng.standard_normal()
        total += kc / TAU_I * DT * (sp[i] - pv[i])
        co[i] = kc * (sp[i] - pv[i]) + total
        for _ in range(parts):
            valve += h / 2.0 * (co[i] - valve)
            level += h * SLOPE * (valve + pushed[i])
    return (np.arange(n) * DT, sp, pv, co), PidGains(kc, kc / TAU_I)


def product_after(found: RecordDiagnosis) -> float:
    assert found.recommended is not None, found.diagnosis.reason
    return SLOPE * found.recommended.kp**2 / found.recommended.ki


@pytest.mark.slow
@pytest.mark.parametrize("product", [0.15, 0.4])
def test_after_a_load_the_swing_is_named_and_cured_whatever_the_dead_time(product: float) -> None:
    record, gains = swinging(product, setpoint=False)
    found = diagnose(*record, gains=gains)
    assert "too little k' Kc tau_I" in found.diagnosis.reason
    assert product_after(found) == pytest.approx(4.0, abs=0.2)
    assert found.recommended.kp >= gains.kp


@pytest.mark.slow
def test_under_more_loads_than_are_looked_for_parts_of_the_record_show_it() -> None:
    record, gains = swinging(0.3, setpoint=False, loads=10)
    found = diagnose(*record, gains=gains)
    assert found.cause is Cause.SLOW_INTEGRATING
    assert product_after(found) == pytest.approx(4.0, abs=0.2)


def test_after_a_setpoint_step_diagnose_has_settings_as_identify_has() -> None:
    record, gains = swinging(0.3, setpoint=True)
    told, identified = diagnose(*record, gains=gains), identify(*record, gains=gains)
    assert product_after(told) == pytest.approx(4.0, abs=0.25)
    assert told.recommended.kp == pytest.approx(identified.recommended.kp, rel=0.25)
