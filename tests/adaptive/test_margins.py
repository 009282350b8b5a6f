"""Margins against closed forms and the published table of Skogestad (2003)."""

import math

import control
import numpy as np
import pytest
from effort import examples, sized
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid
from scipy.linalg import expm

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc_on
from retuner.adaptive.loop.margins import Margins, _peak, margins, sensitivity_peak
from retuner.adaptive.loop.most_integral import most_integral
from retuner.adaptive.loop.open_loop import OpenLoop, gain_crossovers, grid, open_loop
from retuner.adaptive.loop.performance import Performance, performance, weighted_cost
from retuner.adaptive.loop.simulate import step_response
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType, state_space
from retuner.adaptive.rules.simc import simc
from retuner.schedule.gains import PidGains


def series(kc: float, tau_i: float, tau_d: float = 0.0) -> PidGains:
    return PidGains(kc * (1 + tau_d / tau_i), kc / tau_i, kc * tau_d)


@pytest.mark.parametrize("tau1", [1.0, 3.0, 8.0])
def test_simc_first_order_has_the_closed_form_margins(tau1: float) -> None:
    # tau_I = tau1 makes L = e^-s / (2 s): GM = pi, PM = pi/2 - 1/2, delay margin pi - 1 (Skogestad 2003)
    found = margins(LinearProcess(1.0, (tau1,), (), 1.0), series(0.5 * tau1, tau1))
    assert found.gm == pytest.approx(math.pi, rel=1e-6)
    assert found.pm_deg == pytest.approx(math.degrees(math.pi / 2 - 0.5), rel=1e-6)
    assert found.delay_margin_s == pytest.approx(math.pi - 1, rel=1e-6)
    assert found.w180 == pytest.approx(math.pi / 2, rel=1e-6)
    assert found.wc == pytest.approx(0.5, rel=1e-6)
    assert found.ms == pytest.approx(1.590, abs=5e-4)
    assert found.mt == pytest.approx(1.0, abs=1e-6)


def test_positive_feedback_is_unstable() -> None:
    assert not margins(LinearProcess(-1.0, (2.0,), (), 0.5), PidGains(0.1, 0.01)).stable
    assert math.isinf(sensitivity_peak(LinearProcess(-1.0, (2.0,), (), 0.5), PidGains(0.1, 0.01)))


@given(a=st.floats(1e-3, 1e3), g=st.floats(1e-3, 1e3), sign=st.sampled_from([1, -1]))
def test_margins_do_not_depend_on_units(a: float, g: float, sign: int) -> None:
    base = margins(LinearProcess(1.0, (5.0, 1.0), (), 1.0), PidGains(2.0, 0.4, 0.8))
    scaled = margins(
        LinearProcess(sign * g, (5.0 * a, a), (), a), PidGains(sign * 2.0 / g, sign * 0.4 / g / a, sign * 0.8 / g * a)
    )
    for name in ("ms", "mt", "gm", "pm_deg"):
        assert getattr(scaled, name) == pytest.approx(getattr(base, name), rel=1e-5)
    assert scaled.wc * a == pytest.approx(base.wc, rel=1e-5)
    assert scaled.delay_margin_s / a == pytest.approx(base.delay_margin_s, rel=1e-5)


@pytest.mark.parametrize("place", [0, 3, 7])
def test_what_cannot_be_told_is_not_robust(place: int) -> None:
    """One value that is not a number among the sizes: no peak is known, and a guard must not read a small one."""
    w = np.geomspace(0.1, 10.0, 8)

    def size(x):
        return np.where(np.isclose(x, w[place]), np.nan, 1.0 + x)

    assert _peak(size, w, 1.0) == math.inf
    assert _peak(lambda x: 1.0 + x, w, 1.0) == 11.0


