"""A swing without setpoint steps is the loop's own where the loop explains it and a tone does not; and a model that
would be unstable is refuted by a record that does not grow, whatever a second fit says.
"""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_diagnose import DT, GOOD, loop, times

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.tuning_verdict import JudgedLoop, _doubt, _tone_doubt
from retuner.adaptive.identification.identify import Fits, FitSettings

STRONG = times(3.2, 4.0)  # Ms about 6: a pulse rings for some ten cycles


def pulses(i: int) -> float:
    """Two rectangular loads, long enough apart for the swing to decay in between."""
    return 1.0 if 60 <= i < 90 or 380 <= i < 410 else 0.0


def test_pulses_of_load_show_that_the_loop_itself_rings() -> None:
    found = diagnose_window(loop(STRONG, load=pulses), STRONG)
    assert found.diagnosis.cause in {Cause.AGGRESSIVE, Cause.SLOW_INTEGRATING}, found.diagnosis.reason
    assert found.diagnosis.evidence["external_lead"] < -DiagnosisSettings().tone_odds


def test_a_tone_from_outside_at_the_loops_own_period_is_still_from_outside() -> None:
    def tone(i: int) -> float:
        return 0.4 * np.sin(2 * np.pi * i * DT / 14.0)

    found = diagnose_window(loop(GOOD, load=tone), GOOD)
    assert not found.diagnosis.retune, found.diagnosis.reason


def test_a_short_record_of_a_sinusoid_and_one_setpoint_step_is_no_loop_at_its_limit() -> None:
    """Four periods: the loop by itself explains them with load steps, at the edge of instability."""
    tone = loop(
        GOOD, sp=lambda i: float(i >= 250), out=lambda i: 0.5 * np.sin(2 * np.pi * i * DT / 45.0), seed=2, n=400
    )
    found = diagnose_window(tone, GOOD).diagnosis
    assert found.cause is Cause.EXTERNAL, found.reason
    assert found.evidence["external_period_s"] == pytest.approx(45.0, rel=0.02)
    assert found.reason.endswith(" without, with 6 load steps"), found.reason


@pytest.mark.parametrize(("ms", "asked"), [(float("inf"), False), (2.5, True)])
def test_what_the_record_refutes_is_not_put_to_a_second_opinion(ms: float, asked: bool) -> None:
    window = loop(GOOD, sp=lambda i: float(i >= 80))
    evidence = {"setpoint_steps": 1.0, "loads": 5.0, "linear_left": 1.1, "external_left": 1.1, "ms": ms}
    verdict = Diagnosis(Cause.AGGRESSIVE, 1.0, evidence, "by the fit")
    of = JudgedLoop(window, GOOD, [], Fits(window, (1,), FitSettings()), DiagnosisSettings())
    doubt = _doubt(verdict, of, oscillates=False)
    assert doubt.may_be_asked is asked


@pytest.mark.parametrize(
    ("ms", "setpoint_steps", "cause", "may_be_asked"),
    [
        (3.0, 0.0, Cause.EXTERNAL, True),  # a loop that decays: a second fit may settle it
        (97.0, 0.0, Cause.EXTERNAL, False),  # one that all but swings, as any tone makes it
        (math.inf, 0.0, Cause.EXTERNAL, True),  # one past its boundary grows
        (97.0, 1.0, Cause.EXTERNAL, True),  # a setpoint step shows where it stands
    ],
)
def test_that_a_loop_stands_at_its_boundary_is_a_coincidence(ms, setpoint_steps, cause, *, may_be_asked):
    settings = DiagnosisSettings()
    fit = SimpleNamespace(p=[math.log(2 * math.pi / 10.0)], misfit=SimpleNamespace(record=SimpleNamespace(span_s=40.0)))
    loop: Any = SimpleNamespace(settings=settings, tone=SimpleNamespace(fit=fit))
    evidence = {"ms": ms, "external_lead": 0.1, "external_left": 0.99, "linear_left": 1.15}
    if setpoint_steps:
        evidence |= {"setpoint_steps": setpoint_steps}
    doubt = _tone_doubt(loop, evidence, explained=True)
    assert (doubt.cause, doubt.may_be_asked) == (cause, may_be_asked)
