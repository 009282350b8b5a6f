"""Stuck valves: what both models promise, and agreement with the cases of their papers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.rival_fits import linear
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.valve_fit import sticking, with_play
from retuner.adaptive.valve.valve_model import Family, StuckValve

TRIANGLE = np.interp(np.arange(400) % 80, [0, 40, 80], [0.0, 10.0, 0.0])


@pytest.mark.parametrize("family", list(Family))
def test_after_a_reversal_it_rests_for_the_stick_band_then_jumps(family: Family) -> None:
    position = StuckValve(family, 4.0, 2.0).position(TRIANGLE)
    up = slice(81, 120)  # the second rise: co goes from 0 to 10 in steps of 0.25
    moves = np.flatnonzero(np.diff(position[up]))
    travelled = TRIANGLE[up][moves[0] + 1]
    room = 0.0 if family == Family.KANO else 2.0  # He: part of the push of the last jump is still in the valve
    assert 4.0 <= travelled <= 4.0 + room + 0.5
    assert np.diff(position[up])[moves[0]] == pytest.approx(2.0, abs=0.3)


def test_kano_follows_and_he_goes_in_jumps() -> None:
    ramp = np.linspace(0, 20, 801)
    kano = np.diff(StuckValve(Family.KANO, 4.0, 2.0).position(ramp))
    he = np.diff(StuckValve(Family.HE, 4.0, 2.0).position(ramp))
    assert np.count_nonzero(kano) > 600
    assert np.count_nonzero(he) < 12
    assert np.all(he[he != 0] == pytest.approx(2.0, abs=0.1))


@given(family=st.sampled_from(list(Family)), stick=st.floats(0.1, 5), share=st.floats(0, 1), seed=st.integers(0, 500))
def test_the_valve_never_strays_from_its_signal_by_more_than_its_friction(family, stick, share, seed):
    co = np.cumsum(np.random.default_rng(seed).standard_normal(300))
    valve = StuckValve(family, stick, share * stick)
    assert np.max(np.abs(valve.position(co) - co)) <= (stick + valve.jump) / 2 + 1e-9


def test_the_start_is_where_it_is_said_to_be() -> None:
    still = np.zeros(5)
    assert StuckValve(Family.KANO, 4.0, 2.0, start=0.5).position(still)[-1] == pytest.approx(1.5)
    assert StuckValve(Family.HE, 4.0, 2.0, start=-0.5).position(still)[-1] == pytest.approx(-1.5)


@pytest.mark.parametrize(
    ("stick", "jump", "start"), [(0.0, 0.0, 0.0), (1.0, 3.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 2.0), (np.nan, 0, 0)]
)
def test_impossible_valves_are_refused(stick: float, jump: float, start: float) -> None:
    with pytest.raises(ValueError, match=r"stiction band|start"):
        StuckValve(Family.KANO, stick, jump, start)


CHOICE = DiagnosisSettings().fit.choice


def recorded(valve: StuckValve | None, noise: float) -> Window:
    """A process of one lag in manual, moved to and fro by hand; a valve stands before it."""
    t = np.arange(600.0)
    co = np.repeat(np.random.default_rng(4).uniform(-1, 1, 30), 20) + np.interp(t % 100, [0, 50, 100], [0.0, 1.0, 0.0])
    moved = co if valve is None else valve.position(co)
    pv = np.zeros(600)
    for i in range(1, 600):
        pv[i] = pv[i - 1] + (moved[max(i - 3, 0)] - pv[i - 1]) / 15
    return Window(t, np.zeros(600), pv + noise * np.random.default_rng(5).standard_normal(600), co)


def test_play_is_measured_and_none_is_found_where_there_is_none() -> None:
    for valve in (StuckValve(Family.KANO, 0.25, 0.0), None):
        window = recorded(valve, 0.01)
        best = linear(window, (1,), CHOICE, 600)[0]
        played = with_play(best, CHOICE.most_loads)
        if valve is None:
            assert played.fit.criterion > best.criterion
        else:
            assert played.fit.criterion < best.criterion - 20
            assert played.valve.stick == pytest.approx(0.25, rel=0.1)


@pytest.mark.parametrize("valve", [StuckValve(Family.KANO, 0.6, 0.2, 0.3), StuckValve(Family.HE, 0.5, 0.3, -0.4)])
def test_a_valve_is_found_wherever_it_stood_first(valve: StuckValve) -> None:
    best = linear(recorded(valve, 0.005), (1,), CHOICE, 600)[0]
    found = sticking(best, 100.0, CHOICE.most_loads)
    noise = best.fit.misfit.record.noise_std
    assert best.colour.std > 5 * noise
    assert found.fit.colour.std < 1.3 * noise
    assert found.valve.stick == pytest.approx(valve.stick, rel=0.1)
