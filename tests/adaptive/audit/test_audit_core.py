"""What an audit says of a whole record: numbers of known signals, stretches, verdicts over time, common swings."""

import math
from dataclasses import astuple, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pi_loop import Lag, pi_loop

from retuner.adaptive.audit.common_swing import Swinging, common_swings
from retuner.adaptive.audit.lasting_swing import lasting_swing
from retuner.adaptive.audit.loop_screen import DAY_S, harris_index, screen_loop
from retuner.adaptive.audit.over_time import stretches_of_interest
from retuner.adaptive.audit.record_sums import Measure, RecordSums, counted, covariances, record_sums
from retuner.adaptive.audit.verdict import (
    AuditAction,
    StretchVerdict,
    VerdictBasis,
    error_share,
    joined_confidence,
    loop_verdict,
)
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.fit import engine
from retuner.adaptive.indexes.condition import Condition
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains

N = 4000
T = np.arange(N) * 10.0
RNG = np.random.default_rng(5)


def record(error: np.ndarray, co: np.ndarray | None = None, t_s: np.ndarray = T) -> Window:
    walk = np.cumsum(RNG.normal(size=len(t_s)))
    return Window(t_s, np.full(len(t_s), 50.0), 50.0 - error, walk if co is None else co)


def test_the_numbers_of_a_sine_are_its_own() -> None:
    period_s, amplitude = 600.0, 2.0
    wave = amplitude * np.sin(2 * np.pi * T / period_s)
    screen = screen_loop(record(wave + 0.01 * RNG.normal(size=N), co=5 * np.cos(2 * np.pi * T / period_s)))

    assert screen.period_s == pytest.approx(period_s, rel=0.01)
    assert screen.swinging == 1.0
    assert screen.error_std == pytest.approx(amplitude / math.sqrt(2), rel=0.01)
    assert screen.iae_per_day == pytest.approx(2 * amplitude / math.pi * DAY_S, rel=0.01)
    assert screen.reversals_per_day == pytest.approx(2 * DAY_S / period_s, rel=0.05)
    assert screen.effort_per_day == pytest.approx(20 * DAY_S / period_s, rel=0.02)


