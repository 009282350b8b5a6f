"""A fit with what it leaves and its criterion, and the list of all that were tried."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from retuner.adaptive.fit.misfit import LOAD_COST, Colour, Misfit, colour, criterion
from retuner.adaptive.fit.record import are_coincident
from retuner.adaptive.fit.refine import EXACT, Fit, Prior, refine
from retuner.adaptive.fit.search import load_times
from retuner.adaptive.fit.structure import SIZE, model_at
from retuner.adaptive.identification.usual_dead_time import RARE
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.schedule.late_dataclass import dataclass, replace

MODEL_ERROR = 0.005
"""What a second-order model leaves of a real response (order, nonlinearity): rms as a share of pv's range."""
BARRED = 1e6  # price of a load step at a setpoint change where none is to stand: any other explanation is cheaper


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A fit with the colour of what it leaves and its criterion (smaller is better)."""

    fit: Fit
    colour: Colour
    criterion: float

    @property
    def found(self) -> tuple[object, ...]:
        """What two candidates of a record have in common that are one, found on two ways."""
        m = self.fit.misfit
        loads = m.loads, m.corners, m.rounded, m.ramp, m.harmonics
        return m.type, m.sign, loads, m.sigma, m.ar, m.most_order, self.criterion, self.fit.p.tobytes()

    @property
    def model(self) -> ProcessModel:
        """The process."""
        return model_at(self.fit.misfit.type, self.fit.x, self.fit.misfit.sign)

    @property
    def whitened(self) -> bool:
        """Whether it was fitted with the filter that its remainder asks for."""
        return self.fit.misfit.ar == self.colour.ar

    @property
    def is_plain(self) -> bool:
        """Whether its loads are steps that come at once, without a drift beside them."""
        misfit = self.fit.misfit
        return not (misfit.rounded or misfit.ramp or misfit.corners)


def judged(fit: Fit, prior: Prior | None = None) -> Candidate:
    """What a fit leaves, and its criterion: the share of a prior belongs to it, and what rests say (fit/record.py)."""
    record = fit.misfit.record
    left = colour(record.pv - fit.explained, record.resolution, fit.misfit.most_order)
    known = 0.0 if prior is None else float(np.sum(prior.residuals(fit.x) ** 2))
    price = BARRED * loads_at(fit, record.barred_s) if record.barred_s else 0.0
    weighed = criterion(left, len(record.pv), fit.misfit.unknowns, MODEL_ERROR * record.pv_range)
    rare = RARE.get(fit.misfit.type, 0.0)
    return Candidate(fit, left, weighed + known + price + rare + _at_rest(fit))


def _at_rest(fit: Fit) -> float:
    """What the rests before and after setpoint changes say against a fit; of a valve's output they say nothing."""
    misfit = fit.misfit
    rests = misfit.record.rests if misfit.co is None else ()
    return sum((rest.cost(misfit.type, fit.x, misfit.sign) for rest in rests), 0.0)


def load_price(misfit: Misfit) -> float:
    """What one load step more costs in the criterion of a record."""
    return LOAD_COST * math.log(len(misfit.record.pv))


def loads_at(fit: Fit, changes_s: tuple[float, ...]) -> int:
    """How many load steps of a fit stand at setpoint changes. changes_s : in record time."""
    record, times = fit.misfit.record, np.array(fit.load_times_s)
    found = are_coincident(fit.misfit.type, fit.x, times, changes_s, record.span_s, record.sample_time_s)
    return int(np.sum(found))


