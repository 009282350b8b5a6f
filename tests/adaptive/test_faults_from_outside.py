"""Faults that were found from outside: floats compared with 0, tones of nothing, ramps of historians, no dead time."""

import math
import random
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_diagnose import DT, GOOD, loop, times

import retuner
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause
from retuner.adaptive.diagnosis.diagnose import _of_setpoint, diagnose_window
from retuner.adaptive.diagnosis.one_tone import one_tone
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.first_step import MOST_AT_ONCE, MOST_OF_A_RECORD, first_step
from retuner.adaptive.identification.robust_simc import RobustTuning
from retuner.adaptive.indexes.setpoint_responses import setpoint_responses
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import Window
from retuner.drivers.historian.raw_table import VALUE, WITH_UNIT
from retuner.drivers.historian.scaling import FORM
from retuner.pid_controller import PidController
from retuner.schedule.gains import PidGains

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def heated(
    gains: PidGains, mode: str, seconds: int, sp: tuple[float, float], every: int
) -> tuple[PidController, Arrays]:
    """A plain tank without dead time, every second: gain 1.2, lag 40 s."""
    random.seed(1)
    pid = PidController(gains, dt_s=1, pv_range=(0, 200), mode=mode)
    x, rows = 30.0, []
    for i in range(seconds):
        wanted, pv = sp[(i // every) % 2], x + random.gauss(0, 0.05)
        co = pid.step(wanted, pv)
        rows.append((float(i), wanted, pv, co))
        x += (1 - np.exp(-1 / 40)) * (1.2 * co - x)
    t, setpoint, value, output = np.array(rows).T
    return pid, (t, setpoint, value, output)


def test_a_covariance_with_a_row_of_zeros_is_a_covariance() -> None:
    """Its eigenvalues are 0 but for rounding: identify had refused clean records whose dead time is at its bound."""
    below = 0
    for seed in range(200):
        wide = np.random.default_rng(seed).standard_normal((3, 2)) * [1.0, 1e-3]
        p = wide @ wide.T
        p[1], p[:, 1] = 0.0, 0.0
        below += bool(np.min(np.linalg.eigvalsh(p)) < 0.0)
        assert LogModel(np.zeros(3), p, 1, ProcessType.FOPDT).p is not None
    assert below
    with pytest.raises(ValueError, match="eigenvalue"):
        LogModel(np.zeros(3), np.diag([1.0, -0.01, 1.0]), 1, ProcessType.FOPDT)
    _, record = heated(PidGains(0.5, 0.5 / 120), "off", 3000, (30.0, 36.0), 400)
    found = retuner.identify(*record)
    assert found.model.k == pytest.approx(1.2, rel=0.05)
    assert found.model.tau1_s + found.model.theta_s == pytest.approx(40.5, rel=0.1)


@pytest.mark.slow
def test_a_process_without_dead_time_is_tuned_from_its_record() -> None:
    _, record = heated(PidGains(0.5, 0.5 / 120), "off", 3000, (30.0, 36.0), 400)
    found = retuner.diagnose(*record)
    assert found.cause is Cause.SLUGGISH
    assert found.recommended.kp > 0.5
    assert sensitivity_peak(LinearProcess(1.2, (40.0,), (), 0.5), found.recommended) < 1.7


@pytest.mark.slow
def test_a_process_without_dead_time_is_tuned_while_it_runs() -> None:
    """The dead time counts as one sampling interval."""
    gains = PidGains(0.5, 0.5 / 120)
    pid, _ = heated(gains, "auto", 3000, (40.0, 50.0), 500)
    assert pid.gains.kp > 1.9 * gains.kp
    assert sensitivity_peak(LinearProcess(1.2, (40.0,), (), 0.5), pid.gains) < 1.7


ODD = next(sp for sp in np.arange(30.01, 31.0, 0.01).tolist() if np.mean(np.full(700, sp)) != sp)
"""A number that is not the mean of itself, by rounding."""


@pytest.mark.parametrize("sp", [30.0, ODD])
def test_a_constant_setpoint_that_is_no_round_number_has_no_tone(sp: float) -> None:
    """Where it differs from its mean by rounding, every tone had been the setpoint's own, and was dropped."""
    record = loop(GOOD)
    window = Window(record.t_s, np.full(len(record.t_s), sp), record.pv + sp, record.co)
    tone: Any = SimpleNamespace(fit=SimpleNamespace(p=[math.log(2 * math.pi / 34.0)]))
    assert not _of_setpoint(window, tone)
    swung = replace(window, sp=sp + np.sin(2 * math.pi * window.t_s / 34.0))
    assert _of_setpoint(swung, tone)


def test_a_tone_that_moves_nothing_is_not_the_cause() -> None:
    """A loop that overshoots and swings after each step, with a faint tone beside it."""
    strong = times(2.4, 2.4)
    record = loop(strong, sp=lambda i: float((i // 175) % 2), out=lambda i: 0.02 * np.sin(2 * np.pi * i * DT / 5.3))
    found = diagnose_window(record, strong).diagnosis
    assert found.evidence["overshoot"] > 0.4
    assert found.cause in TUNING_CAUSES, found.reason


@pytest.mark.parametrize("rows", [1, 2, 3, 5])
def test_a_setpoint_step_that_a_historian_has_ramped_is_one_step(rows: int) -> None:
    strong = times(2.2, 2.2)
    record = loop(strong, sp=lambda i: float(80 <= i < 380), n=700)
    sp = record.sp.copy()
    for first, low, high in ((80, 0.0, 1.0), (380, 1.0, 0.0)):
        sp[first : first + rows] = low + (high - low) * np.arange(1, rows + 1) / rows
    whole, ramped = (setpoint_responses(one, record.pv) for one in (record.sp, sp))
    assert ramped.steps == whole.steps == 2
    assert ramped.overshoot == pytest.approx(whole.overshoot, abs=0.05)
    assert ramped.size == pytest.approx(1.0)


def test_a_response_that_was_cut_short_is_not_read() -> None:
    n = 200
    sp = np.where(np.arange(n) >= 190, 1.0, 0.0)
    pv = 0.001 * np.random.default_rng(1).standard_normal(n)
    assert setpoint_responses(sp, pv) is None


@pytest.mark.parametrize("pattern", [VALUE, WITH_UNIT, FORM])
def test_a_field_of_digits_without_end_is_read_in_no_time(pattern: re.Pattern[str]) -> None:
    """A pattern that tries every split takes minutes for this."""
    assert pattern.fullmatch("1" * 200_000 + "x") is None


@pytest.mark.parametrize("big", [1e300, -1e31])
@pytest.mark.parametrize("ask", [retuner.identify, retuner.diagnose])
def test_a_number_whose_square_is_none_is_refused_by_name(ask: Any, big: float) -> None:
    """It gave warnings of numpy, or an IndexError."""
    t = np.arange(60.0)
    pv = np.where(t == 7, big, np.sin(t))
    with pytest.raises(
        ValueError, match=r"sample 8: pv = .* is beyond 1e\+30; give the record in its engineering units"
    ):
        ask(t, np.zeros(60), pv, np.cos(t))


def swung(size: float, sp: float = 50.0, n: int = 600) -> Arrays:
    """A tank of gain 1 and 100 s, every 10 s, under Kc 1, tau_I 100 s, and a tone of 700 s at its input."""
    rng, y, integral, past, rows = np.random.default_rng(7), 50.0, 50.0, [50.0] * 3, []
    for i in range(n):
        wanted, pv = sp if i > n // 2 else 50.0, y + 0.01 * rng.normal()
        integral += 0.1 * (wanted - pv)
        rows.append((10.0 * i, wanted, pv, wanted - pv + integral))
        past.append(rows[-1][3])
        tone = size * math.sin(2 * math.pi * 10.0 * i / 700.0)
        y += (1 - math.exp(-0.1)) * (past[-3] + tone - y)
    t, setpoint, value, output = np.array(rows).T
    return t, setpoint, value, output


def test_a_record_whose_whole_excitation_is_a_tone_identifies_nothing() -> None:
    """co follows pv by the controller's law alone: the "process" was its inverse, and settings came with it."""
    found = retuner.identify(*swung(3.0, n=300))
    assert found.settings is None
    assert "all that moves pv is an oscillation of 69" in found.estimate.reason


@pytest.mark.parametrize(("size", "sp", "more"), [(3.0, 55.0, 0.0), (3.0, 50.0, 3.0), (0.0, 50.0, 1.0)])
def test_what_moves_by_more_than_a_tone_is_no_tone(size: float, sp: float, more: float) -> None:
    t, setpoint, pv, co = swung(size, sp)
    walk = more * np.cumsum(np.random.default_rng(1).normal(size=len(t))) / math.sqrt(len(t))
    assert one_tone(Window(t, setpoint, pv + walk, co)) is None


SLOW = ProcessModel(ProcessType.FOPDT, 1.0, 100.0, 0.0, 2.0)


@pytest.mark.parametrize(("events", "most"), [(1.0, MOST_AT_ONCE), (2.0, 2 * MOST_AT_ONCE), (9.0, MOST_OF_A_RECORD)])
def test_no_record_carries_gain_or_integral_action_without_end(events: float, most: float) -> None:
    tuning = simc(SLOW)
    aim = RobustTuning(tuning, 1.6, 1.6)
    weak = PidGains(tuning.gains.kp / 6.7, tuning.gains.ki / 194.0)
    step = first_step(aim, weak, events, SLOW, 0.1)
    gains = step.now.tuning.gains
    assert gains.kp <= most * weak.kp * (1 + 1e-9)
    assert gains.ki == pytest.approx(most * weak.ki)
    assert sensitivity_peak(SLOW.linear(), gains) < 1.8
    assert "194.0 times the gain or integral action" in step.sentence


def test_beside_pure_integral_action_p_is_capped_with_it_and_no_rule_goes_round_the_cap() -> None:
    """Without P in force nothing had been capped, nor where the rule's own tau_c would have been under theta."""
    tuning = simc(SLOW)
    aim = RobustTuning(tuning, 1.6, 1.6)
    integral = PidGains(0.0, tuning.gains.ki / 40.0)
    step = first_step(aim, integral, 1.0, SLOW, 0.1)
    gains = step.now.tuning.gains
    assert gains.ki == pytest.approx(3.0 * integral.ki)
    assert gains.kp == pytest.approx(tuning.gains.kp * 3.0 / 40.0)
    bold = replace(tuning, gains=PidGains(8.0 * tuning.gains.kp, 8.0 * tuning.gains.ki))
    now = PidGains(tuning.gains.kp, tuning.gains.ki)
    step = first_step(RobustTuning(bold, 2.5, 2.5), now, 1.0, SLOW, 0.1)
    assert step.now.tuning.gains.kp == pytest.approx(3.0 * now.kp)
    assert step.now.tuning.gains.ki <= 3.0 * now.ki * (1 + 1e-9)