@pytest.mark.parametrize("kd", [10.0, 30.0, 45.0, 49.0])
def test_unfiltered_derivative_on_a_first_order_process_ends_at_a_finite_loop_gain(kd: float) -> None:
    # |L| tends to k kd / tau while the delay turns it for ever: the supremum of |S| there is 1 / (1 - k kd / tau)
    found = margins(LinearProcess(1.0, (50.0,), (), 10.0), PidGains(2.0, 0.04, kd))
    assert found.stable
    assert found.ms >= 0.9 / (1 - kd / 50)
    assert not margins(LinearProcess(1.0, (50.0,), (), 10.0), PidGains(2.0, 0.04, 60.0)).stable


def test_a_controller_that_hardly_acts_has_hardly_a_peak() -> None:
    """|S| is all but flat there, and a step of Newton's method towards its peak is no number."""
    process = LinearProcess(0.0035886848835599817, (10.614086953501442, 2.7016428861101334), (), 0.15435742997288296)
    gains = PidGains(1.9576638508544647e-06, 1.3394817629288147e-07)
    assert sensitivity_peak(process, gains) == pytest.approx(1.0, abs=1e-6)


# ---- Margins and stability of random loops against python-control, polynomial roots and a dense winding count

SEED = 20240607
RATIONAL, DELAYED = sized((170, 34), (170, 34), (850, 170))
STABLE = 500 / 1020  # of the loops, at least, or too little is compared


def random_loop(rng: np.random.Generator, *, delayed: bool) -> tuple[LinearProcess, PidGains, float]:
    """A process of one to four poles, integrators, zeros on either side, pairs that swing; P, PI, I, PID, PD."""
    lags = tuple(float(10 ** rng.uniform(-1.5, 1.5)) for _ in range(rng.integers(1, 4)))
    leads = tuple(float(rng.choice([-1, 1]) * 10 ** rng.uniform(-1.5, 0.5)) for _ in range(rng.integers(0, len(lags))))
    quadratics = ((float(10 ** rng.uniform(-1.5, 0.5)), float(10 ** rng.uniform(-1, 1))),) if rng.random() < 0.3 else ()
    theta = float(10 ** rng.uniform(-1.5, 1)) if delayed else 0.0
    k = float(rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1))
    process = LinearProcess(k, lags, leads, theta, int(rng.choice([0, 0, 0, 1, 2])), quadratics)
    kp, ki, kd = (float(math.copysign(10 ** rng.uniform(-1.5, 0.7), k) / abs(k)) for _ in range(3))
    chosen = [(kp, ki, 0.0), (kp, 0.0, 0.0), (0.0, ki, 0.0), (kp, ki, kd), (kp, 0.0, kd)][rng.integers(0, 5)]
    return process, PidGains(*chosen), float(rng.choice([0.03, 0.3])) if chosen[2] else 0.0


