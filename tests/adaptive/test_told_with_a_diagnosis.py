"""What goes with a cause: first steps instead of leaps, long records over time, numbers in doubtful units."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_coincident_loads import recorded
from test_diagnose import DT, GOOD, loop, times, to_and_fro

from retuner.adaptive.controller_settings.summed_law import rough_law
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.stretches import SAMPLES_A_CYCLE, over_time, stretches
from retuner.adaptive.diagnosis.tuning_verdict import RecordVerdict
from retuner.adaptive.identification.first_step import MOST_AT_ONCE, first_step
from retuner.adaptive.identification.robust_simc import RobustTuning
from retuner.adaptive.indexes.doubtful_units import doubtful_units
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import ControllerKind
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.valve_model import Family, StuckValve
from retuner.schedule.gains import PidGains

INTEGRATING = ProcessModel(ProcessType.INTEGRATING, 0.02, 0.0, 0.0, 3.0)


def test_a_leap_from_one_event_is_a_first_step():
    aim = RobustTuning(simc(INTEGRATING, 3.0), 1.7, 1.8)
    slow = PidGains(aim.tuning.gains.kp / 10, aim.tuning.gains.ki / 10)
    step = first_step(aim, slow, 1.0, INTEGRATING, 0.1)
    assert step.now.tuning.gains.kp == pytest.approx(MOST_AT_ONCE * slow.kp)
    gains = step.now.tuning.gains
    assert INTEGRATING.k * gains.kp * gains.kp / gains.ki == pytest.approx(4.0)  # and no slow oscillation on the way
    assert sensitivity_peak(INTEGRATING.linear(), gains) < 1.7
    assert step.aim is aim
    assert "10.0 times the gain" in step.sentence


def test_a_first_step_of_a_loop_with_derivative_action_keeps_the_aims_times():
    process = ProcessModel(ProcessType.SOPDT, 1.0, 100.0, 40.0, 8.0)
    aim = RobustTuning(simc(process, kind=ControllerKind.PID), 1.6, 1.7)
    wanted = aim.tuning.gains
    step = first_step(aim, PidGains(wanted.kp / 30, wanted.ki / 30, wanted.kd / 30), 1.0, process, 0.5)
    gains, share = step.now.tuning.gains, MOST_AT_ONCE / 30
    assert (gains.kp, gains.ki, gains.kd) == pytest.approx((share * wanted.kp, share * wanted.ki, share * wanted.kd))


def test_more_events_or_a_cut_carry_the_aim():
    aim = RobustTuning(simc(INTEGRATING, 3.0), 1.7, 1.8)
    slow = PidGains(aim.tuning.gains.kp / 10, aim.tuning.gains.ki / 10)
    assert first_step(aim, slow, 4.0, INTEGRATING, 0.1) is None
    assert first_step(aim, PidGains(aim.tuning.gains.kp * 10, 1.0), 1.0, INTEGRATING, 0.1) is None
    assert (
        first_step(aim, PidGains(aim.tuning.gains.kp / 2.9, aim.tuning.gains.ki / 2.9), 1.0, INTEGRATING, 0.1) is None
    )


def test_a_sluggish_loop_seen_once_is_told_the_first_step():
    window = loop(times(0.1, 0.1), lambda i: 1.0 if i >= 80 else 0.0, n=1400)
    found = diagnose_window(window, times(0.1, 0.1))
    assert found.diagnosis.cause == Cause.SLUGGISH
    assert found.aim is not None
    assert found.tuning.tuning.gains.kp == pytest.approx(MOST_AT_ONCE * 0.1 * GOOD.kp, rel=1e-6)
    assert "first step" in found.diagnosis.reason


def test_a_limit_cycle_of_many_rounds_is_not_thinned_away():
    valve = StuckValve(Family.KANO, 1.0, 0.7)
    short = loop(valve=valve, load=lambda i: 2.0 if i < 60 else 0.0, n=1200)
    rounds = 12
    once = Window(*(x[600:] for x in (short.t_s, short.sp, short.pv, short.co)))
    n = len(once.t_s)
    many = Window(np.arange(rounds * n) * DT, *(np.tile(x, rounds) for x in (once.sp, once.pv, once.co)))
    parts = stretches(many, 40.0, 800)
    assert len(parts) == 3
    for part in parts:
        assert 800 * 40.0 / (part.t_s[-1] - part.t_s[0]) > SAMPLES_A_CYCLE
    assert parts[0].t_s[0] == 0.0
    assert parts[-1].t_s[-1] == many.t_s[-1]
    assert stretches(once, 40.0, 800) == []
    assert stretches(many, None, 800) == []


@given(n=st.integers(1700, 6000), count=st.integers(0, 40), seed=st.integers(0, 999))
def test_a_long_record_is_parted_between_its_setpoint_changes(n: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = np.sort(rng.choice(np.arange(20, n - 20, 3), count, replace=False))  # in successive samples it is a ramp
    sp = np.zeros(n)
    for i, k in enumerate(at):
        sp[k:] = (i + 1) % 2
    pv = sp + 1e-3 * rng.standard_normal(n)
    parts = stretches(Window(np.arange(float(n)), sp, pv, pv), None, 800)
    assert len(parts) != 1
    assert len(parts) <= 5
    assert not parts or count >= 6
    assert all(np.sum(np.diff(part.sp) != 0) >= 3 for part in parts)
    assert all(a.t_s[-1] < b.t_s[0] for a, b in pairwise(parts))
    assert stretches(Window(np.arange(float(n)), sp, pv, pv), None, 8000) == []


@pytest.mark.parametrize(
    ("causes", "cause"),
    [
        ("stiction unknown unknown stiction", Cause.STICTION),  # what two show is told
        ("stiction unknown unknown", Cause.UNKNOWN),
        ("aggressive aggressive unknown", Cause.AGGRESSIVE),
        ("aggressive aggressive ok", Cause.UNKNOWN),  # no change of gains against another cause
        ("noise noise ok", Cause.NOISE),
        ("ok stiction noise", Cause.UNKNOWN),
    ],
)
def test_the_verdict_over_time(causes: str, cause: Cause) -> None:
    n = len(causes.split())
    parts = [Window(*(10.0 * i + np.arange(3.0) for _ in range(4))) for i in range(n)]
    found = [RecordVerdict(Diagnosis(Cause(c), 0.6, {}, f"reason {i}")) for i, c in enumerate(causes.split())]
    assert over_time(parts, found).diagnosis.cause == cause


def test_a_real_valve_in_one_long_record_is_named_as_in_each_part_of_it() -> None:
    """Condensed to what a fit takes, its slips and stands were lost: unknown."""
    _, *signals = recorded("FIC20102_1016_12.csv")
    long = [np.tile(x, 6) for x in signals]
    found = diagnose_window(Window(10.0 * np.arange(len(long[0])), *long), None, rough_law=rough_law).diagnosis
    assert found.cause == Cause.STICTION
    assert "stiction from 0 to" in found.reason


def test_settings_are_not_given_for_a_process_that_is_not_known():
    """The cause stays, the gains stay as well."""
    found = diagnose_window(loop(times(2.6, 1.0), to_and_fro), times(2.6, 1.0))
    assert found.diagnosis.cause == Cause.AGGRESSIVE
    assert found.diagnosis.settled == (found.tuning is not None) == found.diagnosis.retune


@pytest.mark.parametrize(
    ("t0", "dt", "word"),
    [(45000.5, 1 / 1440, "spreadsheet"), (1.7e12, 1000.0, "milliseconds"), (20240625103000.0, 10.0, "YYYYMMDD")],
)
def test_dates_as_numbers_are_told(t0, dt, word):
    t = t0 + dt * np.arange(50)
    said = doubtful_units(Window(t, np.zeros(50), np.linspace(0, 1, 50), np.linspace(20, 60, 50)))
    assert len(said) == 1
    assert word in said[0]


def test_milliamperes_and_counts_are_told():
    t = np.arange(50.0)
    said = doubtful_units(Window(t, np.zeros(50), np.round(np.linspace(0, 27648, 50)), np.linspace(4, 20, 50)))
    assert [any(word in s for s in said) for word in ("mA", "counts")] == [True, True]
    assert doubtful_units(Window(t, np.zeros(50), np.linspace(0, 100, 50), np.linspace(0, 100, 50))) == ()
