"""Models that are still allowed at a place: as far from the likeliest as the record's own derivatives say."""

import math

import numpy as np
import pytest

from retuner.adaptive.schedule_design.places import SECOND_LAG, moved

LN = np.log(np.array([0.004, 90.0, 600.0, 2.0]))


def test_a_second_lag_that_is_hardly_known_is_no_lag_of_minutes() -> None:
    way = np.array([0.0, -0.05, 0.0, 5.3])

    far = np.exp(moved(LN, way))

    assert far[SECOND_LAG] == pytest.approx(2.0 * 6.3)
    assert far[1] == pytest.approx(90.0 * math.exp(-0.05))
    assert np.exp(moved(LN, -way))[SECOND_LAG] == pytest.approx(2.0 * math.exp(-5.3))


def test_what_is_known_well_moves_as_its_logarithm_does() -> None:
    way = np.array([0.04, 0.02, -0.03, 0.01])

    assert moved(LN, way) == pytest.approx(LN + way, abs=1e-4)
    assert moved(LN[:3], way[:3]) == pytest.approx((LN + way)[:3], abs=1e-12)