def rational(loop: OpenLoop) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of L without its dead time, highest power first."""
    num, den = np.array([loop.k]), np.array([1.0] + [0.0] * max(loop.order, 0))
    for factor in ((loop.b2, loop.b1, 1.0), *((x, 1.0) for x in loop.leads)):
        num = np.polymul(num, factor)
    for factor in (*((x, 1.0) for x in loop.lags), *((c2, c1, 1.0) for c1, c2 in loop.quadratics)):
        den = np.polymul(den, factor)
    return np.trim_zeros(num, "f"), den


def compare(found: Margins, loop: OpenLoop, theirs: tuple, rel: float) -> None:
    """All their crossings hold the margins that we report as the decisive ones."""
    gms, pms, sms, w180s, wcs, _ = theirs
    rising = [(g, w) for g, w in zip(gms, w180s, strict=True) if g > 1 + 1e-9 and np.isfinite(g)]
    gm, w180 = min(rising, default=(math.inf, math.inf))
    assert found.gm == pytest.approx(gm, rel=rel)
    assert found.w180 == pytest.approx(w180, rel=rel)
    ends = [1 / abs(1 + loop.at(w)) for w in (1e-6 * min(loop.corners()), 1e6 * max(loop.corners()))]
    assert found.ms == pytest.approx(max([*(1 / np.asarray(sms)), *ends]), rel=rel)
    if len(pms):
        i = int(np.argmin(np.abs(pms)))
        assert found.pm_deg == pytest.approx(abs(pms[i]), rel=rel, abs=1e-3)
        assert found.wc == pytest.approx(wcs[i], rel=rel)
    else:
        assert math.isinf(found.wc)


@pytest.mark.uncounted
def test_margins_agree_with_python_control() -> None:
    """Stable random loops (500 in CI), without dead time (polynomials) and with it (exact frequency response)."""
    rng, compared = np.random.default_rng(SEED), 0
    for i in range(RATIONAL + DELAYED):
        process, gains, tau_f = random_loop(rng, delayed=i >= RATIONAL)
        found, loop = margins(process, gains, tau_f), open_loop(process, gains, tau_f)
        if not found.stable:
            continue
        if process.theta_s:
            w = np.geomspace(0.3 * min(loop.corners()), 30 * max(loop.corners()), 1000)
            theirs = control.stability_margins(control.frd(loop.along(w), w), returnall=True)
            rel = 2e-3  # they interpolate between the points
        else:
            theirs = control.stability_margins(control.tf(*rational(loop)), returnall=True)
            rel = 1e-4
        compare(found, loop, theirs, rel)
        compared += 1
    assert compared >= int(STABLE * (RATIONAL + DELAYED))


def test_stability_agrees_with_the_roots_of_the_closed_loop() -> None:
    rng, stable = np.random.default_rng(SEED + 1), 0
    for _ in range(600):
        process, gains, tau_f = random_loop(rng, delayed=False)
        num, den = rational(open_loop(process, gains, tau_f))
        worst = float(np.max(np.roots(np.polyadd(num, den)).real))
        found = margins(process, gains, tau_f)
        if abs(worst) > 1e-9:
            assert found.stable is (worst < 0)
        assert found.stable is math.isfinite(sensitivity_peak(process, gains, tau_f))
        stable += found.stable
    assert 150 < stable < 500


def test_stability_with_dead_time_agrees_with_a_dense_winding_count() -> None:
    rng, stable = np.random.default_rng(SEED + 2), 0
    for _ in range(150):
        process, gains, tau_f = random_loop(rng, delayed=True)
        loop, found = open_loop(process, gains, tau_f), margins(process, gains, tau_f)
        # arg(1 + L) counted on a grid so dense that it never turns by more than a little between two points
        crossed = gain_crossovers(loop, grid(loop))
        last = 3 * max(crossed, default=max(loop.corners()))
        w = np.unique(
            np.concatenate([np.geomspace(1e-4 * min(loop.corners()), last, 20_000), np.linspace(1e-6, last, 20_000)])
        )
        f = 1 + loop.along(w)
        turned = float(np.sum(np.angle(f[1:] / f[:-1]))) - float(np.angle(f[-1]))
        start = 0.0 if loop.order > 0 else float(np.angle(f[0]))
        assert found.stable is (abs(turned + start - max(loop.order, 0) * math.pi / 2) < 1.0), (process, gains, tau_f)
        stable += found.stable
    assert 30 < stable < 130


def test_crossovers_and_peak_are_exact() -> None:
    rng, looked_at = np.random.default_rng(SEED + 3), 0
    for i in range(200):
        process, gains, tau_f = random_loop(rng, delayed=i % 2 == 0)
        found, loop = margins(process, gains, tau_f), open_loop(process, gains, tau_f)
        if not found.stable:
            continue
        if math.isfinite(found.wc):
            assert abs(loop.at(found.wc)) == pytest.approx(1, rel=1e-9)
        if math.isfinite(found.w180):
            value = loop.at(found.w180)
            assert value.imag == pytest.approx(0, abs=1e-9)
            assert found.gm == pytest.approx(-1 / value.real, rel=1e-9)
        w = np.geomspace(0.01 * min(loop.corners()), 100 * max(loop.corners()), 30_001)
        size = 1 / np.abs(1 + loop.along(w))
        assert found.ms >= float(np.max(size)) * (1 - 1e-10)
        assert sensitivity_peak(process, gains, tau_f) == pytest.approx(found.ms, rel=1e-7)
        looked_at += 1
    assert looked_at > 60


def test_an_added_dead_time_of_the_delay_margin_is_the_limit() -> None:
    process, gains = LinearProcess(1.0, (5.0, 1.0), (), 1.0), PidGains(2.0, 0.4, 1.0)
    room = margins(process, gains).delay_margin_s
    for share, stable in ((0.999, True), (1.001, False)):
        later = LinearProcess(1.0, (5.0, 1.0), (), 1.0 + room * share)
        assert margins(later, gains).stable is stable


@pytest.mark.parametrize(("k", "kp"), [(3.0, 0.5), (-3.0, -0.5), (0.5, 1.0)])
def test_a_static_process(k: float, kp: float) -> None:
    found = margins(LinearProcess(k), PidGains(kp, 0.0))
    assert found.stable
    assert found.ms == pytest.approx(1 / (1 + k * kp))
    assert margins(LinearProcess(k, (), (), 1.0), PidGains(kp, 0.0)).stable is (k * kp < 1)


# ---- The PI controller of most integral action at an Ms: what it keeps, and that no other tau_I has more


@given(
    dead=st.floats(0.05, 5.0),
    lag=st.floats(0.1, 5.0),
    zeta=st.floats(0.1, 1.0),
    ms=st.floats(1.3, 2.0),
    k=st.sampled_from([3.0, -0.2]),
)
@settings(max_examples=20)
def test_ms_is_what_was_asked_for_and_no_other_tau_i_has_more_integral(dead, lag, zeta, ms, k):
    process = LinearProcess(k, (), (), dead, 0, ((2 * zeta * lag, lag**2),))
    found = most_integral(process, ms)
    assert sensitivity_peak(process, found) == pytest.approx(ms, rel=0.015)
    assert found.kp * k > 0
    for factor in (
        0.7,
        1.4,
    ):  # as much integral action by another tau_I has a larger Ms, but for 3 % that are given away
        other = PidGains(found.kp * factor, found.ki * 1.06)
        assert sensitivity_peak(process, other) > ms * 0.995


def test_a_pure_dead_time_gets_a_tau_i_of_a_third_of_it_and_more() -> None:
    """SIMC's improved rule has tau_I = theta/3 and ki = 1/(2 k theta) there (Grimholt & Skogestad 2012), at less Ms."""
    found = most_integral(LinearProcess(2.0, (), (), 5.0), 1.59)
    assert 5.0 / 3 < found.kp / found.ki < 5.0 / 2
    assert 0.5 < found.ki * 2.0 * 5.0 < 0.65


