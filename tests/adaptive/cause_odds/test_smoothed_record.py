"""A recorder that smooths pv and co changes neither the process nor what is told of it."""

from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.cause_odds.smoothed_record import with_smoothing
from retuner.adaptive.explanations import wandering_load
from retuner.adaptive.explanations.wandering_load import LOADS, Prepared, under_loads, unsmoothed
from retuner.adaptive.signals.sample import FloatArray, Window
from tests.adaptive.cause_odds.test_odds import loop, told


def averaged(window: Window) -> Window:
    """The means of two samples each."""

    def mean(x: FloatArray) -> FloatArray:
        return np.concatenate([x[:1], (x[1:] + x[:-1]) / 2])

    return replace(window, pv=mean(window.pv), co=mean(window.co))


def test_averages_are_known_from_samples() -> None:
    window = loop(seed=3)
    assert with_smoothing(Prepared.at(window, 1.0), 1, 1.0, 0.1)[0].smoothing == 0.0
    assert with_smoothing(Prepared.at(averaged(window), 1.0), 1, None, 0.1)[0].smoothing > 0.5


@pytest.mark.slow
def test_averages_are_told_as_samples_are() -> None:
    window = loop(seed=3)
    one, other = told(window), told(averaged(window))
    assert other.causes["aggressive"] == pytest.approx(one.causes["aggressive"], abs=0.05)  # else 0.65 for 0.08
    assert one.causes["aggressive"] < 0.2


def test_what_smooths_is_taken_back() -> None:
    x = np.random.default_rng(1).standard_normal(100)
    x[0] = 0.0
    smoothed = x + 0.85 * np.concatenate([[0.0], x[:-1]])
    assert unsmoothed(smoothed, 0.85) == pytest.approx(x, abs=1e-6)


def test_the_compiled_engine_and_numpy_agree_on_a_smoothed_record(monkeypatch: pytest.MonkeyPatch) -> None:
    record = replace(Prepared.at(averaged(loop(n=200)), 1.0), smoothing=0.85)
    one = under_loads(record, record.co[None], 7.0, LOADS, (0.0, 1.5, 4.0))
    monkeypatch.setattr(wandering_load, "compiled", lambda: None)
    other = under_loads(record, record.co[None], 7.0, LOADS, (0.0, 1.5, 4.0))
    assert other.gain == pytest.approx(one.gain, rel=1e-5, abs=1e-9)
    assert other.left == pytest.approx(one.left, rel=1e-5)
    assert (other.freedom == one.freedom).all()
