"""Whether the truth lies within the bands of a design: k, tau and theta by the half rule, and SIMC's Kc of them.

The half rule gives three lags that are alike other settings than the two lags that move as they do. So the ultimate
gain and period are compared as well: they are of the process and not of its form.
"""

import math
from typing import Any

import numpy as np

from retuner.adaptive.loop.margins import ultimate
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.schedule_design.places import LEAST_STD
from retuner.adaptive.signals.sample import FloatArray
from retuner.scheduling import ScheduleDesign
from schedules.subject import Subject

NAMES = ("k", "tau", "theta", "kc", "ku", "pu")
STEP = 1e-5


def bands(found: ScheduleDesign, subject: Subject) -> list[dict[str, Any]]:
    """A row for each known place: how far the truth is from the curves, and one standard deviation as they claim it."""
    rows = []
    for place in found.places:
        if not place.known or not subject.low <= place.x <= subject.high:
            continue
        curves = found.design.curves
        ln = curves.ln(np.array([place.x]))[0]
        covariance = curves.ln_covariance(place.x) + LEAST_STD**2 * np.eye(len(ln))
        slopes = np.stack([(_told(ln + STEP * way) - _told(ln)) / STEP for way in np.eye(len(ln))], axis=1)
        std = np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
        off = _told(ln) - _true(subject.local(place.x))
        rows.append(
            {"x": place.x, "off": dict(zip(NAMES, off.tolist(), strict=True))}
            | {"std": dict(zip(NAMES, std.tolist(), strict=True))}
        )
    return rows


def _told(ln: FloatArray) -> FloatArray:
    """ln k, tau, theta, Kc, Ku, Pu of ln b, theta, tau (, tau2)."""
    lags = [math.exp(x) for x in ln[2:]]
    return _true(LinearProcess(math.exp(ln[0]) * lags[0], tuple(lags), (), math.exp(ln[1])))


def _true(process: LinearProcess) -> FloatArray:
    """The same of a process of any order."""
    model = half_rule(process)
    kc = model.tau1_s / (abs(model.k) * 2 * model.theta_s)
    ku, pu = ultimate(process)
    return np.log([abs(model.k), model.tau1_s, model.theta_s, kc, abs(ku), pu])
