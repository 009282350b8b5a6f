"""The models that a change is proved on: as the record allows them, and farther apart when they are old."""

import math
from dataclasses import replace

import numpy as np
import pytest
from guard_cases import MODEL, SETTINGS

from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.guard import allowed
from retuner.adaptive.guard.model_set import MOST_LOG_STEP
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel, ProcessType

RECORD = replace(MODEL, k=2.2)
MORE_GAIN = replace(MODEL, k=2.2 * 1.1)
MORE_DELAY = replace(MODEL, k=2.2, theta_s=6.0)
RIVAL = ProcessModel(ProcessType.INTEGRATING, 0.045, theta_s=5.5)


def log(std: float = 0.1) -> LogModel:
    return LogModel(parameters_of(MODEL), std**2 * np.eye(3), 1)


def around(*models: tuple[ProcessModel, float]) -> tuple[Plausible, ...]:
    return (Plausible(RECORD, 0.0), *(Plausible(m, e) for m, e in models))


def test_the_deviations_of_the_record_are_carried_to_the_model_of_the_region() -> None:
    best, gain, delay = allowed(log(), around((MORE_GAIN, 3.9), (MORE_DELAY, 2.0)), 0.0, SETTINGS)
    assert best == Plausible(log().model(), 0.0)
    assert gain.model.k == pytest.approx(2.0 * 1.1)
    assert (delay.model.k, delay.model.theta_s) == (pytest.approx(2.0), pytest.approx(6.0))
    assert (gain.excess, delay.excess) == (3.9, 2.0)


def test_what_the_record_does_not_believe_is_left_out() -> None:
    assert len(allowed(log(), around((MORE_GAIN, 4.1), (MORE_DELAY, 4.0)), 0.0, SETTINGS)) == 2


def test_other_structures_count_as_they_are() -> None:
    models = allowed(log(), around((MORE_GAIN, 1.0), (RIVAL, 2.0)), 0.09, SETTINGS)
    assert models[-1] == Plausible(RIVAL, 2.0)


def test_age_widens_as_the_variances_add() -> None:
    for variance in (0.0, 0.0025, 0.01):
        moved = allowed(log(), around((MORE_GAIN, 1.0)), variance, SETTINGS)[1]
        assert math.log(moved.model.k / 2.0) ** 2 == pytest.approx(math.log(1.1) ** 2 + 4 * variance)


def test_age_ends_where_a_parameter_has_changed_by_two() -> None:
    moved = allowed(log(), around((MORE_GAIN, 1.0)), 100.0, SETTINGS)[1]
    assert moved.model.k == pytest.approx(4.0)
    far = around((replace(MODEL, k=2.2 * 5), 1.0))
    assert allowed(log(), far, 100.0, SETTINGS)[1].model.k == pytest.approx(10.0)


@pytest.mark.parametrize("known", [(), around(), (Plausible(RIVAL, 0.0), Plausible(MORE_GAIN, 1.0))])
def test_without_points_of_its_structure_the_covariance_stands_in(known: tuple[Plausible, ...]) -> None:
    models = allowed(log(0.1), known, 0.0, SETTINGS)
    corners = [p for p in models[1:] if p.model != MORE_GAIN]
    assert len(corners) == 6
    steps = [parameters_of(p.model) - log().x for p in corners]
    assert sorted(float(np.max(np.abs(step))) for step in steps) == pytest.approx([0.2] * 6)
    wide = [parameters_of(p.model) - log().x for p in allowed(log(3.0), (), 0.0, SETTINGS)[1:]]
    assert max(float(np.max(np.abs(step))) for step in wide) == pytest.approx(MOST_LOG_STEP)


def test_a_point_that_is_the_best_itself_stays() -> None:
    assert allowed(log(), around((RECORD, 0.5)), 0.04, SETTINGS)[1].model.k == pytest.approx(2.0)


def test_no_variance_that_is_none() -> None:
    for wrong in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="extra_variance"):
            allowed(log(), (), wrong, SETTINGS)