def test_a_gap_is_no_time_on_record() -> None:
    error = RNG.normal(size=N)
    whole = screen_loop(record(error))
    torn = screen_loop(record(error, t_s=T + np.where(np.arange(N) > N // 2, 5e5, 0.0)))

    assert (whole.gaps, torn.gaps) == (0, 1)
    assert torn.span_s == pytest.approx(whole.span_s, rel=0.01)
    assert torn.iae_per_day == pytest.approx(whole.iae_per_day, rel=0.01)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("delay", [1, 3])
def test_the_harris_index_of_an_autoregressive_error_is_the_analytic_one(phi: float, delay: int) -> None:
    shocks = RNG.normal(size=60_000)
    error = np.zeros_like(shocks)
    for i in range(1, len(error)):
        error[i] = phi * error[i - 1] + shocks[i]
    least = (1 - phi**2) * sum(phi ** (2 * i) for i in range(delay))

    assert harris_index(covariances(error), delay) == pytest.approx(1 - least, abs=0.02)


def test_a_dead_signal_has_no_avoidable_error() -> None:
    screen = screen_loop(record(np.zeros(N)))

    assert screen.condition == Condition.DEAD_PV
    assert screen.harris == 0.0
    assert loop_verdict(screen, []).action == AuditAction.SIGNAL


@given(st.integers(1, 6), st.floats(100, 3000), st.integers(0, N - 2))
def test_stretches_are_whole_apart_and_in_order(most: int, period_s: float, torn: int) -> None:
    window = record(np.sin(T / 90), t_s=T + np.where(np.arange(N) > torn, 1e5, 0.0))
    parts = stretches_of_interest(window, period_s, most)

    assert 1 <= len(parts) <= most
    for a, b in pairwise(parts):
        assert a.t_s[-1] < b.t_s[0]
    if len(parts) > 1:
        assert max(float(np.max(np.diff(part.t_s))) for part in parts) < 1e5


def test_a_stretch_is_taken_where_the_setpoint_moves() -> None:
    long = np.arange(20_000) * 10.0
    sp = np.where(long < 100_000, 50.0, 52.0)
    window = Window(long, sp, sp + RNG.normal(size=len(long)), np.cumsum(RNG.normal(size=len(long))))
    parts = stretches_of_interest(window, None, 3)

    assert any(part.t_s[0] < 100_000 < part.t_s[-1] for part in parts)
    assert parts[-1].t_s[-1] == long[-1]


def seen(cause: Cause, confidence: float, begin_s: float = 0.0) -> StretchVerdict:
    return StretchVerdict(begin_s, begin_s + 100, cause, confidence, f"because of {cause}")


CALM = screen_loop(record(np.convolve(RNG.normal(size=N + 99), np.ones(100) / 100, "valid")))


@given(st.floats(0.5, 0.99), st.floats(0.5, 0.99))
def test_what_agrees_makes_surer_and_what_contradicts_less_sure(one: float, two: float) -> None:
    alone = joined_confidence(Cause.STICTION, [seen(Cause.STICTION, one)])
    both = joined_confidence(Cause.STICTION, [seen(Cause.STICTION, one), seen(Cause.STICTION, two)])
    against = joined_confidence(Cause.STICTION, [seen(Cause.STICTION, one), seen(Cause.OK, two)])
    unsaid = joined_confidence(Cause.STICTION, [seen(Cause.STICTION, one), seen(Cause.UNKNOWN, two)])

    assert against <= alone <= both <= 0.98
    assert unsaid == alone


def test_the_verdict_tells_since_when_and_how_often() -> None:
    stretches = [seen(Cause.OK, 0.8), seen(Cause.AGGRESSIVE, 0.9, 500), seen(Cause.AGGRESSIVE, 0.95, 900)]
    told = loop_verdict(CALM, stretches)

    assert (told.cause, told.action, told.since_s) == (Cause.AGGRESSIVE, AuditAction.RETUNE, 500)
    assert (told.seen, told.looked_at) == (2, 3)
    assert told.rank > 0


def test_a_loop_in_order_is_not_visited_and_an_unknown_swing_is_looked_at() -> None:
    calm = loop_verdict(CALM, [seen(Cause.OK, 0.9), seen(Cause.NOISE, 0.8)])
    assert (calm.action, calm.rank) == (AuditAction.NOTHING, 0.0)
    unknown = [seen(Cause.UNKNOWN, 0.5)]
    assert loop_verdict(CALM, unknown).action == AuditAction.RECORD
    swings = loop_verdict(replace(CALM, swinging=1.0, strength=0.8, period_s=60.0), unknown)
    assert (swings.action, swings.rank > 0) == (AuditAction.LOOK, True)


def test_a_stretch_at_rest_does_not_speak_for_one_that_swings() -> None:
    """A level that swung after each load was noise, and nothing to do: it was at rest for a quarter of the time."""
    swings = [seen(Cause.NOISE, 0.9), *(seen(Cause.SLOW_INTEGRATING, 0.48) for _ in range(3))]
    told = loop_verdict(CALM, swings)
    assert (told.cause, told.action) == (Cause.UNKNOWN, AuditAction.RECORD)
    assert loop_verdict(CALM, [seen(Cause.NOISE, 0.9), seen(Cause.UNKNOWN, 0.5)]).action == AuditAction.NOTHING


def test_a_loop_that_waits_for_its_process_is_sluggish_where_nothing_says_otherwise() -> None:
    waits, noise = replace(CALM, idle=0.45, at_limits=0.0), [seen(Cause.NOISE, 0.8), seen(Cause.UNKNOWN, 0.5)]
    told = loop_verdict(waits, noise)
    assert (told.cause, told.action) == (Cause.SLUGGISH, AuditAction.RECORD)  # no settings follow from it
    share = error_share(waits.harris)  # of the error, not of its variance
    assert (told.avoidable, told.basis) == (share, VerdictBasis.HARRIS)
    assert told.rank == pytest.approx(told.confidence * share / told.action.effort)
    assert loop_verdict(replace(waits, idle=0.1), noise).cause != Cause.SLUGGISH
    assert loop_verdict(replace(waits, idle=None), noise).cause != Cause.SLUGGISH
    assert loop_verdict(replace(waits, setpoint=False), noise).cause != Cause.SLUGGISH
    assert loop_verdict(replace(waits, swinging=1.0), noise).cause != Cause.SLUGGISH
    assert loop_verdict(waits, [*noise, seen(Cause.OK, 0.9)]).cause == Cause.OK
    assert loop_verdict(waits, [*noise, seen(Cause.STICTION, 0.9)]).cause == Cause.STICTION


def test_loops_of_one_period_swing_together_and_the_valve_is_the_root() -> None:
    loops = [Swinging("A", 100.0, 0.1), Swinging("B", 102.0, 0.05, sticks=0.8), Swinging("C", 101.0, 0.02)]
    groups = common_swings([*loops, Swinging("D", 300.0, 0.5)])

    assert [group.tags for group in groups] == [("B", "A", "C")]
    assert groups[0].root == "B"
    assert common_swings([loops[0], loops[2]])[0].root == "A"
    assert common_swings([loops[0], Swinging("E", 100.0, 0.09)])[0].root is None


def loop_with_loads(gain: float, setpoint: np.ndarray | None = None) -> Window:
    """First order, lag 10 and dead time 3 samples, PI with `gain` times its kc, a load step each 500 samples."""
    n = 4_000
    sp = np.zeros(n) if setpoint is None else setpoint
    noise, load = 0.01 * RNG.normal(size=n), np.arange(n) // 500 % 2
    return pi_loop(PidGains(1.5 * gain, 0.015 * gain), Lag(10.0, 2), sp, noise, load, dt=10.0)


def test_the_idle_index_tells_a_controller_that_waits_from_one_that_acts() -> None:
    sluggish, tuned = (screen_loop(loop_with_loads(gain)).idle for gain in (0.12, 1.0))

    assert sluggish is not None
    assert tuned is not None
    assert sluggish > 0.1 > -0.1 > tuned
    moving = screen_loop(loop_with_loads(0.12, np.sin(np.arange(4_000) / 50)))
    assert moving.idle is None


# What is counted over a whole record: the compiled pass and numpy count the same; swings at every pace are found.


def drawn_record(seed: int, n: int) -> Window:
    """Any clock, with gaps; signals that wander, stand still, repeat and stand at limits."""
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.choice([1.0, 1.0, 1.0, 1.3, 40.0], n)) * 10 ** rng.uniform(-2, 2)
    values, held = rng.normal(size=n), rng.integers(1, n + 1)
    sp = values[np.arange(n) // held] * 10 ** rng.uniform(-3, 3)
    pv = sp + np.round(np.cumsum(rng.normal(size=n)), int(rng.integers(0, 4))) + rng.choice([0.0, 1e3])
    co = np.clip(np.repeat(np.cumsum(rng.normal(size=n)), rng.integers(1, 9))[:n], -2.0, 3.0)
    return Window(t_s, sp, pv, co)


def numbers(sums: RecordSums) -> FloatArray:
    plain = [x for name in sums.__slots__ if isinstance(x := getattr(sums, name), float)]
    return np.concatenate([plain, astuple(sums.low), astuple(sums.high), sums.covariance])


@given(st.integers(0, 2**32), st.integers(3, 5000), st.integers(1, 16), st.sampled_from([0.0, 0.4]))
def test_the_compiled_pass_counts_what_numpy_counts(seed: int, n: int, width: int, band: float) -> None:
    pytest.importorskip("retuner.adaptive.fit.compiled", reason="the compiled engine was not built: no compiler")
    record = drawn_record(seed, n)
    by = Measure(5 * record.sample_time_s, band, 20.0, min(width, n))
    scale = float(np.max(np.abs(record.pv))) ** 2 + 1.0

    np.testing.assert_allclose(numbers(record_sums(record, by)), numbers(counted(record, by)), 1e-9, 1e-12 * scale)


@pytest.mark.uncounted
def test_a_whole_screen_is_the_same_by_both_engines() -> None:
    record = drawn_record(4, 30_000)
    found = []
    for name in ("auto", "numpy"):
        with engine.using(name):
            found.append(screen_loop(record).to_dict())

    assert found[0] == {k: pytest.approx(v, rel=1e-6) if isinstance(v, float) else v for k, v in found[1].items()}


@pytest.mark.parametrize("period", [9.0, 60.0, 700.0, 6_000.0])
def test_a_swing_is_found_at_its_pace(period: float) -> None:
    n, rng = 60_000, np.random.default_rng(1)
    drift = np.cumsum(rng.normal(size=n)) * 0.003
    swing = lasting_swing(np.sin(2 * np.pi * np.arange(n) / period) + 0.4 * rng.normal(size=n) + drift, drift)

    wave, share = swing
    assert wave.period == pytest.approx(period, rel=0.03)
    assert share > 0.5


def test_noise_and_drift_do_not_swing() -> None:
    rng = np.random.default_rng(2)
    for signal in (rng.normal(size=40_000), np.cumsum(rng.normal(size=40_000)), np.zeros(40_000)):
        assert lasting_swing(signal, np.zeros(40_000)) is None


def test_a_limit_that_binds_costs_on_one_side() -> None:
    n, rng = 6000, np.random.default_rng(3)
    bound = (np.arange(n) // 1000) % 2 == 1
    co = np.where(bound, 100.0, 60 + np.cumsum(rng.normal(size=n)) * 0.1)
    record = Window(np.arange(n) * 10.0, np.zeros(n), rng.normal(size=n) * 0.1 - 2.0 * bound, co)
    screen = screen_loop(record)

    assert screen.at_limits == pytest.approx(0.5, abs=0.01)
    assert screen.loss_at_limits > 0.9
    assert screen.one_sided > 0.9
    free = screen_loop(replace(record, co=np.cumsum(rng.normal(size=n))))
    assert (free.at_limits, free.loss_at_limits) == (0.0, 0.0)


@given(st.integers(3, 130), st.integers(0, 5))
def test_a_record_of_any_length_is_screened(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wave = np.sin(np.arange(n) * rng.uniform(0.05, 3.0))
    co = rng.choice([wave, rng.normal(size=n), np.zeros(n), np.arange(n) % 2.0])
    screen = screen_loop(Window(10.0 * np.arange(n), np.zeros(n), wave + 0.1 * rng.normal(size=n), co))

    assert screen.samples == n
    assert 0 <= screen.swinging <= 1