def test_what_has_no_such_controller_is_refused() -> None:
    with pytest.raises(ValueError, match="integrating"):
        most_integral(LinearProcess(1.0, (), (), 1.0, 1), 1.6)
    with pytest.raises(ValueError, match="ms"):
        most_integral(LinearProcess(1.0, (1.0,), (), 1.0), 1.0)
    with pytest.raises(ValueError, match="nothing limits"):
        most_integral(LinearProcess(1.0, (1.0,)), 1.6)


def test_at_a_lag_of_one_dead_time_both_rules_meet() -> None:
    just_under, just_over = (ProcessModel(ProcessType.FOPDT, 1.0, tau, 0.0, 10.0) for tau in (9.99, 10.01))
    one, other = (robust_simc_on(m, (), 0.0, RobustSettings()).tuning.gains for m in (just_under, just_over))
    assert math.log(one.ki / other.ki) == pytest.approx(0.0, abs=0.1)
    assert math.log(one.kp / other.kp) == pytest.approx(0.0, abs=0.15)


def test_doubt_about_the_dead_time_makes_it_calmer() -> None:
    best = ProcessModel(ProcessType.FOPDT, 1.0, 2.0, 0.0, 10.0)
    longer = Plausible(ProcessModel(ProcessType.FOPDT, 1.0, 2.0, 0.0, 14.0), 1.0)
    sure, unsure = (robust_simc_on(best, other, 0.5, RobustSettings()) for other in ((), (longer,)))
    assert unsure.tuning.gains.ki < 0.95 * sure.tuning.gains.ki
    assert unsure.ms_worst <= RobustSettings().ms_worst + 0.01


