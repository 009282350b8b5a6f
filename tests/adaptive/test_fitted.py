"""The drawn explanation of a record is the one that was fitted."""

import numpy as np
import pytest

from retuner.adaptive.identification.fitted_curve import fitted_pv
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.signals.sample import Window


@pytest.mark.parametrize("load", [0.0, 1.5])
def test_fitted_pv_leaves_noise(load):
    n, noise = 400, 0.02
    rng = np.random.default_rng(4)
    t = 1.7e9 + np.arange(float(n))  # a clock that counts from 1970
    co = np.where((np.arange(n) // 130) % 2 == 0, 0.0, 1.0)
    x, pv = 0.0, np.zeros(n)
    for i in range(n):
        pv[i] = 30 + x + noise * rng.normal()
        x += (1 - np.exp(-1 / 15)) * (2 * co[max(i - 4, 0)] + (load if i >= 300 else 0.0) - x)
    window = Window(t, np.full(n, 30.0), pv, co)
    estimate = identify_window(window)
    fitted = fitted_pv(window, estimate)
    assert fitted.shape == (n,)
    assert np.std(pv - fitted) == pytest.approx(noise, rel=0.15)
    assert len(estimate.load_times_s) == (1 if load else 0)
