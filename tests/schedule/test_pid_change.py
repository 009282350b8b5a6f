"""Changes of gains, b and tau_f without a bump: in range, at either limit, under a rate limit."""

import math
import random
from dataclasses import replace

import pytest

from retuner.schedule.gains import PidGains
from retuner.schedule.pid import PidLaw, PidState, change, law, start, step, track

SPAN = 100.0
BUMP = 1e-9 * SPAN
"""What the issue allows, two-sided."""

Case = tuple[PidLaw, PidLaw, PidState, float, float, float]


def log_uniform(rng: random.Random, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def random_law(rng: random.Random, sign: float, rate: float | None) -> PidLaw:
    """P, PI, PD, I or PID, with and without filter and setpoint weight."""
    kp = sign * log_uniform(rng, 0.01, 50.0)
    ki = sign * log_uniform(rng, 1e-4, 5.0) * rng.choice((0.0, 1.0, 1.0))
    kd = sign * log_uniform(rng, 0.01, 50.0) * rng.choice((0.0, 1.0))
    if ki and rng.random() < 0.2:
        kp = 0.0
    return PidLaw(
        kp,
        ki,
        kd,
        rng.choice((0.0, rng.random(), 1.0)),
        rng.choice((0.0, log_uniform(rng, 0.1, 30.0))),
        co_rate_per_s=rate,
    )


def random_case(rng: random.Random) -> Case:
    """A loop in motion, somewhere, about to take another set."""
    sign = rng.choice((1.0, -1.0))
    rate = rng.choice((None, None, log_uniform(rng, 0.1, 50.0)))
    old, new = random_law(rng, sign, rate), random_law(rng, sign, rate)
    dt_s = log_uniform(rng, 0.05, 5.0)
    pv = rng.uniform(-100.0, 200.0)
    state = start(old, pv, pv, rng.uniform(0.0, SPAN))
    far = rng.choice((0.2, 100.0))
    for _ in range(rng.randrange(1, 6)):
        sp, pv = pv + rng.gauss(0.0, far), pv + rng.gauss(0.0, far)
        state = PidState(*step(old, state, sp, pv, dt_s)[0])
    return old, new, state, sp + rng.gauss(0.0, far), pv + rng.gauss(0.0, far), dt_s


@pytest.mark.uncounted
def test_the_step_after_a_change_gives_what_the_old_law_would_have_given():
    """20,000 random changes, most of which would bump hard without."""
    rng = random.Random(2)
    at_limit, would_bump, moved = {-1: 0, 0: 0, 1: 0}, 0, 0
    for _ in range(20_000):
        old, new, state, sp, pv, dt_s = random_case(rng)
        kept, expected = step(old, state, sp, pv, dt_s)
        after = change(old, new, state, sp, pv, dt_s)
        _, co = step(new, after, sp, pv, dt_s)

        assert abs(co - expected) <= BUMP
        assert new != old
        at_limit[kept[4]] += 1
        would_bump += abs(step(new, state, sp, pv, dt_s)[1] - expected) > 1e3 * BUMP
        moved += after.integral != state.integral

    assert min(at_limit.values()) > 2_000
    assert would_bump > 10_000
    assert moved > 10_000


@pytest.mark.uncounted
def test_between_samples_the_changed_law_stands_where_the_old_one_stood():
    """Without dt_s: at the last sample's sp and pv both laws give the same co, D as it stands included."""
    rng = random.Random(3)
    would_bump = 0
    for _ in range(20_000):
        old, new, state, sp, _, _ = random_case(rng)
        old, new = replace(old, co_rate_per_s=None), replace(new, co_rate_per_s=None)
        after = change(old, new, state, sp, state.pv)

        def output(settings: PidLaw, at: PidState, sp: float = sp) -> float:
            wish = settings.kp * (settings.b * sp - at.pv) + at.integral - settings.kd * at.pv_rate
            return min(max(wish, settings.co_min), settings.co_max)

        assert abs(output(new, after) - output(old, state)) <= BUMP
        would_bump += abs(output(new, state) - output(old, state)) > 1e3 * BUMP
        assert after[1:] == state[1:]

    assert would_bump > 10_000


@pytest.mark.parametrize("dt_s", [0.01, 1.0, 100.0])
def test_a_change_of_ki_alone_needs_nothing(dt_s):
    old = law(PidGains(2.0, 0.1, 1.0), tau_f_s=3.0)
    state = PidState(*step(old, start(old, 50.0, 50.0, 50.0), 51.0, 50.5, 1.0)[0])
    for ki in (0.0, 0.01, 1.0):
        new = old.with_gains(PidGains(2.0, ki, 1.0))
        assert change(old, new, state, 51.0, 50.5, dt_s) == state
        assert step(new, state, 51.0, 50.5, dt_s)[1] == step(old, state, 51.0, 50.5, dt_s)[1]


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("kp_old", "kp_new"), [(10.0, 1.0), (1.0, 10.0)])
def test_a_change_at_a_limit_carries_no_windup_over(direction, side, kp_old, kp_new):
    """The wish beyond the limit (150 here) is not the new law's business: as the error shrinks, it leaves the limit."""
    old, new = (law(PidGains(direction * kp, direction * 0.01)) for kp in (kp_old, kp_new))
    error = direction * side * 20.0
    state, co = step(old, start(old, 0.0, 0.0, 50.0), error, 0.0, 1.0)
    limit = 50.0 + side * 50.0
    if kp_old == 10.0:
        assert co == limit
    after = change(old, new, state, error, 0.0)
    _, still = step(new, after, error, 0.0, 1.0)
    _, freed = step(new, after, 0.1 * error, 0.0, 1.0)

    assert still == pytest.approx(co if kp_old == 10.0 else step(old, state, error, 0.0, 1.0)[1])
    assert (limit - freed) * side > 1.0


