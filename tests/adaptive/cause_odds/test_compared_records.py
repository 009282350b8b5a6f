"""A load that swings beside setpoint steps is no reason to cut the gain, and no excuse for too much of it."""

import math

import numpy as np
import pytest
from pi_loop import Lag, pi_loop

from retuner import ProcessModel, simulate
from retuner.adaptive.cause_odds.compared_records import compared
from retuner.adaptive.cause_odds.odds import diagnose_records
from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

PERIOD, N = 24.0, 480
SETPOINT = np.repeat([0.0, 20.0, 5.0, 25.0], N // 4)
GOOD, TIGHT = PidGains(1.6, 0.08), PidGains(4.8, 0.24)  # Ms 1.4 and 3.7 on the loop below


def swung(gains: PidGains, seed: int) -> Window:
    """PI on a lag of 20 s with 4 s dead time: three setpoint steps, and a load through a resonance of PERIOD."""
    rng = np.random.default_rng(seed)
    w, r = 2.0 * math.pi / PERIOD, math.exp(-0.05 * 2.0 * math.pi / PERIOD)
    push = np.zeros(N)
    for i in range(N):
        before, two = (push[i - k] if i >= k else 0.0 for k in (1, 2))
        push[i] = 2.0 * r * math.cos(w) * before - r * r * two + rng.standard_normal()
    return pi_loop(gains, Lag(20.0, 4), SETPOINT, 0.1 * rng.standard_normal(N), push)


@pytest.mark.parametrize(
    ("gains", "seed", "cause"),
    [(GOOD, 3, Cause.OK), (GOOD, 8, Cause.OK), (TIGHT, 3, Cause.AGGRESSIVE), (TIGHT, 8, Cause.AGGRESSIVE)],
)
def test_under_a_load_that_swings_the_setpoint_tells_the_tuning(gains: PidGains, seed: int, cause: Cause) -> None:
    """Under a load that wanders alone the good loop was too tight by 99 %."""
    found = diagnose_records([swung(gains, seed)], gains)
    assert found.found.diagnosis.causes[str(cause)] > 0.9
    assert (found.settings is not None) == (cause == Cause.AGGRESSIVE)


@pytest.mark.slow
def test_a_record_shorter_than_an_interval_of_another_one_says_nothing_beside_it() -> None:
    slow = swung(TIGHT, 3)
    short = Window(slow.t_s[:100] / 1000.0, slow.sp[:100], slow.pv[:100], slow.co[:100])
    for records in ([slow, short], [short, slow]):
        assert diagnose_records(records, TIGHT).found.diagnosis.cause == Cause.AGGRESSIVE


@pytest.mark.slow
def test_a_long_record_is_not_averaged_over_the_swing_of_its_loop() -> None:
    """200,000 rows of an aggressive loop were compared 49 at a time: slow integrating, with settings of Ms 3.3."""
    rng, n = np.random.default_rng(4), 60_000
    setpoint = np.where(np.arange(n) // 300 % 2, 5.0, 0.0)
    long = pi_loop(TIGHT, Lag(20.0, 4), setpoint, 0.1 * rng.standard_normal(n), np.zeros(n))
    found = compared([long], TIGHT, 1, OddsSettings())
    assert found is not None
    assert found.dt_s <= TIGHT.kp / TIGHT.ki / 10


@pytest.mark.slow
@pytest.mark.parametrize(("kp", "size", "cause"), [(18.0, 5.0, Cause.AGGRESSIVE), (3.0, 45.0, Cause.SATURATION)])
def test_a_loop_that_swings_from_limit_to_limit_by_itself_is_aggressive(kp: float, size: float, cause: Cause) -> None:
    """It was saturation, which new settings do not cure; a good loop whose setpoint asks for too much still is."""
    gains, model = PidGains(kp, kp / 50.0), ProcessModel("fopdt", k=0.8, tau1_s=90.0, theta_s=15.0)
    setpoint = [(300.0 * i, 40.0 + size * (-1) ** i) for i in range(7)]
    record = simulate(model, gains, setpoint=setpoint, until_s=2000.0, noise=0.05).window
    assert np.mean((record.co <= 0.0) | (record.co >= 100.0)) > 0.3
    assert diagnose_records([record], gains).found.diagnosis.cause == cause
