"""The PID law: limits, anti-windup, manual and automatic, refusal of what is no number."""

import math
import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.schedule.gains import PidGains
from retuner.schedule.pid import LIMITED, PidLaw, PidState, change, law, start, step, track

sizes = st.just(0.0) | st.floats(1e-3, 1e3)
signals = st.floats(-1e3, 1e3)
intervals = st.floats(1e-3, 1e2)


@st.composite
def laws(draw):
    sign = draw(st.sampled_from((1.0, -1.0)))
    kp, ki, kd = draw(st.tuples(sizes, sizes, sizes).filter(any))
    low = draw(st.floats(-100, 100))
    return PidLaw(
        sign * kp,
        sign * ki,
        sign * kd,
        b=draw(st.floats(0, 1)),
        tau_f_s=draw(st.just(0.0) | st.floats(1e-3, 1e2)),
        co_min=low,
        co_max=low + draw(st.floats(1e-3, 200)),
        co_rate_per_s=draw(st.none() | st.floats(1e-3, 1e3)),
    )


samples = st.lists(st.tuples(signals, signals, intervals), min_size=1, max_size=20)


def run(settings, state, steps):
    """States and outputs of a row of (sp, pv, dt)."""
    states, outputs = [], []
    for sp, pv, dt_s in steps:
        state, co = step(settings, state, sp, pv, dt_s)
        states.append(state)
        outputs.append(co)
    return states, outputs


def test_one_step_by_hand():
    """Every term: P = 2 (0.5 x 60 - 50), D over a filter of 3 s and 1 s of sampling, I for the next sample."""
    settings = PidLaw(2.0, 0.5, 4.0, b=0.5, tau_f_s=3.0)
    state = PidState(integral=100.0, pv=48.0, pv_rate=0.4, co=50.0, limited=0)
    after, co = step(settings, state, 60.0, 50.0, 1.0)
    slope = (3.0 * 0.4 + 2.0) / 4.0

    assert co == pytest.approx(2.0 * (30.0 - 50.0) + 100.0 - 4.0 * slope)
    assert PidState(*after) == pytest.approx((105.0, 50.0, slope, co, 0))


@given(laws(), signals, signals, st.floats(-200, 300), samples)
def test_range_and_rate_hold_always(settings, sp, pv, co, steps):
    begin = start(settings, sp, pv, co)
    last = begin.co
    for state, now, (_, _, dt_s) in zip(*run(settings, begin, steps), steps, strict=True):
        assert settings.co_min <= now <= settings.co_max
        assert state[LIMITED] == (now >= settings.co_max) - (now <= settings.co_min)
        if settings.co_rate_per_s is not None:
            assert abs(now - last) <= settings.co_rate_per_s * dt_s * (1 + 1e-12) + 1e-12
        last = now


@given(laws(), signals, signals, st.floats(-200, 300), samples)
def test_reverse_action_is_the_mirror_image(settings, sp, pv, co, steps):
    """Negative gains on negated signals give the same outputs, bit for bit."""
    mirror = replace(settings, kp=-settings.kp, ki=-settings.ki, kd=-settings.kd)
    _, outputs = run(settings, start(settings, sp, pv, co), steps)
    _, mirrored = run(mirror, start(mirror, -sp, -pv, co), [(-s, -p, d) for s, p, d in steps])

    assert mirrored == outputs


@given(laws(), signals, signals, st.floats(-200, 300), samples)
def test_both_limits_are_treated_alike(settings, sp, pv, co, steps):
    """Turning the output's axis round (co -> -co) turns everything round, bit for bit: no side is special."""
    turned = replace(
        settings, kp=-settings.kp, ki=-settings.ki, kd=-settings.kd, co_min=-settings.co_max, co_max=-settings.co_min
    )
    _, outputs = run(settings, start(settings, sp, pv, co), steps)
    _, other = run(turned, start(turned, sp, pv, -co), steps)

    assert other == [-u for u in outputs]