def test_at_a_limit_the_integral_moves_no_further_than_it_must():
    """Stronger P at the limit: the wish is beyond it anyway, the integral stays and the step goes on as begun."""
    old, new = law(PidGains(4.0, 0.1)), law(PidGains(8.0, 0.1))
    state = PidState(integral=50.0, pv=0.0, pv_rate=0.0, co=100.0, limited=1)

    assert change(old, new, state, 20.0, 0.0) == state
    assert change(new, old, state, 20.0, 0.0) == state
    assert change(old, law(PidGains(1.0, 0.1)), state, 20.0, 0.0).integral == pytest.approx(80.0)


@pytest.mark.parametrize(("new_range", "expected"), [((0.0, 100.0), 60.0), ((0.0, 40.0), 40.0), ((70.0, 90.0), 70.0)])
def test_a_change_of_range_moves_co_to_the_nearest_end(new_range, expected):
    """Nothing can stay where it is no longer allowed; and when the range opens again, co stays where it was."""
    old = law(PidGains(2.0, 0.1))
    low, high = new_range
    new = law(PidGains(5.0, 0.1), co_min=low, co_max=high)
    state = start(old, 30.0, 20.0, 60.0)
    after = change(old, new, state, 30.0, 20.0)
    narrowed, co = step(new, after, 30.0, 20.0, 1e-9)
    assert co == pytest.approx(expected)
    back = change(new, old, narrowed, 30.0, 20.0)

    assert step(old, back, 30.0, 20.0, 1e-9)[1] == pytest.approx(expected)


def test_a_range_that_opens_at_a_limit_does_not_let_the_excess_out():
    """co stood at 40 of 0..40 with a wish of 240; with 0..100 it starts from 40, not from 100."""
    old, new = law(PidGains(10.0, 0.1), co_max=40.0), law(PidGains(10.0, 0.1))
    state, co = step(old, start(old, 0.0, 0.0, 40.0), 20.0, 0.0, 1.0)
    assert co == 40.0

    assert step(new, change(old, new, state, 20.0, 0.0), 20.0, 0.0, 1.0)[1] == pytest.approx(40.0)


def test_a_change_in_manual_does_not_show_in_automatic():
    old, new = law(PidGains(2.0, 0.1, 5.0), tau_f_s=2.0), law(PidGains(7.0, 0.9, 0.0), b=0.3)
    state, _ = track(old, start(old, 40.0, 40.0, 30.0), 55.0, 40.0, 70.0, 1.0)
    state, co = track(new, change(old, new, state, 55.0, 40.0), 55.0, 40.0, 70.0, 1.0)
    assert co == 70.0

    assert step(new, state, 55.0, 40.0, 1.0)[1] == pytest.approx(70.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("gains", [PidGains(1, 1, 1), PidGains(1, 0, 0), PidGains(0, 1, 0), PidGains(0, 0, 1)])
def test_what_is_no_number_is_refused_and_named(bad, gains):
    old, new = law(gains, b=0.0), law(gains, b=0.5)
    state = start(old, 50.0, 50.0, 50.0)
    for name, arguments in (("sp", (bad, 50.0, 1.0)), ("pv", (50.0, bad, 1.0)), ("dt_s", (50.0, 50.0, bad))):
        with pytest.raises(ValueError, match=name):
            change(old, new, state, *arguments)


def test_time_must_not_go_back():
    settings = law(PidGains(1.0, 1.0))
    with pytest.raises(ValueError, match="dt_s = -1"):
        change(settings, settings, start(settings, 0.0, 0.0, 0.0), 0.0, 0.0, -1.0)
