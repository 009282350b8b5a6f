"""A process that runs away by itself is told from one that does not, by the gains that hold it."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from retuner import PidGains, RetunerSettings
from retuner.adaptive.diagnosis.unstable_process import UnstableProcess, unstable_process, worse_on
from retuner.adaptive.loop.sampled import SampledLaw
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import FloatArray, LoopMode, LoopSample, Window
from retuner.adaptive.supervision.confirmation import runaway
from retuner.schedule.late_dataclass import replace

DT, THETA, TAU, N, STEP_AT = 0.5, 2.0, 1.0, 400, 10
LAW = SampledLaw(PidGains(0.35, 0.005), DT)
LIMIT = 1.8


def record(pole: float, law: SampledLaw = LAW, noise: float = 0.002, load: float = 0.0, further: float = 0.0) -> Window:
    """1 e^(-2 s) / ((s + pole)(1 + s)) under a PI controller, integrated between samples. load : from sample 200.
    further : by which share the pole is faster for each setpoint step that pv is away.
    """
    rng, pv, co = np.random.default_rng(1), np.zeros(N), np.zeros(N)
    sp = np.where(np.arange(N) >= STEP_AT, 1.0, 0.0)
    state: FloatArray = np.zeros(2)
    integral, late = 0.0, round(THETA / DT)
    for i in range(N):
        pv[i] = state[1] + noise * rng.standard_normal()
        co[i] = law.gains.kp * (sp[i] - pv[i]) + integral
        integral += law.gains.ki * DT * (sp[i] - pv[i])
        u = (co[i - late] if i >= late else 0.0) + (load if i >= N // 2 else 0.0)

        def moves(_: float, x: FloatArray, u: float = u) -> list[float]:
            return [(u - x[0]) / TAU, x[0] - pole * (1.0 + further * x[1]) * x[1]]

        state = solve_ivp(moves, (0.0, DT), state, rtol=1e-8, atol=1e-10).y[:, -1]
    return Window(DT * np.arange(N, dtype=np.float64), sp, pv, co)


def test_the_gains_that_held_it_show_its_pole() -> None:
    found = unstable_process(record(-0.08), LAW)
    assert found.pole_per_s == pytest.approx(-0.08, rel=0.05)
    assert found.k == pytest.approx(1.0, rel=0.05)
    assert found.theta_s + found.tau_s == pytest.approx(THETA + TAU + DT / 2, rel=0.1)
    assert found.grows_s == pytest.approx(12.5, rel=0.05)


@pytest.mark.parametrize("pole", [0.0, 0.03, 0.3])
def test_an_integrator_and_a_lag_do_not_run_away(pole: float) -> None:
    assert unstable_process(record(pole), LAW) is None


def test_a_load_that_came_later_is_cut_off() -> None:
    found = unstable_process(record(-0.08, load=0.1), LAW)
    assert found.pole_per_s == pytest.approx(-0.08, rel=0.1)


@pytest.mark.parametrize(("w0", "zeta"), [(0.1, 0.2), (0.3, 0.1)])
def test_one_that_rings_only_begins_like_it(w0: float, zeta: float) -> None:
    """What explains the beginning would not have been held to the end."""
    law, fine = SampledLaw(PidGains(0.05, 0.02), DT), 20
    rng, sp, integral = np.random.default_rng(1), np.where(np.arange(N) >= STEP_AT, 1.0, 0.0), 0.0
    (pv, co), x = np.zeros((2, N)), np.zeros(2)
    for i in range(N):
        pv[i] = x[0] + 0.002 * rng.standard_normal()
        co[i] = law.gains.kp * (sp[i] - pv[i]) + integral
        integral += law.gains.ki * DT * (sp[i] - pv[i])
        for _ in range(fine):
            x = x + DT / fine * np.array([x[1], w0 * w0 * (co[i - 2] - x[0]) - 2.0 * zeta * w0 * x[1]])
    assert unstable_process(Window(DT * np.arange(N, dtype=np.float64), sp, pv, co), law) is None


def test_the_beginning_shows_one_that_runs_away_faster_further_up() -> None:
    found = unstable_process(record(-0.06, further=0.2), LAW)
    assert -0.09 < found.pole_per_s < -0.06


def test_a_record_without_one_step_says_nothing() -> None:
    window = record(-0.08)
    assert unstable_process(window.part(slice(STEP_AT, None)), LAW) is None  # no step
    assert unstable_process(window.part(slice(0, STEP_AT + 10)), LAW) is None  # too short
    twice = np.where(np.arange(N) >= N // 2, 2.0, window.sp)
    assert unstable_process(Window(window.t_s, twice, window.pv, window.co), LAW) is None


def test_less_gain_lets_it_go_and_more_may_hold_it_better() -> None:
    found = UnstableProcess(1.0, -0.08, TAU, THETA + DT / 2)
    less = worse_on(found, LAW, PidGains(0.05, 0.001), N, LIMIT)
    assert math.isinf(less[1])
    assert worse_on(found, LAW, PidGains(0.2, 0.002), N, LIMIT) is None  # Ms falls
    barely = PidGains(0.1, 0.0005)
    assert found.is_held(replace(LAW, gains=barely), N)
    assert worse_on(found, LAW, barely, N, LIMIT)[1] > 10.0  # a pole that is a little faster is not held
    more = worse_on(found, LAW, PidGains(0.45, 0.01), N, LIMIT)
    assert more[0] < more[1]


def asked(window: Window, gains: PidGains, *, setpoint: bool = True, limited: bool = False) -> Any:
    """The stage on a record, with a proved change to these gains."""
    rows = zip(*(part.tolist() for part in (window.t_s, window.sp, window.pv, window.co)), strict=True)
    samples = [LoopSample(t, sp, pv, co, int(LoopMode.AUTO), int(limited)) for t, sp, pv, co in rows]
    start_s = STEP_AT * DT if setpoint else N * DT / 2
    response = Response(start_s, samples[-1].t_s, (Peak(start_s + 5, 1.0),), Ending.QUIET, setpoint, 0.01)
    table = SimpleNamespace(with_gains=lambda *_: SimpleNamespace(at=lambda *_: gains))
    record = SimpleNamespace(
        response=response, samples=samples, pattern=response, entered_s=-math.inf, in_force=LAW.gains, table=table,
        region=0, at=(0.0, 0.0),
    )  # fmt: skip
    verdict: Any = SimpleNamespace(gains=gains)
    found: Any = SimpleNamespace(record=record, settings=RetunerSettings(DT, 100.0), steps=None)
    return runaway(found, verdict)


LESS = PidGains(0.05, 0.001)


@pytest.mark.parametrize("setpoint", [True, False])
def test_a_change_that_would_let_it_go_is_not_made_and_says_so(setpoint: bool) -> None:
    doubt = asked(record(-0.08, load=0.0 if setpoint else 0.1), LESS, setpoint=setpoint)
    assert "runs away by itself" in doubt.reason
    assert "would not hold it" in doubt.reason


def test_the_step_that_cuts_a_response_short_is_not_the_one_that_is_asked() -> None:
    window = record(-0.08)
    window.sp[-1] = 2.0
    doubt = asked(window, LESS)
    assert "would not hold it" in doubt.reason


def test_other_changes_are_none_of_its_business() -> None:
    assert asked(record(-0.08), PidGains(0.2, 0.002)) is None
    assert asked(record(0.0), LESS) is None
    assert asked(record(-0.08), LESS, limited=True) is None


@pytest.mark.parametrize("seed", range(6))
def test_what_no_process_explains_is_none_that_runs_away(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sp = np.where(np.arange(120) >= STEP_AT, 1.0, 0.0)
    wander = np.cumsum(rng.standard_normal(120)) if seed % 2 else 5.0 * rng.standard_normal(120)
    law = SampledLaw(PidGains(0.1 * 10.0 ** rng.uniform(-3, 3), 0.01), DT)
    assert unstable_process(Window(DT * np.arange(120, dtype=np.float64), sp, wander, wander), law) is None
