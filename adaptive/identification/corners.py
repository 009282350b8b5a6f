"""Loads that move along ramps: found corner by corner, where steps are a poor cover for them.

A load that goes from one place to another in a time of its own is two changes of its slope. Steps that stand for it
leave a remainder, and what they do not explain the process does: ramps into six loops of a seed gave one model, which
was wrong. Ramps are asked for where nobody moved the setpoint, and where a single sharp step does not do.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.misfit import LOAD_COST
from retuner.adaptive.fit.refine import refine
from retuner.adaptive.fit.search import instants
from retuner.adaptive.fit.structure import SIZE, dynamics_at
from retuner.adaptive.identification.candidate import Candidate, CandidateList, judged
from retuner.adaptive.identification.loads import MOVE_EVALUATIONS, PROMISING, SCAN, improved, linear_gains
from retuner.adaptive.signals.sample import FloatArray

SAMPLES_EACH = 4
"""Samples that a record needs for each unknown before another corner is looked for."""
PAIR = 2
"""Corners of one ramp."""


def asked_for(winner: Candidate) -> bool:
    """Whether loads may be ramps for all that a fit with steps shows: more than one sharp step, or a coloured rest."""
    misfit = winner.fit.misfit
    return misfit.loads > 1 or misfit.rounded or misfit.ramp or bool(winner.colour.ar)


def with_corners(starts: Sequence[Candidate], most: int, seen: CandidateList) -> None:
    """Notes the best explanations by ramps that are reached from these starts.

    starts : fits whose process is kept at first, while their loads are not. most : loads in all.
    """
    found = [_cornered(start, most, seen) for start in starts]
    best = min((c for c in found if c is not None), key=lambda c: c.criterion, default=None)
    if best is not None:
        improved(best, most, seen)


def _cornered(start: Candidate, most: int, seen: CandidateList) -> Candidate | None:
    """The best with one corner after another, None where there is room for none."""
    at, best = _bare(start), None
    for _ in range(most):
        found = _with_corner(at)
        if found is None:
            break
        at = found
        seen.add(at)
        if best is None or at.criterion < best.criterion:
            best = at
    return best


def _bare(start: Candidate) -> Candidate:
    """The process of a fit, without any of its loads."""
    kept = replace(start.fit.misfit, loads=0, corners=0, rounded=False, ramp=False, ar=())
    kept = replace(kept, sigma=kept.record.noise_std)
    return judged(refine(kept, start.fit.x, evaluations=0))


def _with_corner(at: Candidate) -> Candidate | None:
    """One corner more, where it takes away most; the first of a pair leaves the process as it is."""
    misfit, p = at.fit.misfit, at.fit.p
    if len(misfit.record.pv) < SAMPLES_EACH * (misfit.unknowns + LOAD_COST):
        return None
    record, places = misfit.record, instants(misfit.record.span_s, SCAN)
    engine = compiled()
    gains = engine.load_gains(misfit, p, places, corner=True) if engine else linear_gains(at, _ramps(at, places))
    best = int(np.argmax(gains))
    if gains[best] < PROMISING * LOAD_COST * math.log(len(record.pv)):
        return None
    after = SIZE[misfit.type] + misfit.loads
    more = replace(misfit, loads=misfit.loads + 1, corners=misfit.corners + 1)
    start = np.insert(p, after, places[best])
    single = more.corners % PAIR
    return judged(refine(more, start, evaluations=0 if single else MOVE_EVALUATIONS))


def _ramps(at: Candidate, places: FloatArray) -> FloatArray:
    """The responses to unit ramps that begin there, each one in size at most, shape (n, places)."""
    dynamics = dynamics_at(at.fit.misfit.type, at.fit.p)
    ramps = at.fit.misfit.lagged(at.fit.p, dynamics.ramp(at.fit.misfit.record.t_s[:, None] - places[None, :]))
    largest = np.maximum(np.max(np.abs(ramps), axis=0), np.finfo(np.float64).tiny)
    return np.asarray(ramps / largest, dtype=np.float64)
