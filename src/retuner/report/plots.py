"""What the pictures of loops share: who is drawn how, and axes of values that do not blow noise up."""

import numpy as np
from matplotlib.axes import Axes

from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray
from retuner.decision_page.looks import AFTER, BEFORE, SETPOINT
from retuner.report.scores import CO_FLOOR, NOISE_BANDS

PV, SP, FIXED = AFTER, SETPOINT, BEFORE


def at_least(axes: Axes, floor: float) -> None:
    """Make the axis of values no shorter than that, about its middle."""
    low, high = axes.get_ylim()
    if high - low < floor:
        axes.set_ylim((low + high - floor) / 2, (low + high + floor) / 2)


def floors(pv_axes: Axes, co_axes: Axes, pv: FloatArray) -> None:
    """The floors of pv's and of co's axis."""
    known = pv[np.isfinite(pv)]
    if len(known) > 2:
        at_least(pv_axes, NOISE_BANDS * noise_sigma(known))
    at_least(co_axes, CO_FLOOR)
