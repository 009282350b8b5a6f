"""The PID law in closed loop against the loop's own transfer function, and against the continuous loop."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from retuner.schedule.gains import PidGains
from retuner.schedule.pid import PidLaw, law, start, step, track

FREE = {"co_min": -1e9, "co_max": 1e9}


def simulate(settings: PidLaw, k: float, tau_s: float, dt_s: float, sp: list[float], load: list[float]) -> list[float]:
    """pv of k/(tau s + 1) with zero-order hold, exact, starting from rest at 0."""
    decay = math.exp(-dt_s / tau_s)
    state, pv, record = start(settings, 0.0, 0.0, 0.0), 0.0, []
    for r, d in zip(sp, load, strict=True):
        record.append(pv)
        state, co = step(settings, state, r, pv, dt_s)
        pv = decay * pv + (1.0 - decay) * k * (co + d)
    return record


def closed_loop(settings: PidLaw, k: float, tau_s: float, dt_s: float):
    """Numerators of sp -> pv and load -> pv and their denominator, polynomials in z^-1, from the equations alone.

    G = (1-a) k q/(1 - a q),  C_r = b kp + ki dt q/(1 - q),
    C_y = kp + ki dt q/(1 - q) + kd (1 - q)/(tau_f + dt - tau_f q)
    with q = z^-1 and a = exp(-dt/tau);  pv = G C_r/(1 + G C_y) sp + G/(1 + G C_y) load.
    """
    a = math.exp(-dt_s / tau_s)
    plant_num, plant_den = np.array([0.0, (1.0 - a) * k]), np.array([1.0, -a])
    one_minus_q, q = np.array([1.0, -1.0]), np.array([0.0, 1.0])
    lag = np.array([settings.tau_f_s + dt_s, -settings.tau_f_s])
    c_den = np.convolve(one_minus_q, lag)
    integral = settings.ki * dt_s * np.convolve(q, lag)
    c_r = settings.b * settings.kp * c_den + integral
    c_y = settings.kp * c_den + integral + settings.kd * np.convolve(one_minus_q, one_minus_q)
    den = np.convolve(plant_den, c_den) + np.convolve(plant_num, c_y)
    return np.convolve(plant_num, c_r), np.convolve(plant_num, c_den), den


@pytest.mark.parametrize("k", [2.0, -0.4])
@pytest.mark.parametrize(
    ("gains", "b", "tau_f_s"),
    [
        (PidGains(3.0, 0.4), 1.0, 0.0),
        (PidGains(3.0, 0.4), 0.3, 0.0),
        (PidGains(3.0, 0.4, 2.0), 0.5, 1.5),
        (PidGains(3.0, 0.4, 0.5), 1.0, 0.0),
        (PidGains(2.0, 0.0), 1.0, 0.0),
        (PidGains(2.0, 0.0, 3.0), 1.0, 2.0),
        (PidGains(0.0, 0.1), 1.0, 0.0),
        (PidGains(0.0, 0.1, 0.3), 0.7, 0.8),
    ],
)
def test_the_loop_is_its_transfer_function(k, gains, b, tau_f_s):
    """Setpoint steps and a load, all terms in play: equal to the filter that the z-transfer functions give."""
    scaled = PidGains(gains.kp / k, gains.ki / k, gains.kd / k)
    settings = law(scaled, b=b, tau_f_s=tau_f_s, **FREE)
    n, dt_s, tau_s = 600, 0.25, 10.0
    sp = [0.0] * 5 + [10.0] * 295 + [-4.0] * 300
    load = [0.0] * 150 + [3.0] * 300 + [1.0] * 150
    from_sp, from_load, den = closed_loop(settings, k, tau_s, dt_s)
    expected = lfilter(from_sp, den, sp) + lfilter(from_load, den, load)
    pv = simulate(settings, k, tau_s, dt_s, sp, load)

    assert np.max(np.abs(expected)) > 3.0
    np.testing.assert_allclose(pv, expected, rtol=0, atol=1e-9 * np.max(np.abs(expected)))
    assert len(pv) == n


def error_against_continuous(dt_s: float) -> float:
    """PI with tau_i = tau on a first-order process: the closed loop is exactly 1/(tau_c s + 1), tau_c = tau/(k kc)."""
    k, tau_s, tau_c = 1.5, 20.0, 5.0
    kc = tau_s / (k * tau_c)
    n = round(30.0 / dt_s)
    pv = simulate(law(PidGains(kc, kc / tau_s), **FREE), k, tau_s, dt_s, [1.0] * n, [0.0] * n)
    return max(abs(y - (1.0 - math.exp(-i * dt_s / tau_c))) for i, y in enumerate(pv))


def test_the_loop_becomes_the_continuous_one():
    """First-order convergence: half the sample time, half the error; 0.1 % at 1/500 of tau_c."""
    errors = [error_against_continuous(5.0 / n) for n in (125, 250, 500)]

    assert errors[2] < 1e-3
    for coarse, fine in pairwise(errors):
        assert coarse / fine == pytest.approx(2.0, rel=0.02)


def test_the_filtered_derivative_becomes_the_continuous_one():
    """pv = ramp of slope m from 0: D = -kd m (1 - exp(-t/tau_f)) in the limit; first-order convergence again."""
    kd, slope, tau_f = 4.0, 0.5, 2.0

    def error(dt_s: float) -> float:
        settings = law(PidGains(0.0, 0.0, kd), tau_f_s=tau_f, **FREE)
        state, worst = start(settings, 0.0, 0.0, 0.0), 0.0
        for i in range(1, round(10.0 / dt_s)):
            state, co = step(settings, state, 0.0, slope * i * dt_s, dt_s)
            worst = max(worst, abs(co + kd * slope * (1.0 - math.exp(-i * dt_s / tau_f))))
        return worst

    assert error(0.001) < 1e-3 * kd * slope
    assert error(0.01) / error(0.005) == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("tau_f_s", [0.0, 1e-6, 1.0, 1e6])
@pytest.mark.parametrize("dt_s", [1e-6, 1.0, 1e6])
def test_the_derivative_filter_is_stable_for_every_sample_time(tau_f_s, dt_s):
    """Its impulse response falls monotonically, without a change of sign: neither blows up nor rings."""
    settings = law(PidGains(0.0, 0.0, 1.0), tau_f_s=tau_f_s, co_min=-1e300, co_max=1e300)
    state, first = step(settings, start(settings, 0.0, 0.0, 0.0), 0.0, 1.0, dt_s)
    assert first == pytest.approx(-1.0 / (tau_f_s + dt_s))
    last = first
    for _ in range(50):
        state, co = step(settings, state, 0.0, 1.0, dt_s)
        assert last <= co <= 0.0
        last = co


def test_a_setpoint_step_gives_no_derivative_kick():
    with_d, without = (law(PidGains(2.0, 0.1, kd), tau_f_s=0.1) for kd in (50.0, 0.0))
    steps = [step(settings, start(settings, 50.0, 50.0, 50.0), 60.0, 50.0, 0.1)[1] for settings in (with_d, without)]

    assert steps == [70.0, 70.0]


# ---- What is no number, no time or no setting never gets into the law, and the state stays good

BAD = (math.nan, math.inf, -math.inf)


@pytest.mark.parametrize("gains", [PidGains(1, 1, 1), PidGains(1, 0, 0), PidGains(0, 1, 0), PidGains(0, 0, -1)])
@pytest.mark.parametrize("b", [0.0, 0.5])
@pytest.mark.parametrize("tau_f_s", [0.0, 2.0])
@pytest.mark.parametrize("rate", [None, 3.0])
def test_what_is_no_number_is_refused_and_named(gains, b, tau_f_s, rate):
    """Whichever gains are zero, no NaN or infinity gets in; the next good sample goes on as if nothing had been."""
    settings = law(gains, b=b, tau_f_s=tau_f_s, co_rate_per_s=rate)
    state, _ = step(settings, start(settings, 50.0, 50.0, 50.0), 52.0, 51.0, 1.0)
    expected = step(settings, state, 52.0, 51.5, 1.0)
    for bad in BAD:
        for name, sp, pv, dt_s in (("sp", bad, 51.0, 1.0), ("pv", 52.0, bad, 1.0), ("dt_s", 52.0, 51.0, bad)):
            with pytest.raises(ValueError, match=name):
                step(settings, state, sp, pv, dt_s)
            with pytest.raises(ValueError, match=name):
                track(settings, state, sp, pv, 50.0, dt_s)
        with pytest.raises(ValueError, match="co"):
            track(settings, state, 52.0, 51.0, bad, 1.0)
        for sp, pv, co in ((bad, 50.0, 50.0), (50.0, bad, 50.0), (50.0, 50.0, bad)):
            with pytest.raises(ValueError, match="not a finite number"):
                start(settings, sp, pv, co)

    assert step(settings, state, 52.0, 51.5, 1.0) == expected


@pytest.mark.parametrize("dt_s", [0.0, -0.0, -1.0])
@pytest.mark.parametrize("tau_f_s", [0.0, 2.0])
def test_time_must_go_forward(dt_s, tau_f_s):
    settings = law(PidGains(1.0, 1.0, 1.0), tau_f_s=tau_f_s)
    state = start(settings, 50.0, 50.0, 50.0)
    with pytest.raises(ValueError, match=r"dt_s = .* must be positive"):
        step(settings, state, 50.0, 50.0, dt_s)
    with pytest.raises(ValueError, match=r"dt_s = .* must be positive"):
        track(settings, state, 50.0, 50.0, 50.0, dt_s)


def test_a_result_too_large_for_a_number_is_refused():
    settings = law(PidGains(1e300, 1.0))
    with pytest.raises(ValueError, match="too large"):
        step(settings, start(settings, 0.0, 0.0, 50.0), 1e300, 0.0, 1.0)


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"b": 1.1}, "b = 1.1"),
        ({"b": -0.1}, "b = -0.1"),
        ({"b": math.nan}, "b = nan"),
        ({"tau_f_s": -1.0}, "tau_f_s"),
        ({"tau_f_s": math.inf}, "tau_f_s"),
        ({"tau_f_s": math.nan}, "tau_f_s"),
        ({"co_min": 100.0}, "co_min < co_max"),
        ({"co_max": math.inf}, "= inf"),
        ({"co_min": math.nan}, "co_min"),
        ({"co_rate_per_s": 0.0}, "co_rate_per_s"),
        ({"co_rate_per_s": math.nan}, "co_rate_per_s"),
        ({"co_rate_per_s": math.inf}, "None for no limit"),
    ],
)
def test_settings_out_of_range_are_refused(settings, what):
    with pytest.raises(ValueError, match=what):
        law(PidGains(1.0, 1.0), **settings)


def test_law_takes_its_gains_and_gives_them_back():
    settings = law(PidGains(1.0, 2.0, 3.0), b=0.5, tau_f_s=1.0, co_min=5.0, co_max=95.0, co_rate_per_s=2.0)
    other = settings.with_gains(PidGains(4.0, 5.0, 6.0))

    assert settings.gains == PidGains(1.0, 2.0, 3.0)
    assert other == PidLaw(4.0, 5.0, 6.0, 0.5, 1.0, 5.0, 95.0, 2.0)
    with pytest.raises(ValueError, match="different signs"):
        PidLaw(1.0, -1.0, 0.0)
