"""What a process that changes along its way does, against its own differential equation integrated finely."""

import numpy as np
import pytest

from retuner.adaptive.schedule_design.joint import white
from retuner.adaptive.schedule_design.motion import Batch, Local, response
from retuner.adaptive.schedule_design.record_stretches import Stretch, signals_of
from retuner.adaptive.signals.sample import Window

THETA, TAU, FALL, PARTS = 3.0, 60.0, 0.04, 20
"""b falls by a factor of 10 and the lag grows by as much over 58 units; k is the same everywhere."""


def lag(y):
    return TAU * np.exp(FALL * (y - 50.0))


def travelled(co, y, rest_of=lambda y: y):
    """dy/dt = (v - rest)/lag, v is co THETA ago; pv at the samples."""
    pv, h = [], 1.0 / PARTS
    for i in range(len(co)):
        pv.append(y)
        v = co[max(i - int(THETA), 0)]
        for _ in range(PARTS):
            y += h * (v - rest_of(y)) / lag(y)
    return np.array(pv)


@pytest.mark.parametrize("slowness", [1, 150])
def test_far_travel_is_that_of_the_equation(slowness):
    n = 900
    wish = np.where(np.arange(n) < 20, 20.0, 70.0)
    co = 20.0 + np.array([np.mean(wish[max(i - slowness, 0) : i + 1] - 20.0) for i in range(n)])
    pv = travelled(co, 20.0)
    window = Window(np.arange(float(n)), wish, pv, co)
    batch = Batch.of([Stretch(signals_of(window, pv, 1), 0, n, changed=True)])
    y = batch.x[..., None]
    ln_tau = np.log(lag(y))
    local = Local(-ln_tau, np.full(y.shape, np.log(THETA)), ln_tau, None)

    moved = response(local, batch.arriving(np.exp(local.theta)), batch.h_s)[:, 0, 0]

    assert np.ptp(pv) > 40
    assert 20.0 + moved == pytest.approx(pv, abs=0.005 * np.ptp(pv))


def test_the_first_rows_of_a_stretch_count():
    values = np.array([5.0, 0.0, 0.0, 0.0, 0.0])

    assert white(values, (0.5, 0.25)) == pytest.approx([5.0, -2.5, -1.25, 0.0, 0.0])
    assert white(np.ones((4, 2)), (0.9,))[:, 1] == pytest.approx([1.0, 0.1, 0.1, 0.1])
