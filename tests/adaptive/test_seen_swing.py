"""What a response shows of the swing that a model says the loop has."""

import numpy as np
import pytest

from retuner import PidGains, ProcessModel, ProcessType
from retuner.adaptive.diagnosis.oscillation_online import SwingSettings
from retuner.adaptive.diagnosis.swing_checks import foretold, not_seen
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.trial.response_numbers import peaks_of

MODEL = ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0)
GOOD = simc(MODEL).gains
SWINGS = PidGains(2.6 * GOOD.kp, 2.6 * GOOD.ki)  # the third peak is more than half of the first
BAND = 0.1
SWING = SwingSettings()


def said(gains: PidGains, *errors: float, ending: Ending = Ending.QUIET, setpoint: bool = True) -> str:
    peaks = tuple(Peak(10.0 * i, e) for i, e in enumerate(errors))
    response = Response(0.0, 100.0, peaks, ending, setpoint, BAND)
    return not_seen(response, foretold(response, ClosedLoop(MODEL.linear(), gains)), SWING)


def test_a_loop_that_came_to_rest_refutes_a_swing() -> None:
    assert "came to rest after 1" in said(SWINGS, 1.0)
    assert "came to rest after 2" in said(SWINGS, 1.0, -0.2)
    assert said(GOOD, 1.0) == ""


def test_a_swing_that_rides_on_a_slow_return_need_not_cross_over() -> None:
    assert said(SWINGS, 1.0, setpoint=False) == ""  # by the model: -1, 0.02, -0.6 of the first peak
    assert said(GOOD, 1.0, setpoint=False) == ""


@pytest.mark.parametrize(("third", "refuted"), [(0.6, False), (0.02, True)])
def test_a_half_wave_the_wrong_way_that_nobody_sees_is_no_first_peak(third: float, *, refuted: bool) -> None:
    inverse = ProcessModel(ProcessType.SOPDT_INVERSE, 1.0, 10.0, 3.0, 2.0, inverse_s=1.0)
    loop = ClosedLoop(inverse.linear(), PidGains(2.2, 0.4))
    peaks = Peak(9.0, -1.0), Peak(25.0, 0.75), Peak(41.0, -third)
    response = Response(0.0, 100.0, peaks, Ending.COMPLETE, sp_changed=False, band=BAND)
    trace = foretold(response, loop)
    first, second, *_ = peaks_of(trace.e)
    assert abs(first) < BAND * abs(second)
    assert bool(not_seen(response, trace, SWING)) is refuted


def test_a_peak_of_which_half_would_be_lost_in_the_noise_may_be_missed() -> None:
    said_third = 3.0 * BAND / 0.6  # by the model more than 0.6 of the first peak
    assert said(SWINGS, said_third, -0.9 * said_third) == ""
    assert "came to rest" in said(SWINGS, 3 * said_third, -0.9 * said_third)


def test_a_swing_that_may_still_come_or_is_too_small_to_be_seen_is_not_refuted() -> None:
    assert said(SWINGS, 1.0, ending=Ending.SETPOINT) == ""
    assert said(SWINGS, 2 * BAND) == ""
    assert said(SWINGS) == ""


@pytest.mark.parametrize(
    ("end_s", "setpoint", "refuted"), [(80.0, True, False), (400.0, True, True), (80.0, False, True)]
)
def test_a_slow_swing_may_pass_its_band_for_longer_than_rest_takes(end_s: float, setpoint: bool, refuted: bool) -> None:
    slow = PidGains(0.3 * GOOD.kp, 1.2 * GOOD.ki)  # its third peak comes some 150 s after a setpoint step
    response = Response(0.0, end_s, (Peak(10.0, 1.0), Peak(60.0, -0.5)), Ending.QUIET, setpoint, 0.02)
    assert bool(not_seen(response, foretold(response, ClosedLoop(MODEL.linear(), slow)), SWING)) is refuted


@pytest.mark.parametrize(("third", "refuted"), [(1.2, False), (0.6, False), (0.1, True)])
def test_three_peaks_show_how_it_swings(third: float, refuted: bool) -> None:
    assert bool(said(SWINGS, 2.0, -1.0, third, ending=Ending.COMPLETE)) is refuted


def test_a_load_that_comes_as_a_ramp_makes_a_loop_swing_less() -> None:
    response = Response(0.0, 300.0, (Peak(10.0, 1.0), Peak(20.0, -0.1)), Ending.QUIET, sp_changed=False, band=0.02)
    loop = ClosedLoop(MODEL.linear(), PidGains(2.2 * GOOD.kp, 4 * GOOD.ki))
    sharp, ramp = foretold(response, loop), foretold(response, loop, ramp_s=200.0)

    assert "came to rest" in not_seen(response, sharp, SWING)
    assert not_seen(response, ramp, SWING) == ""
    rising = np.arange(len(sharp.e)) * sharp.step_s < 200.0
    np.testing.assert_allclose(ramp.e[rising], np.cumsum(sharp.e)[rising] / round(200.0 / sharp.step_s))
