"""A controller that acts the wrong way: what it does against an error makes the error grow.

    pv runs away from its setpoint and co goes on in the way that its law says, until it stands at a limit

A load beyond what the output can do looks the same from afar: pv is pushed away, and co goes to its limit against it.
But then the process with the gain that the controller counts on explains the record, with that one load; where it acts
the wrong way, a process of the other sign does so, and by far better.
"""

from dataclasses import replace

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.identification.candidate import Candidate
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.identification.structure_choice import candidates, too_few
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import Window

PARTS = 5  # the beginning and the end of a record are a fifth of it each
RUNS = 3.0  # ratio of the error at the end to that at the beginning from which it has run away
SIGMAS = 6.0  # standard deviations by which the growth must stand out of the noise
LEAD = 25.0  # lead of the other sign's criterion that is needed: odds of e^12
EXPLAINED = 0.9  # share of pv's variance that it must explain
LEAST_SAMPLES = 5 * PARTS  # A part has at least five samples; a record that is shorter is taken whole
MOST_LOADS = 1  # load steps that it may need: what goes the wrong way runs away from the smallest one


def acts_wrong_way(window: Window, direction: int, settings: FitSettings, farthest: float = 0.0) -> Diagnosis | None:
    """The verdict, where the record shows it. direction : of the controller, the sign of its gain.

    farthest : how far pv was from its setpoint before, under the same gains; what acts the wrong way never comes back.
    """
    away = np.flatnonzero(window.co != window.co[-1])
    kept = (int(away[-1]) + 2) * (PARTS + 1) // PARTS if away.size else len(window.co)
    if LEAST_SAMPLES <= kept < len(window.co):  # long after co stood still for good, at a limit, nothing new is told
        window = window.part(slice(kept))
    # Whether the error grows, and co moves against it as a controller of that direction does, farther and farther
    error, part = window.sp - window.pv, max(len(window.pv) // PARTS, 2)
    end = float(np.mean(error[-part:]))
    before = float(np.sqrt(np.mean(error[:part] ** 2)))
    moved = float(np.mean(window.co[-part:]) - np.mean(window.co[:part]))
    grown = abs(end) > max(RUNS * before, farthest) and abs(end) > SIGMAS * noise_sigma(window.pv)
    if not (grown and moved * end * direction > 0) or too_few(window):
        return None
    few = replace(settings, choice=replace(settings.choice, seeded_loads=MOST_LOADS, most_loads=MOST_LOADS))
    if _lead(window, direction, few) is None:  # the other sign may use no more load steps; its own only gains by them
        return None
    lead = _lead(window, direction, settings)
    if lead is None:
        return None
    reason = (
        "the controller acts the wrong way: pv goes where co pushes it, away from the setpoint, and co pushes on; take "
        "the loop to manual, then turn its action round (direct, reverse), or the sign of its gain"
    )
    return Diagnosis(Cause.UNKNOWN, 0.9, {"wrong_way_lead": lead}, reason)


def _lead(window: Window, direction: int, settings: FitSettings) -> float | None:
    """Lead of a process of the other sign in explaining the record; None where it is not by far."""
    other = _best(window, -direction, settings)
    record = other.fit.misfit.record
    explained = 1 - float(np.var(record.pv - other.fit.explained) / np.var(record.pv))
    if explained < EXPLAINED or other.fit.misfit.loads > MOST_LOADS:
        return None
    lead = _best(window, direction, settings).criterion - other.criterion
    return lead if lead >= LEAD else None


def _best(window: Window, sign: int, settings: FitSettings) -> Candidate:
    return candidates(window, (sign,), settings.choice, settings.most_samples)[0]
