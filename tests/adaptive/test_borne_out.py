"""Records that settle the process by themselves and agree bear a change out; a short one takes nothing from them."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from retuner.adaptive.diagnosis.oscillation_online import SwingSettings
from retuner.adaptive.diagnosis.second_opinion import Excitation, from_rest_to_rest
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.update import TrackerSettings, update_region_model
from retuner.adaptive.signals.response import Ending
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.supervision.confirmation import records_agree
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.gains import PidGains


def record(k: float = 1.0, std: float = 0.02) -> SimpleNamespace:
    """What one record says by itself of k e^-5s / (50 s + 1). std : of its logarithms."""
    return SimpleNamespace(log=LogModel(np.log([k / 50, 5.0, 50.0]), std**2 * np.eye(3), 1, ProcessType.FOPDT))


@pytest.mark.parametrize(
    ("points", "setpoints", "rested", "borne"),
    [
        ([record(), record(1.02), record(0.97)], 2, 0, True),
        ([record(), record()], 2, 0, False),  # too few
        ([record(), record(1.5), record()], 2, 0, False),  # one says another thing
        ([record(), record(std=0.8), record()], 2, 0, False),  # one settles nothing
        ([record(), record(), record()], 1, 2, False),  # loads may agree on a fiction
        ([record(), record(1.02), record(0.97)], 0, 3, True),  # a tone never rests
        ([record(), record(1.5), record()], 0, 3, False),
    ],
)
def test_independent_records_that_agree_bear_a_change_out(points, setpoints, rested, *, borne):
    model: Any = SimpleNamespace(log=record().log, points=tuple(points))
    rests_on = Excitation(setpoints=setpoints, loads=max(rested, 1), rested=rested)
    assert records_agree(model, rests_on, RetunerSettings(1.0, 100.0)) is borne


def quiet_before(error: Callable[[float], float], *, quiet: bool = True) -> tuple[list[LoopSample], Any]:
    """200 s of a loop, and a load response in its last 100 s."""
    samples = [LoopSample(float(t), 0.0, error(float(t)), 0.0) for t in range(200)]
    ending = Ending.QUIET if quiet else Ending.COMPLETE
    return samples, SimpleNamespace(
        t_start_s=100.0, t_end_s=199.0, band=0.1, ending=ending, taken_over=False, sp_changed=False
    )


@pytest.mark.parametrize(
    ("error", "quiet", "rested"),
    [
        (lambda t: math.exp(-abs(t - 120) / 10) * (t > 100), True, True),
        (lambda t: math.exp(-abs(t - 120) / 10) * (t > 100), False, False),  # it was cut short, or swings on
        (lambda t: math.sin(2 * math.pi * t / 200), True, False),  # a slow tone rests only where it crosses
        (lambda t: float(t > 70) * math.exp(-abs(t - 120) / 20), True, False),  # in motion before
    ],
)
def test_a_load_response_leads_from_rest_to_rest(error: Callable[[float], float], *, quiet: bool, rested: bool) -> None:
    samples, response = quiet_before(error, quiet=quiet)
    assert from_rest_to_rest(samples, response, SwingSettings()) is rested
    assert Excitation().with_response(response, rested=rested).rested == int(rested)
    assert Excitation(rested=2).with_response(response, rested=False).rested == 0, "they must follow one another"
    response.sp_changed = True
    assert Excitation(rested=2).with_response(response, rested=True).rested == 2
    assert not from_rest_to_rest(samples[100:], response, SwingSettings()), "what came before is not known"


def test_a_short_record_takes_nothing_from_what_is_known(loop: Callable[..., Any]) -> None:
    gains, settings, fit = PidGains(2.0, 0.05), TrackerSettings(), FitSettings()
    known = update_region_model(None, loop(noise=0.02, sp=1.0).run(seed=0), gains, settings, fit).region_model
    assert known.identifiable
    whole: Window = loop(noise=0.02, sp=1.0).run(seed=1, t0=400.0)
    step = int(np.argmax(whole.sp > 0.5))
    short = whole.part(slice(step - 1, step + 17))
    assert not update_region_model(None, short, gains, settings, fit).estimate.identifiable
    assert update_region_model(known, short, gains, settings, fit).estimate.identifiable
