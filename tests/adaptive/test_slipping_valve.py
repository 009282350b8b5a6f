"""A valve whose band differs at every stop: its law, and that the record's slips are found."""

import numpy as np
import pytest

from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.rival_fits import linear
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.slips import Co, Slips, slipping
from retuner.adaptive.valve.valve_model import Family, StuckValve
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import law, start, step

PROCESS = LinearProcess(1.0, (10.0, 2.0), (), 2.0)
GAINS = PidGains(1.6, 1.6 / 11.0)
DT, N = 0.5, 700
SETTINGS = DiagnosisSettings()


def test_a_slip_goes_most_of_the_way_to_co_and_follows_it_until_it_stops() -> None:
    u = np.array([0.0, 1, 2, 3, 4, 5, 5, 4, 3, 2, 1, 0])
    position = Co(u).position(Slips((3,), 0.25, 0.0))
    assert position[:3] == pytest.approx(0)
    assert position[3:6] == pytest.approx(u[3:6] - 0.25 * 3)
    assert position[6:] == pytest.approx(5 - 0.75)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0 / 3])
def test_kanos_valve_is_one_of_its_kind(share: float) -> None:
    u = np.interp(np.arange(240) % 80, [0, 40, 80], [0.0, 10.0, 0.0])
    valve = StuckValve(Family.KANO, 4.0, 4.0 * (1 - share) / (1 + share))
    kano = valve.position(u)
    loose = np.flatnonzero((np.diff(kano) != 0) & (np.diff(kano, prepend=kano[0])[:-1] == 0)) + 1
    slips = Slips(tuple(loose.tolist()), share, float(kano[0]))
    assert Co(u).position(slips) == pytest.approx(kano, abs=0.25)  # a sample of co
    assert Co(u).bands(slips) == pytest.approx((valve.stick + valve.jump) / 2, abs=0.5)


def irregular_record(seed: int) -> Window:
    """PI on two lags; the valve between sticks over another band at every stop."""
    rng = np.random.default_rng(seed)
    plant = LinearPlant(PROCESS, start_co=0.0, noise=0.01, seed=seed, co_min=-1e9, co_max=1e9)
    rules = law(GAINS, co_min=-50.0, co_max=50.0)
    state = start(rules, 0.0, 0.0, 0.0)
    co, before, y, band, far, rows = 0.0, 0.0, 0.0, 1.0, 0.0, []
    for i in range(N + 100):
        if far and (co - before) * far <= 0:  # stops where co turns
            far, band = 0.0, float(np.exp(0.4 * rng.standard_normal()))
        elif not far and abs(co - y) > band:
            far = 0.3 * (co - y)
        y = co - far if far else y
        pv = plant.step(y, 2.0 if i >= 20 else 0.0, DT)
        before = co
        state, co = step(rules, state, 0.0, pv, DT)
        rows.append((i * DT, 0.0, pv, co))
    return Window(*np.array(rows[100:]).T)


@pytest.mark.slow
def test_the_slips_of_an_irregular_valve_are_found() -> None:
    window = irregular_record(7)
    best = linear(window, (1,), SETTINGS.fit.choice, SETTINGS.fit.most_samples)[0]
    found = slipping(best, 2)
    noise = best.fit.misfit.record.noise_std
    assert found.fit.colour.std < 2 * noise
    assert found.fit.colour.std < 0.5 * best.colour.std
    assert 0.1 < found.slips.share < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 7])
def test_an_irregular_valve_is_called_stiction(seed: int) -> None:
    told = diagnose_window(irregular_record(seed), GAINS).diagnosis
    assert told.cause == Cause.STICTION
    assert not told.retune


def test_a_random_walk_of_a_load_is_no_valve() -> None:
    plant = LinearPlant(PROCESS, start_co=0.0, noise=0.01, seed=3, co_min=-1e9, co_max=1e9)
    rules = law(GAINS, co_min=-50.0, co_max=50.0)
    state = start(rules, 0.0, 0.0, 0.0)
    walk = np.cumsum(0.1 * np.random.default_rng(3).standard_normal(N))
    co, rows = 0.0, []
    for i in range(N):
        pv = plant.step(co, float(walk[i]), DT)
        state, co = step(rules, state, 0.0, pv, DT)
        rows.append((i * DT, 0.0, pv, co))
    best = linear(Window(*np.array(rows).T), (1,), SETTINGS.fit.choice, SETTINGS.fit.most_samples)[0]
    found = slipping(best, 2)
    assert found is None or found.criterion > best.criterion


def test_one_band_needs_turns_that_confirm_it() -> None:
    """A slow triangle of a load for a round and a half is a load that ramps as well as a valve: no stiction."""
    fast = LinearProcess(1.0, (1.0,), (), 0.3)
    gains = PidGains(1.0, 1.0)
    plant = LinearPlant(fast, start_co=0.0, noise=0.004, seed=1, co_min=-1e9, co_max=1e9)
    rules = law(gains, co_min=-50.0, co_max=50.0)
    state = start(rules, 0.0, 0.0, 0.0)
    load = np.interp(np.arange(N), [0, 230, 460, N], [0.0, 12.0, 0.0, 12.0])
    co, rows = 0.0, []
    for i in range(N):
        pv = plant.step(co, float(load[i]), DT)
        state, co = step(rules, state, 0.0, pv, DT)
        rows.append((i * DT, 0.0, pv, co))
    told = diagnose_window(Window(*np.array(rows).T), gains)
    assert told.diagnosis.cause != Cause.STICTION
    assert "valve_turns" in told.diagnosis.evidence