def test_an_almost_pure_dead_time_can_be_reached_by_limited_steps() -> None:
    """SIMC's tau_I is a thirteenth of what is asked for here, and its gain with it: out of reach of any limit."""
    model = ProcessModel(ProcessType.FOPDT, 3.2, 1.35, 0.0, 17.6)
    given_, by_simc = robust_simc_on(model, (), 0.5, RobustSettings()).tuning.gains, simc(model).gains
    assert given_.ki == pytest.approx(by_simc.ki, rel=0.2)
    assert 4 < given_.kp / by_simc.kp < 10


# ---- IAE and TV against closed forms, against a plain simulation, and under changes of units


@given(tau=st.floats(0.1, 100), kc=st.floats(0.1, 10), k=st.floats(0.1, 10), sign=st.sampled_from([1, -1]))
def test_first_order_with_pole_cancelled_is_a_first_order_loop(tau: float, kc: float, k: float, sign: int) -> None:
    # L = k Kc/(tau s): y = 1 - exp(-k Kc t/tau); IAE = tau/(k Kc); u falls from Kc to 1/k
    found = performance(LinearProcess(sign * k, (tau,)), PidGains(sign * kc, sign * kc / tau))
    assert found.iae_setpoint == pytest.approx(tau / (k * kc), rel=1e-6)
    assert found.iae_load == pytest.approx(tau / kc, rel=1e-6)
    assert found.tv_setpoint == pytest.approx(kc + abs(kc - 1 / k), rel=1e-6)
    assert found.tv_load == pytest.approx(1.0, rel=1e-6)


@given(theta=st.floats(0.1, 10), share=st.floats(0.01, 0.36))
def test_an_integral_controller_on_a_pure_delay_without_overshoot(theta: float, share: float) -> None:
    # ki k theta < 1/e: the response is monotone, so IAE = the integral of the error = 1/(k ki)
    found = performance(LinearProcess(2.0, (), (), theta), PidGains(0.0, share / theta / 2))
    assert found.iae_setpoint == pytest.approx(theta / share, rel=1e-6)
    assert found.iae_load == pytest.approx(2 * theta / share, rel=1e-6)
    assert found.tv_setpoint == pytest.approx(1 / 2, rel=1e-6)


def test_the_lightly_damped_second_order_loop() -> None:
    # I control of a lag: T = w0^2/(s^2 + 2 zeta w0 s + w0^2). e = exp(-zeta w0 t)(cos wd t + zeta w0/wd sin wd t)
    zeta, w0 = 0.1, 2.0
    wd = w0 * math.sqrt(1 - zeta**2)
    found = performance(LinearProcess(1.0, (1 / (2 * zeta * w0),)), PidGains(0.0, w0 / (2 * zeta)))
    t = np.linspace(0, 150, 3_000_001)
    e = np.exp(-zeta * w0 * t) * (np.cos(wd * t) + zeta * w0 / wd * np.sin(wd * t))
    assert found.iae_setpoint == pytest.approx(float(trapezoid(np.abs(e), t)), rel=1e-6)


