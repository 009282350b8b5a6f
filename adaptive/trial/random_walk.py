"""May a load that wanders be behind what speaks against a set? Both explanations are asked of the same samples.

    pv = G co + G d + n,    d a random walk, n white;    deviance = -2 ln(likelihood), restricted to what d and the
                                                         states at the start of a stretch leave open

A fit that knows load steps and white noise only takes a wandering load for the process, and is too sure of it. Here
the best process on which the tried set is robust is held against the best of all. Where it explains the samples as
well, to within level standard deviations, they say nothing against the set. That load is the null hypothesis only
where it was seen before the change (load_variability.py).

The samples come in stretches of equal length, each with a start of its own, so that one eigenvalue decomposition of
the walk's covariance serves all. The size of the walk over the noise is taken where the likelihood is largest, a
value of RATIOS; the noise is what is left (Patterson & Thompson 1971, restricted likelihood).
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType, exponentials, state_space
from retuner.adaptive.signals.sample import FloatArray, LoopSample, median
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, StillAllowed
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

LONGEST = 2.5  # dead time over that of the first model, up to which models are asked
SAMPLES = 120  # samples of a stretch, at the most
STRETCHES = 8  # stretches at the most, the newest ones
PER_DEAD_TIME = 4.0  # samples to an effective dead time that are kept of faster ones
FEWEST_SAMPLES = 40  # samples of a stretch without which nothing is said
GAP = 5.0  # sampling intervals without a sample, after which the samples begin anew
RATIOS = np.logspace(-4.0, 8.0, 25)  # variance that a step of the walk brings to pv over that of the noise, as tried
STEPS = (0.4, 0.2, 0.1, 0.05)  # steps of the search, in logarithms of gain, lag and dead time
LESS = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2)  # shares of a model's gain from which the search for a robust one starts


@dataclass(frozen=True, slots=True)
class Stretches:
    """Samples at equal distances: pv and co of shape (stretches, n); dt_s between two of them.

    skipped : samples at the start of each that what co was before still moves; the same for every model.
    """

    dt_s: float
    pv: FloatArray
    co: FloatArray
    skipped: int


def stretches_of(samples: Sequence[LoopSample], theta_s: float) -> Stretches | None:
    """The samples as equal stretches; None where they are too few. theta_s : effective dead time of the process."""
    if len(samples) < FEWEST_SAMPLES:
        return None
    t, pv, co = (np.array([sample[i] for sample in samples]) for i in (0, 2, 3))
    every = median(np.diff(t))
    since = np.flatnonzero(np.diff(t) > GAP * every)
    if since.size:
        t, pv, co = (values[since[-1] + 1 :] for values in (t, pv, co))
    dt_s = every * max(math.floor(theta_s / PER_DEAD_TIME / every), 1)
    n = int((t[-1] - t[0]) / dt_s)
    count = min(max(round(n / SAMPLES), 1), STRETCHES)
    length = min(n // count, SAMPLES)
    if length < FEWEST_SAMPLES:
        return None
    edges = t[-1] + every - dt_s * np.arange(count * length, -1, -1)
    moved = np.concatenate([[0.0], np.cumsum(co * np.diff(t, append=t[-1] + every))])
    means = np.diff(np.interp(edges, np.append(t, t[-1] + every), moved)) / dt_s
    at = np.interp(edges[:-1], t, pv)
    skipped = min(math.ceil(LONGEST * theta_s / dt_s), length // 3)
    return Stretches(dt_s, at.reshape(count, length), means.reshape(count, length), skipped)


def deviance(process: LinearProcess, seen: Stretches) -> float:
    """Deviance of the samples on one process with a load that walks; infinite where arithmetic fails."""
    n = seen.pv.shape[1]
    late, prompt, free = _responses(process, n, seen.dt_s)
    first = seen.skipped
    if process.theta_s > first * seen.dt_s:
        return math.inf
    at = np.arange(n)
    lag = at[:, None] - at[None, :]
    walks = np.where(lag >= 0, prompt[np.maximum(lag, 0)], 0.0)[first:, 1:]
    steps = np.diff(seen.co, axis=1, prepend=seen.co[:, :1])
    moved = np.where(lag >= 0, late[np.maximum(lag, 0)], 0.0) @ steps.T
    left = (seen.pv.T - moved)[first:]
    start = np.column_stack([free, prompt])[first:]
    if not (np.all(np.isfinite(left)) and np.all(np.isfinite(start)) and np.all(np.isfinite(walks))):
        return math.inf
    size = float(np.mean(walks[-1] ** 2)) or 1.0
    values, vectors = np.linalg.eigh(walks @ walks.T / size)
    basis = np.linalg.qr(start / np.maximum(np.linalg.norm(start, axis=0), 1e-300))[0]
    return min(_at(ratio, np.maximum(values, 0.0), vectors.T @ left, vectors.T @ basis) for ratio in RATIOS)


def _at(ratio: float, values: FloatArray, left: FloatArray, start: FloatArray) -> float:
    """The deviance for one size of the walk, in the coordinates of its covariance."""
    variance = ratio * values + 1.0
    white = 1 / np.sqrt(variance)
    columns, rows = start * white[:, None], left * white[:, None]
    q, r = np.linalg.qr(columns)
    rest = rows - q @ (q.T @ rows)
    count = int(left.shape[1])
    free = count * int(left.shape[0] - start.shape[1])
    size = np.abs(np.diag(r))
    if not free or not np.all(size > 0):
        return math.inf
    square = float(np.sum(rest * rest)) / free
    if not square > 0:
        return math.inf
    spread = float(np.sum(np.log(variance))) + 2 * float(np.sum(np.log(size)))
    return free * math.log(square) + count * spread


def _responses(process: LinearProcess, n: int, dt_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Responses of pv to a step with the dead time and without, shape (n,), and from each state, (n, states)."""
    space = state_space(process, dt_s)
    m = len(space.b)
    whole = np.zeros((m + 1, m + 1))
    whole[:m, :m], whole[:m, m] = space.a, space.b
    dead = process.theta_s / dt_s
    part = math.ceil(dead) - dead
    # exp(A) of states with a held input, over a whole step and over a part of it
    moved, begun = exponentials(np.array([whole, whole * part]))
    late, prompt, free = np.zeros(n), np.zeros(n), np.zeros((n, m))
    x, y, row = begun[:m, m], np.zeros(m), space.c.copy()
    first = math.ceil(dead)
    for i in range(n):
        prompt[i] = space.c @ y
        free[i] = row
        if i >= first:
            late[i] = space.c @ x
            x = moved[:m, :m] @ x + moved[:m, m]
        y = moved[:m, :m] @ y + moved[:m, m]
        row = row @ moved[:m, :m]
    return late, prompt, free


