"""Margins against closed forms and the published table of Skogestad (2003)."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.loop.margins import _peak, margins, sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
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


PUBLISHED = [  # Skogestad (2003) examples at tau_c = theta on the full process: Ms, Mt, GM, PM
    ("E1 PI", LinearProcess(1, (1, 0.2)), series(5.5, 0.8), (1.56, 1.28, math.inf, 46.5)),
    (
        "E2 PI",
        LinearProcess(1, (2, 1, 0.4, 0.2, 0.05, 0.05, 0.05), (-0.3, 0.08)),
        series(0.8503, 2.5),
        (1.66, 1.04, 3.37, 57.8),
    ),
    (
        "E2 PID",
        LinearProcess(1, (2, 1, 0.4, 0.2, 0.05, 0.05, 0.05), (-0.3, 0.08)),
        series(1.299, 2, 1.2),
        (1.72, 1.04, 2.90, 58.0),
    ),
    ("E3 PI", LinearProcess(2, (20, 1, 0.1, 0.1), (15,)), series(2.333, 1.05), (1.55, 1.08, 5.75, 55.3)),
    ("E3 PID", LinearProcess(2, (20, 1, 0.1, 0.1), (15,)), series(6.667, 0.4, 0.15), (1.50, 1.22, math.inf, 49.2)),
    ("E4 PI", LinearProcess(1, (1, 1, 1, 1)), series(0.3, 1.5), (1.46, 1.00, 4.94, 62.4)),
    ("E6 PI", LinearProcess(1, (1, 1, 0.028), (0.17, 0.17), 0, 1), series(1 / 3.38, 13.52), (1.47, 1.29, 16.61, 48.8)),
    (
        "E6 PID",
        LinearProcess(1, (1, 1, 0.028), (0.17, 0.17), 0, 1),
        series(1.397, 2.864, 1.33),
        (1.23, 1.30, math.inf, 52.4),
    ),
    ("integrating", LinearProcess(1, (), (), 1, 1), series(0.5, 8), (1.70, 1.30, 2.96, 46.9)),
]


@pytest.mark.parametrize(
    ("process", "gains", "expected"), [row[1:] for row in PUBLISHED], ids=[r[0] for r in PUBLISHED]
)
def test_published_margins(process: LinearProcess, gains: PidGains, expected: tuple[float, ...]) -> None:
    found = margins(process, gains)
    assert found.stable
    for value, printed, digits in zip(
        (found.ms, found.mt, found.gm, found.pm_deg), expected, (0.005, 0.005, 0.005, 0.05), strict=True
    ):
        assert value == pytest.approx(printed, abs=digits * 1.01)


@pytest.mark.parametrize(("gain", "stable"), [(math.pi / 2 * 0.999, True), (math.pi / 2 * 1.001, False)])
def test_stability_limit_of_an_integrator_with_delay(gain: float, stable: bool) -> None:
    assert margins(LinearProcess(1, (), (), 1.0, 1), PidGains(gain, 0.0)).stable is stable


def ultimate_gain(tau: float) -> float:
    """P control of e^-s/(tau s + 1): tau w = tan(pi - w)."""
    low, high = math.pi / 2, math.pi
    for _ in range(80):
        w = (low + high) / 2
        low, high = (w, high) if tau * w < math.tan(math.pi - w) else (low, w)
    return math.hypot(1.0, tau * low)


@given(tau=st.floats(0.05, 500), above=st.floats(0.005, 0.5), sign=st.sampled_from([1, -1]))
def test_stability_limit_of_first_order_with_delay(tau: float, above: float, sign: int) -> None:
    process = LinearProcess(sign * 1.0, (tau,), (), 1.0)
    ku = ultimate_gain(tau)
    assert margins(process, PidGains(sign * ku * (1 - above), 0.0)).stable
    assert not margins(process, PidGains(sign * ku * (1 + above), 0.0)).stable


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


def test_ms_is_the_largest_sensitivity_on_a_dense_grid() -> None:
    process, gains = LinearProcess(1.0, (10.0, 2.0), (), 3.0), PidGains(1.2, 0.1, 2.0)
    w = np.geomspace(1e-4, 1e2, 400_001)
    s = 1j * w
    loop = (gains.kp + gains.ki / s + gains.kd * s) * process.response(w)
    assert sensitivity_peak(process, gains) == pytest.approx(float(np.max(1 / np.abs(1 + loop))), rel=1e-6)


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