def test_proportional_control_of_an_integrator_with_dead_time() -> None:
    # until 2 theta the response is a polynomial: y = Kc (t - 1) on [1, 2]; monotone for Kc < 1/e: IAE = 1/Kc
    assert performance(LinearProcess(1.0, (), (), 1.0, 1), PidGains(0.3, 0.0)).iae_setpoint == pytest.approx(1 / 0.3)
    drawn = step_response(LinearProcess(1.0, (), (), 1.0, 1), PidGains(0.3, 0.0), 10.0)
    for t, y in ((0.5, 0.0), (1.5, 0.15), (2.0, 0.3), (2.5, 0.3 + 0.15 - 0.09 / 8)):
        assert float(np.interp(t, drawn.t, drawn.pv)) == pytest.approx(y, abs=1e-4)


def simulated(process: LinearProcess, gains: PidGains, tau_f: float, load: float, dt: float) -> tuple[float, float]:
    """IAE and TV by a plain loop: exact process between samples, controller held, derivative filtered."""
    plant = state_space(process, 1.0)
    n = len(plant.b)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = plant.a, plant.b
    step = expm(block * dt)
    x, z, filtered, area, travel, last = np.zeros(n), 0.0, 0.0, 0.0, 0.0, 0.0
    held = [0.0] * (round(process.theta_s / dt) + 1)
    for i in range(round(150 / dt)):
        e = (1 - load) - plant.c @ x
        rate = (e - filtered) / tau_f if tau_f else 0.0
        u = gains.kp * e + gains.ki * z + gains.kd * rate
        travel, last = travel + abs(u - last), u
        held[i % len(held)] = u
        x = step[:n, :n] @ x + step[:n, n] * (held[(i + 1) % len(held)] + load)
        after = (1 - load) - plant.c @ x
        area += 0.5 * (abs(e) + abs(after)) * dt
        z += 0.5 * (e + after) * dt
        filtered += (1 - math.exp(-dt / tau_f)) * (0.5 * (e + after) - filtered) if tau_f else 0.0
    return area, travel