@given(laws(), signals, signals, st.floats(-200, 300), samples)
def test_the_integral_never_grows_where_the_output_cannot_follow(settings, sp, pv, co, steps):
    """Range or rate, whichever side; and it never moves against the error or further than the error asks."""
    state = start(settings, sp, pv, co)
    for new, now, (r, y, dt_s) in zip(*run(settings, state, steps), steps, strict=True):
        growth, asked = new[0] - state[0], settings.ki * (r - y) * dt_s
        wish = settings.kp * (settings.b * r - y) + state[0] - settings.kd * new[2]
        if wish > now:
            assert growth <= 0.0
        if wish < now:
            assert growth >= 0.0
        assert growth * asked >= 0.0
        assert abs(growth) <= abs(asked) * (1.0 + 1e-12) + 1e-9 * (1.0 + abs(state[0]))
        state = new


@pytest.mark.parametrize("rate", [None, 5.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("gains", [PidGains(2.0, 0.5), PidGains(2.0, 0.5, 1.0), PidGains(0.0, 0.5), PidGains(2.0, 0.0)])
def test_time_spent_in_saturation_leaves_no_trace(gains, side, rate):
    """A setpoint out of reach for 1000 s instead of 100 s changes nothing in what follows."""
    settings = law(gains, tau_f_s=0.5, co_rate_per_s=rate)

    def after(stay_s: int) -> PidState:
        state = start(settings, 50.0, 50.0, 50.0)
        for _ in range(stay_s):
            state, co = step(settings, state, 50.0 + side * 500.0, 50.0, 1.0)
        assert co == (100.0 if side > 0 else 0.0)
        assert state[LIMITED] == side
        return PidState(*state)

    assert after(1000) == after(100)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("gains", "sign"), [(PidGains(2.0, 0.5), 1.0), (PidGains(-2.0, -0.5), -1.0)])
def test_saturation_ends_at_once_when_the_error_turns(gains, sign, side):
    settings = law(gains)
    state = start(settings, 50.0, 50.0, 50.0)
    for _ in range(500):
        state, co = step(settings, state, 50.0 + sign * side * 30.0, 50.0, 1.0)
    limit = 100.0 if side > 0 else 0.0
    assert co == limit
    state, co = step(settings, state, 50.0 - sign * side * 1.0, 50.0, 1.0)

    assert (limit - co) * side > 0.0


def test_coarse_steps_do_not_throw_the_integral_beyond_the_limit():
    """ki e dt is eight times the range here: the integral stops at the limit, not beyond it."""
    settings = law(PidGains(0.0, 1.0))
    state, _ = step(settings, start(settings, 0.0, 0.0, 50.0), 80.0, 0.0, 10.0)
    assert state[0] == 100.0
    state, co = step(settings, state, 80.0, 0.0, 10.0)
    assert (state[0], co) == (100.0, 100.0)
    state, _ = step(settings, state, -1.0, 0.0, 10.0)

    assert step(settings, state, -1.0, 0.0, 10.0)[1] == 90.0


@given(laws(), signals, signals, st.floats(-200, 300), samples)
def test_without_integral_action_the_bias_stays(settings, sp, pv, co, steps):
    """P and PD controllers keep their bias, also while range and rate limit them."""
    settings = replace(settings, kp=settings.kp or settings.ki or settings.kd, ki=0.0)
    state = start(settings, sp, pv, co)

    assert {s[0] for s in run(settings, state, steps)[0]} == {state.integral}


def test_noise_beyond_the_rate_limit_does_not_stall_the_integral():
    """Noise of 3 times kp 5 wants 15 a sample, the rate allows 1: from 20 below, the mean comes to sp."""
    settings = law(PidGains(5.0, 0.1), co_rate_per_s=1.0)
    rng = random.Random(1)
    state, pv, errors = start(settings, 50.0, 30.0, 30.0), 30.0, []
    for k in range(8000):
        state, co = step(settings, state, 50.0, pv + rng.gauss(0.0, 3.0), 1.0)
        pv += (co - pv) / 50.0
        if k >= 4000:
            errors.append(50.0 - pv)

    assert abs(sum(errors) / len(errors)) < 0.3


@pytest.mark.parametrize("rate", [0.2, 0.5, 1.0, 2.0, 5.0])
@pytest.mark.parametrize("size", [10.0, 30.0, 50.0, -15.0])
def test_a_rate_limit_does_not_wind_up(rate, size):
    """A setpoint step through a slow actuator, of a loop that has no overshoot of its own."""
    settings = law(PidGains(4.0, 0.2), co_rate_per_s=rate)
    state, pv, peak = start(settings, 20.0, 20.0, 20.0), 20.0, 0.0
    for _ in range(1000):
        state, co = step(settings, state, 20.0 + size, pv, 0.5)
        pv += 0.5 * (co - pv) / 20.0
        peak = max(peak, (pv - 20.0) / size)

    assert 0.99 < peak < 1.001
    assert pv == pytest.approx(20.0 + size, abs=0.1)


@given(laws(), signals, signals, st.floats(-200, 300), intervals)
def test_start_takes_over_without_a_bump(settings, sp, pv, co, dt_s):
    held = min(max(co, settings.co_min), settings.co_max)
    state = start(settings, sp, pv, co)

    assert state.co == held
    assert step(settings, state, sp, pv, dt_s)[1] == pytest.approx(held, abs=1e-9)


moves_by_hand = st.lists(st.tuples(signals, st.floats(-200, 300), intervals), min_size=1, max_size=9)


@given(laws(), signals, signals, moves_by_hand)
def test_manual_moves_keep_range_and_rate(settings, sp, pv, moves):
    state = start(settings, sp, pv, 0.0)
    for y, wanted, dt_s in moves:
        last = state[3]
        state, co = track(settings, state, sp, y, wanted, dt_s)
        reach = math.inf if settings.co_rate_per_s is None else settings.co_rate_per_s * dt_s
        nearest = min(max(wanted, last - reach), last + reach)
        assert co == state[3] == min(max(nearest, settings.co_min), settings.co_max)
        assert state[LIMITED] == (co >= settings.co_max) - (co <= settings.co_min)


@given(laws(), signals, signals, moves_by_hand)
def test_automatic_goes_on_from_manual_without_a_bump(settings, sp, pv, moves):
    """Whatever the error: when pv goes on with its slope, D is as it was and only P follows pv."""
    state = start(settings, sp, pv, 0.0)
    for y, wanted, dt_s in moves:
        state, co = track(settings, state, sp, y, wanted, dt_s)
    going_on = y + state[2] * dt_s
    p_follows = settings.kp * (y - going_on)
    reach = math.inf if settings.co_rate_per_s is None else settings.co_rate_per_s * dt_s
    expected = min(max(co + p_follows, co - reach, settings.co_min), co + reach, settings.co_max)
    rounding = 1e-12 * (abs(settings.kp) * (abs(sp) + abs(y) + abs(going_on)) + abs(settings.kd * state[2]) + 1e3)

    assert step(settings, state, sp, going_on, dt_s)[1] == pytest.approx(expected, abs=rounding)


@given(laws(), samples, st.sampled_from((5e-324, 1e-300, 1e-9, 1e9, 1e300)))
def test_whatever_happens_the_state_stays_finite(settings, steps, odd_dt):
    state = start(settings, 0.0, 0.0, 0.0)
    for sp, pv, dt_s in [*steps, (*steps[0][:2], odd_dt), *steps]:
        try:
            state, _ = step(settings, state, sp, pv, dt_s)
        except ValueError:
            assert dt_s == odd_dt
        assert all(math.isfinite(value) for value in state)


# ---- Changes of gains, b and tau_f without a bump: in range, at either limit, under a rate limit

SPAN = 100.0
BUMP = 1e-9 * SPAN  # What the issue allows, two-sided

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


@pytest.mark.slow
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
