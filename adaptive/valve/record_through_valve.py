"""A valve between co and the process: what co does after a setpoint step, and what reaches the process.

    pv = G v(co) + the rest of a fit        against        pv = G co + the rest of a fit

with v a valve that sticks or has play (valve_model.py). Such a valve does not take part in the first of co's travel
and keeps its place when co turns. A linear fit makes of that what it has: a gain too small where the valve keeps back
what co adds, a lag or loads where it slips late, an integrator where co goes on and pv does not. So the settings come
out wrong, with a covariance that says otherwise. In the fit, the valve is one more nuisance with a price, as a load is.

    coarse    bands, jumps and starts on a grid, with lags and dead times round those of the linear explanation, and
              with its own processes without their loads
    refined   the best of each valley, with the process
    searched  the record of the valve's position as any other record, in every structure with loads; the valve is then
              refined round that, and so on while it helps

It is believed where it beats the linear explanation by its price, 3 ln n for band, jump and start, and by a clear lead,
and takes the place of loads: one that needs more of them explains a load that wanders. It is asked only where the
linear explanation needs loads, a drift or a filter: white remainders leave it nothing.
"""

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from retuner.adaptive.fit.record import Record, setpoint_changes
from retuner.adaptive.fit.refine import refine
from retuner.adaptive.identification.candidate import Candidate
from retuner.adaptive.identification.identify import Fits, FitSettings
from retuner.adaptive.rules.simc import without_second_lag
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.valve_fit import (
    JUMP_SHARES,
    MOST_ROWS,
    POLISHED,
    Nodes,
    Sticking,
    bare,
    explained,
    fine,
    refined,
    settled,
    valleys,
    valve_costs,
    with_lag,
)
from retuner.adaptive.valve.valve_model import StuckValve
from retuner.schedule.late_dataclass import dataclass, replace

BANDS = tuple(np.geomspace(0.02, 0.7, 20).tolist())  # stick bands tried, as shares of co's range
STARTS = tuple(np.linspace(-1.0, 1.0, 9).tolist())  # where the valve may stand in its band when the record begins
LAGS, SECOND_LAG = (0.5, 1.5, 4.0, 10.0), 0.6
"""Lags tried, and a second one beside those that are longer, in effective dead times of the linear explanation."""
THETAS = (0.1, 0.35, 0.7, 1.1)  # dead times tried, in the same unit
LINEAR = 3
"""Linear explanations that tell how fast the process is; of the first two the processes are tried as they are."""
OWN, OWN_VALLEYS = 2, 4
VALVE_UNKNOWNS = 3  # Band, jump, and where the valve stood
LOADS_BESIDE = 1  # loads that it may need where the linear explanation needs fewer
MOST_SEARCH_ROUNDS = 3  # rounds of search and refinement of the valve
LEAST_FALL = 0.5  # A round must lower the criterion by this


@dataclass(frozen=True, slots=True)
class ValveInLoop:
    """What stands between co and the process. left : what the linear explanation leaves, over the noise of pv."""

    valve: StuckValve
    left: float

    @property
    def sentence(self) -> str:
        """The valve in a sentence for people."""
        return (
            f"co reaches the process through a valve with a stiction band of {self.valve.stick:.3g} of co, "
            f"slip jump {self.valve.jump:.3g}"
        )


@dataclass(frozen=True, slots=True)
class RecordThroughValve:
    """A record seen through a valve. window : with the valve's position for co. fits : of it."""

    seen: ValveInLoop
    window: Window
    fits: Fits


def valve_believed(window: Window, sign: int, fits: Fits, settings: FitSettings) -> RecordThroughValve | None:
    """The record as the process sees it, where a valve that sticks or has play explains it clearly better.

    window : the record. sign : of the process gain. fits : the linear explanations.
    """
    linear = fits.free[0]
    misfit, record = linear.fit.misfit, linear.fit.misfit.record
    if not setpoint_changes(window) or not (misfit.loads or misfit.ramp or misfit.corners or linear.colour.ar):
        return None  # the linear explanation needs no more than its process
    valves = []
    for share, (family, jumps) in product(BANDS, JUMP_SHARES.items()):
        band = share * record.co_range
        valves += [StuckValve(family, band, jump * share * record.co_range, at) for jump, at in product(jumps, STARTS)]
    tried = list(_by_nodes(record, sign, valves, fits.free))
    for candidate in fits.free[:OWN]:  # the best of each valley with that process, its loads left out
        alone, x = bare(candidate.fit.misfit, candidate.fit.misfit.type), candidate.fit.x
        best = valleys(valves, np.array(valve_costs(refine(alone, x), valves)))[:OWN_VALLEYS]
        tried += [fine(refined(alone, valves[i], x)) for i in best]
    closest = sorted(tried, key=lambda s: s.fit.criterion)[:POLISHED]
    at = min((settled(s) for s in closest), key=lambda s: s.fit.criterion, default=None)
    searched = _searched(window, sign, at, settings) if at is not None else None
    if searched is None:
        return None
    valve, found = searched
    behind = found.free[0]
    price = VALVE_UNKNOWNS * math.log(len(record.pv)) + settings.valve_lead
    if behind.criterion + price > linear.criterion:
        return None
    if behind.fit.misfit.loads > max(linear.fit.misfit.loads, LOADS_BESIDE):
        return None
    left = float(np.std(record.pv - linear.fit.explained)) / record.noise_std
    return RecordThroughValve(ValveInLoop(valve, left), _moved_by(window, valve), found)


def _moved_by(window: Window, valve: StuckValve) -> Window:
    return replace(window, co=valve.position(window.co))


def _searched(window: Window, sign: int, at: Sticking, settings: FitSettings) -> tuple[StuckValve, Fits] | None:
    """All structures behind the valve, and the valve refined round the best of them, while it helps; None where it
    never moves, so that nothing behind it can be fitted.
    """
    record, valve = at.fit.fit.misfit.record, at.valve
    best: tuple[StuckValve, Fits] | None = None
    for _ in range(MOST_SEARCH_ROUNDS):
        seen = _moved_by(window, valve)
        if seen.co.max() == seen.co.min():
            break
        fits = Fits(seen, (sign,), settings)
        found = fits.free[0]
        if best is not None and found.criterion > best[1].free[0].criterion - LEAST_FALL:
            break
        best = valve, fits
        as_recorded = replace(found.fit, misfit=replace(found.fit.misfit, record=record))
        valve = fine(Sticking(valve, replace(found, fit=as_recorded))).valve
    return best


def _by_nodes(record: Record, sign: int, valves: list[StuckValve], linear: list[Candidate]) -> Iterator[Sticking]:
    """The best of each valley with one lag or two."""
    # Lags and dead times round those of the linear explanations
    models = [c.model for c in linear[:LINEAR]]
    theta = float(np.exp(np.mean([math.log(without_second_lag(model).theta_s) for model in models])))
    lags = [min(factor * theta, record.span_s) for factor in LAGS]
    pairs = [(lag, 0.0) for lag in lags] + [(lag, SECOND_LAG * theta) for lag in lags[1:]]
    rows = slice(0, None, -(-len(record.pv) // MOST_ROWS))
    nodes = Nodes.made(record, rows, pairs, [factor * theta for factor in THETAS])
    left, gain = explained(record, sign, valves, nodes)
    node = np.argmin(left, axis=1)
    for i in valleys(valves, np.min(left, axis=1)):
        type_, x = nodes.started(int(node[i]), float(gain[i, node[i]]))
        yield with_lag(fine(refined(bare(linear[0].fit.misfit, type_), valves[i], x)))
