"""Records that settle the process by themselves and agree bear a change out; a short one takes nothing from them."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.update import TrackerSettings, update_region_model
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.causes import borne_out
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.schedule.gains import PidGains


def record(k: float = 1.0, std: float = 0.02) -> SimpleNamespace:
    """What one record says by itself of k e^-5s / (50 s + 1). std : of its logarithms."""
    return SimpleNamespace(log=LogModel(np.log([k / 50, 5.0, 50.0]), std**2 * np.eye(3), 1, ProcessType.FOPDT))


@pytest.mark.parametrize(
    ("points", "setpoints", "borne"),
    [
        ([record(), record(1.02), record(0.97)], 2, True),
        ([record(), record()], 2, False),  # too few
        ([record(), record(1.5), record()], 2, False),  # one says another thing
        ([record(), record(std=0.8), record()], 2, False),  # one settles nothing
        ([record(), record(), record()], 1, False),  # loads may agree on a fiction
    ],
)
def test_independent_records_that_agree_bear_a_change_out(
    points: list[SimpleNamespace], setpoints: int, *, borne: bool
) -> None:
    model: Any = SimpleNamespace(log=record().log, points=tuple(points))
    assert borne_out(model, Excitation(setpoints=setpoints, loads=1), RetunerSettings(1.0, 100.0)) is borne


def test_a_short_record_takes_nothing_from_what_is_known(loop: Callable[..., Any]) -> None:
    gains, settings, fit = PidGains(2.0, 0.05), TrackerSettings(), FitSettings()
    known = update_region_model(None, loop(noise=0.02, sp=1.0).run(seed=0), gains, settings, fit).region_model
    assert known is not None
    assert known.identifiable
    whole: Window = loop(noise=0.02, sp=1.0).run(seed=1, t0=400.0)
    step = int(np.argmax(whole.sp > 0.5))
    short = whole.part(slice(step - 1, step + 17))
    assert not update_region_model(None, short, gains, settings, fit).estimate.identifiable
    assert update_region_model(known, short, gains, settings, fit).estimate.identifiable