def beside_a_walk(
    samples: Sequence[LoopSample],
    models: Sequence[ProcessModel],
    tried: PidGains,
    sample_time_s: float,
    filter_s: float,
    harmless_ms: float,
    level: float,
) -> StillAllowed | None:
    """What samples leave of the process, under a load that wanders: nothing where one on which `tried` is robust
    explains them as well as any, else the one that explains them best. None where they are too few.

    Where no model speaks against it, those for which it was made begin the search: they are no witnesses for it.

    samples : of any gains, the newest last. models : what speaks against it, the best one first; may be none.
    harmless_ms : Ms up to which a set counts as robust. level : standard deviations.
    """
    by_rule = made_for(tried)
    asked = list(models[:MOST_MODELS]) or by_rule
    seen = stretches_of(samples, asked[len(asked) // 2].theta_s) if asked else None
    if seen is None:
        return None

    def sampled(model: ProcessModel) -> LinearProcess:
        return model.seen_by_controller(sample_time_s).linear()

    def robust(model: ProcessModel) -> bool:
        return sensitivity_peak(sampled(model), tried, filter_s) <= harmless_ms

    best = min(asked, key=lambda model: deviance(model.linear(), seen))
    free, least = (best, -math.inf) if models and robust(best) else _searched(best, seen, lambda _: True)
    if robust(free):
        return NOTHING_KNOWN
    enough = least + level**2
    weaker = ([replace(near, k=share * near.k) for share in LESS] for near in (free, best))
    starts = [next(filter(robust, models), None) for models in weaker]
    starts.append(min(filter(robust, by_rule), key=lambda model: deviance(model.linear(), seen), default=None))
    as_well = any(_searched(start, seen, robust, enough)[1] <= enough for start in starts if start is not None)
    return NOTHING_KNOWN if as_well else StillAllowed((sampled(free),), filter_s)


def made_for(gains: PidGains) -> list[ProcessModel]:
    """Processes for which SIMC gives these gains (Skogestad 2003, table 1), of several dead times."""
    if not (gains.kp and gains.ki):
        return []
    tau_i = gains.kp / gains.ki
    return [
        ProcessModel(ProcessType.FOPDT, tau_i / (2 * share * tau_i * gains.kp), tau_i, 0.0, share * tau_i)
        for share in SHARES
    ]


SHARES = (0.06, 0.125, 0.25, 0.5, 1.0)  # dead times over tau_I for which SIMC's tau_I is the lag, and some longer ones
LOST_LOG_GAIN = 3.0  # logarithm of the gain from which a search has lost its way
MOST_MODELS = 5  # models that are asked which of them explains the samples best


def _searched(
    start: ProcessModel, seen: Stretches, allowed: Callable[[ProcessModel], bool], enough: float = -math.inf
) -> tuple[ProcessModel, float]:
    """The model of least deviance near `start` among those allowed, one number at a time; ends once it is `enough`."""
    best, least = start, deviance(start.linear(), seen)
    for step in STEPS:
        better = True
        while better and least > enough and abs(math.log(best.k / start.k)) < LOST_LOG_GAIN:
            better = False
            for near in _near(best, step):
                if not allowed(near):
                    continue
                found = deviance(near.linear(), seen)
                if found < least - 1e-6:
                    best, least, better = near, found, True
    return best, least


def _near(model: ProcessModel, step: float) -> list[ProcessModel]:
    """One number larger or smaller: gain, dead time, lags with the gain and without."""
    found = []
    for factor in (math.exp(step), math.exp(-step)):
        tau1_s, tau2_s, tau3_s = (factor * lag for lag in (model.tau1_s, model.tau2_s, model.tau3_s))
        slower = replace(model, tau1_s=tau1_s, tau2_s=tau2_s, tau3_s=tau3_s)
        found += [
            replace(model, k=factor * model.k),
            replace(model, theta_s=factor * model.theta_s),
            slower,
            replace(slower, k=factor * model.k),
        ]
    return [one for one in found if one != model]
