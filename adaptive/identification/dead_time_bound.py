"""Settings from the bound that a record does give: a lag whose dead time is too short to be seen.

A process sampled too coarsely shows its gain and its lag, and of its dead time only that it is shorter than the
sampling interval. That is a bound, where co was moved by itself (a setpoint step, manual): a load whose time is not
known bounds nothing. With the dead time at the bound the settings are robust on whatever lies below it, and slower than
they need be: how much is known only by sampling faster. A bound says nothing against the gains in force: the models as
the record shows them stay allowed beside it, and it is no prior of the next record.
"""

import math
from dataclasses import replace

import numpy as np

from retuner.adaptive.fit.record import Record
from retuner.adaptive.identification.estimate import ModelEstimate, gain_spread, late
from retuner.adaptive.identification.identify import (
    FEWEST_SAMPLES_IN_THETA,
    WANTED_SAMPLES_IN_THETA,
    FitSettings,
    unexplained,
)
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.rules.simc import without_second_lag
from retuner.adaptive.signals.sample import Window

LEAST_LAG = 0.5  # sampling intervals in a lag that shows itself; a shorter one is no more known than the dead time
CALM = 2.0
"""Bounds that the dead time of an integrating process counts as: both of its settings rest on the bound alone."""


BELIEVED = 1.5  # dead times over this many bounds that the record allows as well: then it gives none


def bounded(window: Window, estimate: ModelEstimate, settings: FitSettings) -> ModelEstimate:
    """The estimate with a dead time of one sampling interval, where that is all that it lacks; else as it is."""
    dt, model = window.sample_time_s, estimate.log.model()
    short = without_second_lag(model)
    integrates = bool(model.linear().integrators)
    limit = (CALM if integrates else 1.0) * FEWEST_SAMPLES_IN_THETA * dt
    quick = not integrates and short.tau1_s < LEAST_LAG * dt
    if estimate.identifiable or short.theta_s >= FEWEST_SAMPLES_IN_THETA * dt or quick:
        return estimate
    if any(without_second_lag(p.model).theta_s > BELIEVED * limit for p in estimate.plausible):
        return estimate
    if estimate.is_contested(settings.apart_limit) or estimate.explained < settings.explained_limit:
        return estimate
    explained_std = float(np.std(window.pv)) * math.sqrt(estimate.explained)
    if unexplained(estimate.residual_std, explained_std, Record.of(window), settings):
        return estimate
    around = tuple(Plausible(late(p.model, limit), p.excess) for p in estimate.plausible)
    found = replace(estimate, bound_s=limit, plausible=(*around, *estimate.plausible))
    if max(found.log.gain_uncertainty(dt), gain_spread(around, dt)) > settings.gain_std_limit:
        return estimate
    reason = (
        f"{found.log.type}; the dead time is too short to be seen: taken as {dt:.3g} s, one sampling interval. For "
        f"faster settings, sample at least {WANTED_SAMPLES_IN_THETA} times within it"
    )
    return replace(found, identifiable=True, reason=reason)
