"""What is known of a process that moves in one direction: the filter learns the drift, and does not stay behind."""

import json
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.region_model.kalman import back_to_mean, moved_on, widened
from retuner.adaptive.region_model.region_model import Drift, RegionModel, StructureModel
from retuner.adaptive.region_model.update import TrackerSettings, predicted
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out

D = 3
WALK, STD, KEEPS, SEEN = 0.03, 0.02, 0.95, 0.04
"""Standard deviations of the walk, of the drift at first, its share left after a record, and of a record."""
BEGIN = StructureModel(LogModel(np.array([-4.0, 1.6, 3.9]), 0.06**2 * np.eye(D), 1), 0.0)


def taught(known: StructureModel, seen: FloatArray, *, scatter: float = 0.0, std: float = STD) -> StructureModel:
    """One record later, which says `seen` of its process."""
    mean = moved_on(known, WALK**2, std, KEEPS)
    prior = widened(mean.log, scatter**2)
    gain = prior.p @ np.linalg.inv(prior.p + SEEN**2 * np.eye(D))
    posterior = replace(prior, x=prior.x + gain @ (seen - prior.x), p=prior.p - gain @ prior.p)
    return back_to_mean(mean, prior, posterior)


def test_without_scatter_it_is_the_filter_of_the_textbooks() -> None:
    """Harvey 1989, local linear trend: state (parameters, drift), of which a record shows the first."""
    rng, known = np.random.default_rng(3), BEGIN
    book = KalmanFilter(dim_x=2 * D, dim_z=D)
    book.x = np.concatenate([BEGIN.log.x, np.zeros(D)]).reshape(2 * D, 1)
    book.P = np.diag([0.06**2] * D + [STD**2] * D)
    one = np.eye(D)
    book.F = np.block([[one, one], [0 * one, KEEPS * one]])
    book.Q = np.diag([WALK**2] * D + [(1 - KEEPS**2) * STD**2] * D)
    book.H = np.hstack([one, 0 * one])
    for _ in range(12):
        seen = known.log.x + rng.normal(0.0, 0.1, D)
        book.predict()
        book.update(seen.reshape(D, 1), R=SEEN**2 * one)
        known = taught(known, seen)
    np.testing.assert_allclose(np.concatenate([known.log.x, known.drift.v]), book.x[:, 0], atol=1e-9)
    np.testing.assert_allclose(known.log.p, book.P[:D, :D], atol=1e-9)
    np.testing.assert_allclose(known.drift.p, book.P[D:, D:], atol=1e-9)
    np.testing.assert_allclose(known.drift.along, book.P[:D, D:], atol=1e-9)


def behind(std: float) -> float:
    """Of a gain that grows by 4 % a record, after 15 records: how much too small it is held for, as a logarithm."""
    known = BEGIN
    for i in range(1, 16):
        known = taught(known, BEGIN.log.x + np.array([0.039 * i, 0.0, 0.0]), scatter=0.06, std=std)
    assert np.max(np.abs(known.log.x[1:] - BEGIN.log.x[1:])) < 1e-9, "nothing else moved"
    return float(BEGIN.log.x[0] + 0.039 * 15 - known.log.x[0])


def test_a_gain_that_grows_steadily_is_followed() -> None:
    assert behind(1e-9) > 0.07
    assert abs(behind(STD)) < 0.02


def test_a_drift_is_foreseen_remembered_and_fades() -> None:
    drift = Drift(np.array([0.04, 0.0, 0.0]), 1e-4 * np.eye(D), np.zeros((D, D)))
    model = RegionModel((replace(BEGIN, drift=drift),), 5, 0.0)
    again = region_model_in(region_model_out(model))
    settings = TrackerSettings()
    for one in (model, again):
        assert predicted(one, 0.0, settings).x[0] == pytest.approx(BEGIN.log.x[0] + 0.04)
    later = moved_on(model.known[0], 0.0, settings.drift_per_record, 0.5)
    assert later.drift.v[0] == pytest.approx(0.02)
    body = json.loads(json.dumps(region_model_out(model)))
    del body["known"][0]["drift"]
    assert region_model_in(body).known[0].drift is None, "a memory of before has none"


@pytest.mark.parametrize(
    "broken", [(np.zeros(3), np.eye(2), np.zeros((3, 3))), (np.array([np.nan, 0, 0]), np.eye(3), np.zeros((3, 3)))]
)
def test_a_broken_drift_is_refused(broken: tuple[FloatArray, FloatArray, FloatArray]) -> None:
    with pytest.raises(ValueError, match="drift"):
        Drift(*broken)
