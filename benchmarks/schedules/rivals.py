"""What a designed schedule is compared with on the same walk.

fixed       SIMC with perfect knowledge of the middle, everywhere
four        four equal regions, perfect knowledge of each centre
points      a step experiment at each of POINTS places, identified, SIMC, straight lines between
perfect     perfect knowledge at every place judged, straight lines between
"""

from functools import partial

import numpy as np
from online.judge import Judge
from online.rivals import step_then_simc

from retuner import GainTable, PidGains
from schedules.lookups import Curve, Lookup, Table, regions_along
from schedules.subject import Live, Subject
from schedules.truth import Truth

POINTS = 8
TEST_SHARE = 0.05  # Share of the span by which pv moves in an experiment


class _AboutRest:
    """A plant as an experiment sees it: moves about rest at a place."""

    def __init__(self, subject: Subject, place: float) -> None:
        self._live: Live = subject.live(place)
        self._u0, self._y0, self._place = subject.rest(place), subject.sp_at(place), place

    def move(self, u: float) -> float:
        """See online.loop.Moved."""
        return self._live.move(self._u0 + u, self._place) - self._y0


def fixed(truth: Truth) -> Curve:
    subject = truth.subject
    middle = (subject.low + subject.high) / 2
    return Curve([middle], [subject.judge(middle).best])


def four(truth: Truth) -> Lookup:
    subject = truth.subject
    width = (subject.high - subject.low) / 4
    bounds = tuple(subject.low + width * i for i in (1, 2, 3))
    regions = regions_along(subject.by, subject.low, bounds, subject.high, width / 50)
    sets = tuple(subject.judge(subject.low + width * (i + 0.5)).best for i in range(4))
    return Table(GainTable("loop", regions, sets))


def points(truth: Truth, rng: np.random.Generator) -> Curve:
    """See the head; a place whose experiment fails is left out."""
    subject = truth.subject
    xs: list[float] = []
    sets: list[PidGains] = []
    for place in subject.places(POINTS):
        local = subject.local(place)
        size = TEST_SHARE * subject.span
        test = partial(step_then_simc, _AboutRest(subject, place), local, Judge.theta(local), subject.dt_s)
        found = test(subject.noise, rng, size)
        if found is not None:
            xs.append(place)
            sets.append(found)
    return Curve(xs, sets) if xs else fixed(truth)
