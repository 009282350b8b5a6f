"""Records with hardly more samples than a hypothesis has unknowns: whatever they hold, an answer comes."""

import numpy as np
import pytest

import retuner
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.rival_fits import linear, room_for_a_tone
from retuner.adaptive.diagnosis.sticking_valve import stiction_or_tone
from retuner.adaptive.identification.structure_choice import too_few
from retuner.adaptive.indexes.screening import screen
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.slips import ROWS_PER_STEP, _greedy
from retuner.schedule.gains import PidGains


@pytest.mark.parametrize("seed", [19, 112, 243])
def test_more_unknowns_than_samples_are_not_asked_for(seed: int) -> None:
    """These three stopped a tone, a load and the steps of a valve: "more unknowns than samples"."""
    rng = np.random.default_rng([seed, 77])
    n, dt_s = int(rng.integers(8, 90)), float(rng.choice([0.01, 0.1, 1, 60]))
    noise, kp = float(rng.choice([0.0, 1e-3, 0.02, 0.2, 1.0])), float(rng.choice([0.1, 0.5, 1, 3]))
    ki = kp / dt_s / float(rng.choice([2, 5, 20]))
    tau, theta = float(rng.choice([1, 4, 20])), int(rng.integers(0, 6))
    sp, load = np.zeros(n), np.zeros(n)
    for _ in range(int(rng.integers(0, 3))):
        sp[int(rng.integers(1, n)) :] = rng.normal()
    for _ in range(int(rng.integers(0, 4))):
        load[int(rng.integers(0, n)) :] += rng.normal()
    quantum, band = float(rng.choice([0, 0, 0.05, 0.3])), float(rng.choice([0, 0, 0.1, 0.5]))
    x = integral = stem = 0.0
    pv, co, u = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        seen = x + noise * rng.normal()
        pv[i] = round(seen / quantum) * quantum if quantum else seen
        integral += ki * dt_s * (sp[i] - pv[i])
        co[i] = np.clip(kp * (sp[i] - pv[i]) + integral, -5, 5)
        stem = co[i] if abs(co[i] - stem) > band else stem
        u[i] = stem
        x += ((u[i - theta] if i >= theta else 0.0) - x + load[i]) / tau
    found = diagnose_window(Window(np.arange(n) * dt_s, sp, pv, co), PidGains(kp, ki, 0.0)).diagnosis
    assert found.cause in Cause
    assert found.reason


@pytest.mark.parametrize("n", [10, 23, 40])
def test_steps_leave_samples_that_could_speak_against_them(n: int) -> None:
    pv = np.random.default_rng(n).normal(size=n).round(0)
    _, rows = _greedy(pv, 0.5, 0.0)
    assert len(rows) <= n // ROWS_PER_STEP


@pytest.mark.parametrize("n", [14, 15, 18, 24])
def test_a_record_that_no_tone_fits_into_has_no_rivals(n: int) -> None:
    """A response of many small setpoint moves, as a watching retuner asks of it, not as `diagnose` does."""
    t, settings, rng = np.arange(float(n)), DiagnosisSettings(), np.random.default_rng(n)
    sp = np.cumsum(np.where(t % 7 == 0, rng.choice([-0.3, 0.3], n), 0.0))
    pv = np.concatenate([[0.0], 0.9 * sp[:-1]]) + 0.01 * rng.standard_normal(n)
    window = Window(t, sp, pv, np.cumsum(sp - pv) * 0.2 + sp - pv)
    best = linear(window, (1,), settings.fit.choice, settings.fit.most_samples)[0]
    found = stiction_or_tone(best, screen(window, PidGains(1.0, 0.2), in_auto=True), settings)
    assert (found.verdict is None) or room_for_a_tone(best)


def many_gaps(n: int) -> tuple[np.ndarray, ...]:
    """A random record of n samples with a gap after every third one: each is a start with unknowns of its own."""
    rng = np.random.default_rng(n)
    t = np.cumsum(np.where(np.arange(n) % 3 == 0, 9.0, 1.0))
    return t, np.where(np.arange(n) > n // 3, 1.0, 0.0), np.cumsum(rng.normal(size=n)), np.cumsum(rng.normal(size=n))


@pytest.mark.parametrize("n", [3, 5, 8, 12, 16, 20])
def test_a_record_with_fewer_samples_than_unknowns_says_so(n: int) -> None:
    """It had said "more unknowns than samples", or "search: most or the grid is outside its range"."""
    with pytest.raises(ValueError, match="are fewer than a process and its starts have unknowns"):
        retuner.identify(*many_gaps(n))
    assert retuner.diagnose(*many_gaps(n)).cause is Cause.UNKNOWN


@pytest.mark.slow
def test_the_fewest_samples_that_are_enough_are_fitted() -> None:
    for n in range(20, 34):
        if not too_few(Window(*many_gaps(n))):
            assert retuner.identify(*many_gaps(n)).estimate.log.type
            retuner.diagnose(*many_gaps(n))
