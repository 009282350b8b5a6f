"""IAE and TV against closed forms, against a plain simulation, and under changes of units."""

import math

import numpy as np
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid
from scipy.linalg import expm

from retuner.adaptive.loop.performance import Performance, performance, weighted_cost
from retuner.adaptive.loop.simulate import step_response
from retuner.adaptive.process.model import LinearProcess, state_space
from retuner.schedule.gains import PidGains


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