SIMULATED = [
    (LinearProcess(1.0, (8.0, 2.0), (), 1.0), PidGains(4.0, 0.5, 6.0), 0.5),
    (LinearProcess(2.0, (3.0, 1.0, 0.5), (-0.5,), 0.5), PidGains(0.6, 0.2), 0.0),
    (LinearProcess(1.0, (1.0, 1.0, 0.1), (0.2, 0.2), 0.0, 1), PidGains(0.3, 0.02), 0.0),
    (LinearProcess(-1.0, (4.0,), (), 0.3, 1), PidGains(-0.2, -0.01, -0.6), 0.5),
    (LinearProcess(1.0, (3.0,), (), 0.2, 0, ((0.5, 1.0),)), PidGains(0.6, 0.3), 0.0),
    (LinearProcess(1.0, (50.0, 0.05), (), 1.0), PidGains(20.0, 2.0), 0.0),
    (LinearProcess(1.0, (), (), 1.0, 1), PidGains(0.5, 0.0625), 0.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("process", "gains", "tau_f"), SIMULATED)
def test_against_a_plain_simulation(process: LinearProcess, gains: PidGains, tau_f: float) -> None:
    found, dt = performance(process, gains, tau_f), 0.01
    iae, tv = simulated(process, gains, tau_f, 0.0, dt)
    assert found.iae_setpoint == pytest.approx(iae, rel=0.02)
    assert found.tv_setpoint == pytest.approx(tv, rel=0.03)
    iae, tv = simulated(process, gains, tau_f, 1.0, dt)
    assert found.iae_load == pytest.approx(iae, rel=0.01)
    assert found.tv_load == pytest.approx(tv, rel=0.02)


def test_the_simulation_comes_to_our_number_as_its_step_shrinks() -> None:
    process, gains, tau_f = SIMULATED[1]
    found = performance(process, gains, tau_f).iae_setpoint
    coarse, fine = (simulated(process, gains, tau_f, 0.0, dt)[0] for dt in (0.02, 0.01))
    assert 2 * fine - coarse == pytest.approx(found, rel=2e-4)  # the held controller errs by dt/2: extrapolated


@settings(max_examples=examples(30))
@given(a=st.floats(1e-3, 1e3), g=st.floats(1e-2, 1e2), sign=st.sampled_from([1, -1]))
def test_units_and_direction(a: float, g: float, sign: int) -> None:
    base = performance(LinearProcess(1.0, (5.0, 1.0), (-0.3,), 1.0), PidGains(1.5, 0.3, 0.8), 0.2)
    process = LinearProcess(sign * g, (5.0 * a, a), (-0.3 * a,), a)
    found = performance(process, PidGains(sign * 1.5 / g, sign * 0.3 / g / a, sign * 0.8 / g * a), 0.2 * a)
    assert found.iae_setpoint == pytest.approx(base.iae_setpoint * a, rel=1e-6)
    assert found.iae_load == pytest.approx(base.iae_load * a * g, rel=1e-6)
    assert found.tv_setpoint == pytest.approx(base.tv_setpoint / g, rel=1e-6)
    assert found.tv_load == pytest.approx(base.tv_load, rel=1e-6)


@pytest.mark.parametrize("ratio", [1.0, 1e-1, 1e-2, 1e-3, 1e-5, 1e-7])
def test_a_vanishing_dead_time_is_the_loop_without_one(ratio: float) -> None:
    gains = PidGains(3.0, 0.6)
    found = performance(LinearProcess(1.0, (10.0,), (), ratio), gains)
    without = performance(LinearProcess(1.0, (10.0,)), gains)
    assert found.iae_setpoint == pytest.approx(without.iae_setpoint, rel=0.3 * ratio + 1e-6)


@pytest.mark.parametrize("tau", [1e-1, 1e-2, 1e-4, 1e-6])
def test_a_vanishing_lag_is_the_pure_delay(tau: float) -> None:
    found = performance(LinearProcess(1.0, (tau,), (), 1.0), PidGains(0.0, 0.5))
    assert found.iae_load == pytest.approx(2.1686912, rel=2 * tau + 1e-6)


def test_what_never_settles_costs_without_end() -> None:
    assert performance(LinearProcess(1.0, (5.0,), (), 1.0), PidGains(2.0, 0.0)).iae_setpoint == math.inf
    assert performance(LinearProcess(1.0, (), (), 1.0, 1), PidGains(0.5, 0.0)).iae_load == math.inf
    unstable = performance(LinearProcess(1.0, (), (), 1.0, 1), PidGains(2.0, 0.1))
    assert unstable == Performance(math.inf, math.inf, math.inf, math.inf)
    assert unstable.to_dict() == {"iae_setpoint": None, "iae_load": None, "tv_setpoint": None, "tv_load": None}


def test_the_setpoints_derivative_is_an_impulse_in_the_output() -> None:
    process, gains = LinearProcess(1.0, (5.0, 1.0), (), 1.0), PidGains(2.0, 0.3, 1.5)
    with_kick, without = performance(process, gains), performance(process, gains, derivative_on_setpoint=False)
    assert with_kick.tv_setpoint == math.inf
    assert math.isfinite(without.tv_setpoint)
    assert with_kick.iae_setpoint < without.iae_setpoint
    filtered = performance(process, gains, 1e-4)  # the impulse is the limit of a fast filter
    assert filtered.iae_setpoint == pytest.approx(with_kick.iae_setpoint, rel=1e-3)


def test_impossible_processes_are_refused() -> None:
    with pytest.raises(ValueError, match="more zeros than poles"):
        performance(LinearProcess(0.1, (1.0,), (0.5, 0.2)), PidGains(0.0, 0.5))
    with pytest.raises(ValueError, match="filter"):
        performance(LinearProcess(0.1), PidGains(0.1, 0.5, 0.1))
    with pytest.raises(ValueError, match="positive"):
        weighted_cost(Performance(1.0, 1.0, 1.0, 1.0), 0.0, 1.0)
    with pytest.raises(ValueError, match="until_s"):
        step_response(LinearProcess(1.0, (1.0,)), PidGains(1.0, 0.0), -1.0)
