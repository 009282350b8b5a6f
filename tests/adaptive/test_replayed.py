"""A record replayed with other settings is the run that would have been, whatever loads it held."""

import math

import numpy as np
import pytest

from retuner import LinearProcess, PidGains, ProcessModel, ProcessType
from retuner.adaptive.loop.replayed import before_after, even, replayed
from retuner.adaptive.loop.simulate import HeldInput, step_response
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.pid import law, start, step

DT = 2.0
LAGS = LinearProcess(2.0, (60.0, 10.0), theta_s=13.0)
TANK = LinearProcess(-0.02, (8.0,), theta_s=5.0, integrators=1)
SWINGS = ProcessModel(ProcessType.SOPDT, 1.5, 20.0, 20.0, 4.0, zeta=0.5).linear()
OLD, NEW = PidGains(1.2, 0.03), PidGains(1.0, 0.012, 4.0)


def run(process: LinearProcess, gains: PidGains, load: FloatArray, upset: FloatArray, tau_f_s: float = 0.4) -> Window:
    """A loop with a load at the process input and another one, with noise, on pv; co between 0 and 100."""
    plant, pid = HeldInput(process, DT), law(gains, tau_f_s=tau_f_s)
    sp = np.where(np.arange(len(load)) < 200, 50.0, 55.0)
    pv, co = np.zeros(len(load)), np.zeros(len(load))
    state: tuple[float, float, float, float, int] = start(pid, 50.0, 50.0 + float(upset[0]), 50.0)
    moved = 0.0
    for i in range(len(load)):
        pv[i] = 50.0 + moved + upset[i]
        state, co[i] = step(pid, state, sp[i], pv[i], DT)
        moved = plant.step(float(co[i]) - 50.0 + float(load[i]))
    return Window(DT * np.arange(len(load)), sp, pv, co)


def loads(n: int = 900) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(3)
    load = np.where(np.arange(n) > 500, 8.0, 0.0) + np.cumsum(rng.normal(0.0, 0.3, n))
    return load, rng.normal(0.0, 0.1, n)


@pytest.mark.parametrize("process", [LAGS, SWINGS])
def test_a_replay_is_the_run_that_would_have_been(process: LinearProcess) -> None:
    load, upset = loads()
    recorded, expected = run(process, OLD, load, upset), run(process, NEW, load, upset)
    found = replayed(recorded, process, NEW, (0.0, 100.0))
    np.testing.assert_allclose(found.pv, expected.pv, atol=1e-8)
    np.testing.assert_allclose(found.co, expected.co, atol=1e-8)
    assert found.travel == pytest.approx(float(np.sum(np.abs(np.diff(expected.co)))))


def test_a_record_that_begins_with_a_setpoint_step_is_not_taken_over_at_the_kick_of_its_controller() -> None:
    load, upset = np.zeros(900), np.zeros(900)
    recorded, expected = run(LAGS, OLD, load, upset), run(LAGS, NEW, load, upset)
    cut = recorded.part(slice(200, None))
    np.testing.assert_allclose(replayed(cut, LAGS, NEW, (0.0, 100.0), OLD).pv, expected.pv[200:], atol=1e-6)


def test_the_level_of_a_tank_is_replayed_too() -> None:
    load, upset = loads()
    old, new = PidGains(-2.0, -0.004), PidGains(-4.0, -0.02)
    recorded, expected = run(TANK, old, load / 4, upset, 0.0), run(TANK, new, load / 4, upset, 0.0)
    np.testing.assert_allclose(replayed(recorded, TANK, new, (0.0, 100.0)).pv, expected.pv, atol=1e-6)


def test_the_settings_of_the_record_give_the_record_back() -> None:
    load, upset = loads()
    recorded = run(LAGS, OLD, load, upset)
    wrong = LinearProcess(3.0, (40.0,), theta_s=20.0)  # whatever the model: v holds what it missed
    found = replayed(recorded, wrong, OLD, (0.0, 100.0))
    np.testing.assert_allclose(found.pv, recorded.pv, atol=1e-8)


def test_limits_of_co_hold_in_a_replay() -> None:
    load, upset = loads()
    found = replayed(run(LAGS, OLD, load, upset), LAGS, PidGains(3.0, 0.05), (40.0, 52.0))
    assert float(np.min(found.co)) == 40.0
    assert float(np.max(found.co)) == 52.0


def test_a_replay_that_runs_away_says_so_and_ends() -> None:
    load, upset = loads()
    found = replayed(run(LAGS, OLD, load, upset), LAGS, PidGains(60.0, 3.0))
    assert found.error == found.travel == math.inf
    assert np.isnan(found.pv[-1])


def test_before_and_after_are_told_over_all_models() -> None:
    load, upset = loads()
    recorded = run(LAGS, PidGains(0.3, 0.002), load, upset)
    models = [LAGS, *(LinearProcess(k, (60.0, 10.0), theta_s=13.0) for k in np.linspace(1.6, 2.4, 30))]
    found = before_after(recorded, models, OLD, (0.0, 100.0))
    each = [one.error for one in found.replays]
    assert min(each) <= found.best.error <= max(each)
    assert found.best.error == pytest.approx(float(np.mean(np.abs(found.best.sp - found.best.pv))))
    assert found.best.error < 0.6 * float(np.mean(np.abs(recorded.sp - recorded.pv)))
    low, high = found.band("pv")
    assert np.all(low <= found.best.pv + 1e-12)
    assert np.all(found.best.pv <= high + 1e-12)
    assert 3 <= len(found.replays) <= 12


def test_a_record_with_uneven_times_comes_on_an_even_grid() -> None:
    load, upset = loads()
    whole = run(LAGS, OLD, load, upset)
    keep = np.ones(900, dtype=bool)
    keep[[5, 6, 300, 700]] = False
    thinned = Window(whole.t_s[keep], whole.sp[keep], whole.pv[keep], whole.co[keep])
    found = even(thinned)
    np.testing.assert_allclose(found.t_s, whole.t_s)
    np.testing.assert_allclose(found.sp, whole.sp)
    assert float(np.max(np.abs(found.pv - whole.pv))) < 1.0
    assert len(even(whole, most=100).t_s) == 100
    assert even(whole, most=100).t_s[-1] == whole.t_s[-1]


@pytest.mark.parametrize("process", [LAGS, SWINGS, TANK])
def test_a_held_step_answers_as_the_exact_one(process: LinearProcess) -> None:
    plant = HeldInput(process, DT)
    found = [0.0, *(plant.step(1.0) for _ in range(99))]
    exact = step_response(process, PidGains(1e-9 * math.copysign(1, process.k), 0.0), 198.0, load=True)
    np.testing.assert_allclose(found, np.interp(DT * np.arange(100), exact.t, exact.pv, left=0.0), atol=2e-2)


def test_a_step_of_no_time_is_refused() -> None:
    with pytest.raises(ValueError, match="dt_s = 0"):
        HeldInput(LAGS, 0.0)
