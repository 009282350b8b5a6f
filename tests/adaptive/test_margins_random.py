"""Margins and stability of random loops against python-control, polynomial roots and a dense winding count."""

import math

import control
import numpy as np
import pytest
from effort import sized

from retuner.adaptive.loop.margins import Margins, margins, sensitivity_peak
from retuner.adaptive.loop.open_loop import OpenLoop, gain_crossovers, grid, open_loop
from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains

SEED = 20240607
RATIONAL, DELAYED = sized((170, 34), (850, 170))
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


def winding_says_stable(loop: OpenLoop) -> bool:
    """arg(1 + L) counted on a grid so dense that it never turns by more than a little between two points."""
    crossed = gain_crossovers(loop, grid(loop))
    last = 3 * max(crossed, default=max(loop.corners()))
    w = np.unique(
        np.concatenate([np.geomspace(1e-4 * min(loop.corners()), last, 20_000), np.linspace(1e-6, last, 20_000)])
    )
    f = 1 + loop.along(w)
    turned = float(np.sum(np.angle(f[1:] / f[:-1]))) - float(np.angle(f[-1]))
    start = 0.0 if loop.order > 0 else float(np.angle(f[0]))
    return abs(turned + start - max(loop.order, 0) * math.pi / 2) < 1.0


def test_stability_with_dead_time_agrees_with_a_dense_winding_count() -> None:
    rng, stable = np.random.default_rng(SEED + 2), 0
    for _ in range(150):
        process, gains, tau_f = random_loop(rng, delayed=True)
        loop, found = open_loop(process, gains, tau_f), margins(process, gains, tau_f)
        assert found.stable is winding_says_stable(loop), (process, gains, tau_f)
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


def test_a_conditionally_stable_loop() -> None:
    """Two integrators under PID: the gain may neither rise nor fall too far; gm is the rise."""
    process, gains = LinearProcess(1.0, (0.1,), (), 0.1, 2), PidGains(0.5, 0.05, 1.0)
    found = margins(process, gains)
    assert found.stable
    assert found.gm > 1
    factor = found.gm
    assert margins(process, PidGains(0.5 * factor * 0.999, 0.05 * factor * 0.999, factor * 0.999)).stable
    assert not margins(process, PidGains(0.5 * factor * 1.001, 0.05 * factor * 1.001, factor * 1.001)).stable


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
