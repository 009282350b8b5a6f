"""How the fitted pv moves with each parameter while the linear unknowns are held: what the Jacobian is made of."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from retuner.adaptive.identification.dynamics import Dynamics
from retuner.adaptive.identification.slopes import (
    By,
    LateMode,
    held_by_theta,
    held_slope,
    impulse_slope,
    late_modes,
    ramp_slope,
    rounded_by_lag,
    rounded_rise,
    rounded_slope,
    step_slope,
    told_apart,
)
from retuner.adaptive.identification.structure import LAG, SECOND, SIZE, SLOPE, THETA, dynamics_at
from retuner.adaptive.signals.sample import FloatArray

if TYPE_CHECKING:
    from retuner.adaptive.identification.misfit import Misfit, Projection

Change = tuple[int, FloatArray, FloatArray]
"""Place of a column, the column before it was scaled to one, and its derivative."""


def changes_of(misfit: "Misfit", at: "Projection") -> list[FloatArray]:
    """Derivative of the fitted pv by every p[j], shape (n,) each."""
    p, d = at.p, SIZE[misfit.type]
    dynamics = told_apart(dynamics_at(misfit.type, p))
    late = late_modes(dynamics, misfit.record.clock, misfit.input, math.exp(p[THETA]))
    found = [at.moved, _by_theta(misfit, at, dynamics, late)]
    if misfit.type in LAG:
        found.append(_by_dynamics(misfit, at, dynamics, late, By.LAG))
    if misfit.type in SECOND:
        found.append(_by_dynamics(misfit, at, dynamics, late, By.SECOND))
    found += [_summed(at, [_load_change(misfit, at, dynamics, j)]) for j in range(misfit.loads)]
    if misfit.rounded:
        lag = math.exp(p[d + misfit.loads])
        since = [misfit.record.t_s - p[d + j] for j in range(misfit.loads)]
        found.append(
            _summed(at, [(at.priors + j, dynamics.rounded_step(s, lag), rounded_by_lag(dynamics, s, lag))
                         for j, s in enumerate(since)])
        )  # fmt: skip
    if misfit.harmonics:
        found.append(_by_tone(misfit, at))
    return found


def _summed(at: "Projection", changes: list[Change]) -> FloatArray:
    """The derivatives of columns that were scaled to one, times their coefficients."""
    found = np.zeros(len(at.moved))
    for place, column, change in changes:
        peak = int(np.argmax(np.abs(column)))
        if column[peak]:
            size, rise = abs(column[peak]), change[peak] / column[peak]
            found += at.c[place] * (change - rise * column) / size
    return found


def _by_theta(misfit: "Misfit", at: "Projection", dynamics: Dynamics, late: list[LateMode]) -> FloatArray:
    """By ln theta."""
    theta = math.exp(at.p[THETA])
    moved = held_by_theta(dynamics, late, theta)
    return misfit.sign * math.exp(at.p[SLOPE]) * moved + _summed(at, list(_late_by_theta(misfit, dynamics, theta)))


def _late_by_theta(misfit: "Misfit", dynamics: Dynamics, theta: float) -> Iterator[Change]:
    """The columns of a start in motion, which know the dead time."""
    if not misfit.record.motion_at_start:
        return
    place = len(misfit.starts) * (1 + int(misfit.type in SECOND))
    for at in misfit.starts:
        since = misfit.record.t_s - at
        late = since - theta
        yield place, dynamics.step(late), -theta * dynamics.impulse(late)
        yield place + 1, dynamics.ramp(since) - dynamics.ramp(late), theta * dynamics.step(late)
        place += 2


def _by_dynamics(misfit: "Misfit", at: "Projection", dynamics: Dynamics, late: list[LateMode], by: By) -> FloatArray:
    """By ln T or ln c2."""
    moved = held_slope(dynamics, late, by)
    changes = list(_columns_by_dynamics(misfit, at.p, dynamics, by))
    return misfit.sign * math.exp(at.p[SLOPE]) * moved + _summed(at, changes)


def _columns_by_dynamics(misfit: "Misfit", p: FloatArray, dynamics: Dynamics, by: By) -> Iterator[Change]:
    """All columns that the process has shaped."""
    t, theta, place = misfit.record.t_s, math.exp(p[THETA]), 0
    for at in misfit.starts:
        yield place, dynamics.step(t - at), step_slope(dynamics, t - at, by)
        place += 1
    for at in misfit.starts if misfit.type in SECOND else ():
        yield place, dynamics.impulse(t - at), impulse_slope(dynamics, t - at, by)
        place += 1
    for at in misfit.starts if misfit.record.motion_at_start else ():
        since, late = t - at, t - at - theta
        yield place, dynamics.step(late), step_slope(dynamics, late, by)
        ramp = dynamics.ramp(since) - dynamics.ramp(late)
        yield place + 1, ramp, ramp_slope(dynamics, since, by) - ramp_slope(dynamics, late, by)
        place += 2
    d = SIZE[misfit.type]
    for j in range(misfit.loads):
        since = t - p[d + j]
        if misfit.rounded:
            lag = math.exp(p[d + misfit.loads])
            yield misfit.priors + j, dynamics.rounded_step(since, lag), rounded_slope(dynamics, since, lag, by)
        else:
            yield misfit.priors + j, dynamics.step(since), step_slope(dynamics, since, by)


def _load_change(misfit: "Misfit", at: "Projection", dynamics: Dynamics, j: int) -> Change:
    """A load step by its time."""
    d = SIZE[misfit.type]
    since = misfit.record.t_s - at.p[d + j]
    if misfit.rounded:
        lag = math.exp(at.p[d + misfit.loads])
        return at.priors + j, dynamics.rounded_step(since, lag), -rounded_rise(dynamics, since, lag)
    return at.priors + j, dynamics.step(since), -dynamics.impulse(since)


def _by_tone(misfit: "Misfit", at: "Projection") -> FloatArray:
    """By the logarithm of the tones' frequency."""
    t, w, place = misfit.record.t_s, math.exp(at.p[-1]), at.priors + misfit.loads
    found = np.zeros(len(t))
    for i in range(1, misfit.harmonics + 1):
        cosine, sine = at.columns[:, place], at.columns[:, place + 1]
        found += i * w * t * (at.c[place + 1] * cosine - at.c[place] * sine)
        place += 2
    return found
