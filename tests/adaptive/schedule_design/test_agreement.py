"""Stretches that differ by more than their samples explain make the curves through them less sure, and only these."""

import math

import numpy as np
import pytest

from retuner.adaptive.schedule_design.agreement import agreement
from retuner.adaptive.schedule_design.joint import At, Form
from retuner.adaptive.schedule_design.stretches import LEVEL_STD, Axis, Shape

FORM = Form(Axis(0.0, 1.0), (Shape.CONSTANT, Shape.CONSTANT), (0.0, 0.0), 1)
ROWS, STRETCHES = 100, 40


def fitted(std):
    """Linear responses of which ln p of the first parameter differs by std between the stretches; white noise of 1."""
    rng = np.random.default_rng(7)
    first, second = np.sin(np.arange(ROWS) / 7), np.cos(np.arange(ROWS) / 3)
    jacobian = np.tile(10 * LEVEL_STD * np.stack([first, second], axis=1), (STRETCHES, 1))
    off = np.repeat(std * rng.standard_normal(STRETCHES), ROWS)
    r = rng.standard_normal(ROWS * STRETCHES) - jacobian[:, 0] / LEVEL_STD * off
    z = np.zeros(2)
    return At(z, r, (), jacobian, np.zeros(STRETCHES), ())


@pytest.mark.parametrize("std", [0.0, 0.25])
def test_differences_are_found_where_they_are(std):
    found = agreement(FORM, fitted(std), [ROWS] * STRETCHES, 1.0)

    assert found.differences == pytest.approx((std, 0.0), abs=0.03)
    told = LEVEL_STD * np.sqrt(np.diag(found.covariance))
    sampling = 1 / math.sqrt(100 * ROWS / 2 * STRETCHES)
    assert told[0] == pytest.approx(math.hypot(sampling, std / math.sqrt(STRETCHES)), rel=0.2)
    assert told[1] == pytest.approx(sampling, rel=0.2)
