"""Stuck valves: what both models promise, and agreement with the cases of their papers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.diagnosis.rival_fits import Family, StuckValve

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
def test_the_valve_never_strays_from_its_signal_by_more_than_its_friction(
    family: Family, stick: float, share: float, seed: int
) -> None:
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