class CandidateList:
    """All candidates that were tried."""

    def __init__(self, rivals: list[Candidate]) -> None:
        self._all = list(rivals)

    def add(self, candidate: Candidate) -> None:
        """Take note of one."""
        self._all.append(candidate)

    def best(self, type_: ProcessType | None = None, sign: int | None = None) -> Candidate:
        """The best, of a structure and sign if given."""
        return min(
            (c for c in self._all if type_ in {None, c.fit.misfit.type} and sign in {None, c.fit.misfit.sign}),
            key=lambda c: c.criterion,
        )

    def by_loads(self, type_: ProcessType, sign: int, most: int, *, plain: bool = False) -> list[Candidate]:
        """The best of a structure and sign with 0, 1, ... load steps, up to `most` of them; those that were tried.

        plain : of those whose loads are steps at once, without a drift beside them.
        """
        of = sorted((c for c in self._all if not plain or c.is_plain), key=lambda c: -c.criterion)
        found = {c.fit.misfit.loads: c for c in of if (c.fit.misfit.type, c.fit.misfit.sign) == (type_, sign)}
        return [found[loads] for loads in sorted(found) if loads <= most]

    def ranked(self, close: float) -> list[Candidate]:
        """The best of every structure in order, then all others within `close` of the winner."""
        order = sorted(self._all, key=lambda c: c.criterion)
        firsts, others = [], []
        types: set[ProcessType] = set()
        for c in order:
            if c.fit.misfit.sign == order[0].fit.misfit.sign and c.fit.misfit.type not in types:
                types.add(c.fit.misfit.type)
                firsts.append(c)
            elif c.criterion < order[0].criterion + close:
                others.append(c)
        return [*firsts, *others]


# A fit repeated with what is known already as a prior: the iterated extended Kalman update (Bell & Cathey 1993).
#
#     minimise  |r(p)|^2 + |root x - target|^2
#
# The configuration (loads, drift, whitening) is that of the record's own fit. With the prior in it from the beginning,
# a record of another process would have its misfit whitened away instead of being found odd. But where its loads came,
# what is known may tell better: as many are looked for once more, beside the process that is known. One is, where no
# setpoint changed: a loop at rest does not move by itself, so a load costs nothing there. Without it a state that was
# not rest and a long dead time stood in for a small load, and five such records moved a gain that was known by half.


Priors = Mapping[ProcessType, Prior]


def with_priors(
    found: list[Candidate], priors: Priors, inflation: Callable[[Fit], float] | None = None, least_loads: int = 0
) -> list[Candidate]:
    """The candidates of structures with a prior, refitted with it, best first.

    least_loads : load steps that the record needs at least: one where nothing else can have moved a loop at rest.
    inflation : factor by which a fit's residuals count for less than their number (correlated, or unexplained): what a
        structure does not explain must not outvote what is known.
    """
    again = {
        c: with_prior(c, priors[c.fit.misfit.type], 1.0 if inflation is None else inflation(c.fit), least_loads)
        for c in dict.fromkeys(found)  # one may have been found on two ways
        if c.fit.misfit.type in priors
    }
    return sorted((again[c] for c in found if c in again), key=lambda c: c.criterion)


def with_prior(alone: Candidate, prior: Prior, inflation: float = 1.0, least_loads: int = 0) -> Candidate:
    """One fit, started from its own optimum and from the prior's; from that also with the loads that it asks for.

    least_loads : see with_priors; what has fewer is compared as if it had paid for them.
    """
    misfit, p = replace(alone.fit.misfit, sigma=alone.fit.misfit.sigma * inflation), alone.fit.p
    size, mean = SIZE[misfit.type], prior.mean
    starts = [(misfit, p), (misfit, np.concatenate([mean, p[size:]]))]
    loads = max(misfit.loads, least_loads)
    if loads and not misfit.harmonics:
        other = replace(misfit, loads=loads, rounded=False, corners=0, ramp=False)
        times = load_times(other, mean, loads)
        if len(times) == loads:
            starts.append((other, np.concatenate([mean, times])))
    fits = (refine(of, start, prior, enough=EXACT) for of, start in starts)
    missing = load_price(misfit)
    return min(
        (judged(fit, prior) for fit in fits),
        key=lambda c: c.criterion + missing * max(least_loads - c.fit.misfit.loads, 0),
    )
