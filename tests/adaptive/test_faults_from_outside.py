"""Faults that were found from outside: floats compared with 0, tones of nothing, ramps of historians, no dead time."""

import math
import random
import re
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_beside_a_load import recorded
from test_diagnose import DT, GOOD, loop, times, to_and_fro

import retuner
from retuner import LinearProcess, PidController, PidGains, ProcessModel, ProcessType
from retuner.adaptive.controller_settings.summed_law import rough_law
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnose import _of_setpoint, diagnose_window
from retuner.adaptive.diagnosis.one_tone import one_tone
from retuner.adaptive.diagnosis.stretches import SAMPLES_A_CYCLE, over_time, stretches
from retuner.adaptive.diagnosis.tuning_verdict import RecordVerdict
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.first_step import MOST_AT_ONCE, MOST_OF_A_RECORD, first_step
from retuner.adaptive.identification.robust_simc import RobustTuning
from retuner.adaptive.indexes.doubtful_units import doubtful_units
from retuner.adaptive.indexes.setpoint_responses import setpoint_responses
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.rules.rule import ControllerKind
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.valve_model import Family, StuckValve
from retuner.drivers.historian.raw_table import VALUE, WITH_UNIT
from retuner.drivers.historian.scaling import FORM

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


@pytest.mark.parametrize("ask", [retuner.identify, retuner.diagnose])
@pytest.mark.parametrize("which", [1, 2])
def test_a_signal_whose_squares_vanish_is_refused_by_name(ask: Any, which: int) -> None:
    """It gave a ZeroDivisionError."""
    t = np.arange(60.0)
    signals = [np.zeros(60), np.sin(t), np.cos(t)]
    signals[which] *= 1e-165
    with pytest.raises(ValueError, match=r"is nowhere beyond .*e-16.; give the record in its engineering units"):
        ask(t, *signals)


@pytest.mark.parametrize("none", [[], ()])
def test_no_record_is_refused_in_words(none: Any) -> None:
    """It gave an IndexError."""
    with pytest.raises(ValueError, match="no record"):
        retuner.diagnose(none)


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


# What goes with a cause: first steps instead of leaps, long records over time, numbers in doubtful units.


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
