"""Whether a region's process drifts, by what its last records said of it, and where it is with the next one.

    y_i = m + r (t_i - t_n) / T + walk_i + s_i,   r ~ N(0, DRIFT^2) if it drifts (ODDS before any record), else 0

y is the logarithm of the slope b, or of the dead time, as a record says it given what was known of the rest; T the mean
time from record to record, walk and s as in the filter (kalman.py). What the place in the region does is taken out.
Innovations that all lie on one side are evidence of a drift. The filter takes each for chance: a gain that grew by 8 %
a record was 9 % ahead of it after ten. A drift is no surer than its odds, and goes on for as long as it has been seen.
"""

import math
from functools import lru_cache

import numpy as np

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.schedule_design.record_stretches import SLOPE_STD
from retuner.schedule.late_dataclass import replace

LEAST, ODDS, DRIFT = 4, 1 / 9, 0.1
"""Records that can tell, the odds of a drift before them, and how far a logarithm drifts from one to the next."""
Seen = tuple[float, float, float, float, float]  # a record's time, place on both axes, a logarithm, and its variance


def moved(known: StructureModel, model: RegionModel, elapsed_s: float, walk: float, *, ahead: bool) -> StructureModel:
    """One of a region's structures so much later, as far as slope and dead time drift.

    ahead : at least until the next record. walk : standard deviation of a logarithm from record to record.
    """
    x, p = known.log.x.copy(), known.log.p.copy()
    for i, now in enumerate(model.known[0].log.x[:TOLD]):
        points = (one for one in model.points[-max(model.records, 1) :] if one.told[i:])
        seen = tuple((one.t_s, one.x, one.x2, *one.told[i]) for one in points if one.told[i][1] < UNSURE**2)
        if len(seen) < LEAST or not seen[0][0] < seen[-1][0] <= model.t_s:
            continue
        odds, here, rate, variance, interval_s = _told(seen, walk)
        passed_s = max(elapsed_s, 0.0) + model.t_s - seen[-1][0]
        records = min(max(passed_s / interval_s, float(ahead)), len(seen) - 1.0)
        step = here + rate * records - now
        x[i], p[i, i] = x[i] + odds * step, p[i, i] + odds * ((1.0 - odds) * step**2 + variance * records**2)
    return replace(known, log=replace(known.log, x=x, p=p))


def told(prior: LogModel, posterior: LogModel, scatter: float) -> tuple[tuple[float, float], ...]:
    """What a record said of the logarithms of slope and dead time, and the variances.

    prior, posterior : of the record's process. scatter : of records about their mean.
    """
    known = np.maximum(1.0 / np.diag(posterior.p) - 1.0 / np.diag(prior.p), 1e-6)
    value = (posterior.x / np.diag(posterior.p) - prior.x / np.diag(prior.p)) / known
    return tuple(zip(value[:TOLD].tolist(), (1.0 / known + scatter**2)[:TOLD].tolist(), strict=True))


TOLD = 2  # logarithms that every structure has: of the slope and of the dead time
UNSURE = 0.15  # standard deviation from which a record says next to nothing: a load's dead time is as wrong as unsure


@lru_cache(maxsize=64)
def _told(seen: tuple[Seen, ...], walk: float) -> tuple[float, float, float, float, float]:
    """Probability of a drift; the logarithm at the last record, the drift by record with its variance, the interval."""
    t, x, x2, y, variance = np.array(seen).T
    n, interval_s = len(t), float(t[-1] - t[0]) / (len(t) - 1)
    steps, way = np.minimum.outer(np.arange(n), np.arange(n)), (t - t[-1]) / interval_s
    v = np.diag(variance) + walk**2 * steps
    for place in (x, x2):
        off = place - place.mean()
        v += SLOPE_STD**2 * np.outer(off, off) / max(float(np.max(off**2)), 1e-12)
    scale = 1.0
    for _ in range(2):  # the second time with as much scatter as there is beside the drift
        root = np.linalg.inv(scale * v)
        level = root @ np.ones(n) / np.sum(root)
        clear = root - np.outer(level, root.sum(axis=0))  # the level left open
        a, b = float(way @ clear @ way), float(way @ clear @ y)
        post = 1.0 / (a + DRIFT**-2)
        rate = b * post
        rest = y - rate * way
        scale *= max(float(rest @ clear @ rest) / (n - 2), 1.0)
    log_odds = math.log(ODDS) + 0.5 * (b * rate - math.log(1.0 + DRIFT**2 * a))
    mean = float(level @ rest)
    here = mean + float(walk**2 * steps[-1] @ np.linalg.solve(v, rest - mean))
    return 1.0 / (1.0 + math.exp(-min(log_odds, 50.0))), here, rate, post, interval_s
