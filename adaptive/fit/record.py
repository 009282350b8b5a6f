"""A record made ready for fitting: its own clock from zero, its noise, its scale, and where its time has gaps."""

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from retuner.adaptive.fit.dynamics import SamplingInstants
from retuner.adaptive.fit.structure import LAG, SECOND, SLOPE, THETA
from retuner.adaptive.indexes.recording_quality import hidden_sigma
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.signals.noise import noise_sigma, quantum_sigma
from retuner.adaptive.signals.sample import FloatArray, Window, median
from retuner.schedule.late_dataclass import dataclass

# ---- Load steps that stand where a setpoint change could have done it, and the model without them.
#
# A load step bought exactly at a setpoint change explains the closed loop's response to it, and leaves the process
# free to become a fiction: dead times of minutes in flow loops, each variant sure of itself. What a record says of
# its process counts only where a model without such loads says the same:
#
#     coincident    s_j in [t_k - max(3 Ts, T*/2), t_k + theta + max(3 Ts, T*)],   T* = min(T, 5 % of the record)
#                   t_k a setpoint change, T the sum of the lags; four times the lag where the process also integrates
#     apart         D = max(|ln kp1/kp2|, |ln ki1/ki2|, |ln theta_e1/theta_e2| / 1.4),   theta_e = theta + tau2/2 + Ts/2
#                   kp and ki of the settings that follow
#
# A long dead time widens its own interval, so a fiction cannot move its loads out of it. Which of the two models is
# right the record does not say: true loads that fall together with a setpoint change look the same.

LEAST_CHANGE, LEAST_SIGMAS = 0.02, 2.0
"""A setpoint change counts from this share of pv's range, and from so many standard deviations of its noise."""
MOST_CHANGES = 0.1
"""A setpoint that changes in a larger share of the samples moves all the time: there are no instants to stand at."""
NEAR_SAMPLES = 3.0  # sampling intervals round a setpoint change that are as good as the change itself
LONGEST_LAG = 0.05  # lags count up to this share of the record, or the interval would cover all of it
LAG_OF_INTEGRATOR = 4.0
"""The lag of an integrating process counts so many times: its closed loop answers that much later."""
SLACK_OF_TIMES = 1.4  # dead times are known less well than gains: their ratio counts by this much less


def setpoint_changes(window: Window) -> tuple[float, ...]:
    """Instants of the setpoint changes, s from the window's first sample."""
    steps = np.diff(window.sp)
    changed = steps != 0
    if np.mean(changed) > MOST_CHANGES:
        return ()
    least = max(LEAST_CHANGE * float(np.ptp(window.pv)), LEAST_SIGMAS * noise_sigma(window.pv))
    at = np.flatnonzero(np.abs(steps) > least) + 1
    return tuple((window.t_s[at] - window.t_s[0]).tolist())


def are_coincident(
    type_: ProcessType, x: FloatArray, instants_s: FloatArray, changes_s: tuple[float, ...], span_s: float, dt_s: float
) -> npt.NDArray[np.bool_]:
    """Which of the instants stand at a setpoint change.

    type_, x : structure and parameters of the process. instants_s : of load steps. changes_s : of the setpoint.
    span_s, dt_s : length and sampling interval of the record.
    """
    if type_ in LAG:
        lag = math.exp(x[LAG[type_]])
    else:
        lag = LAG_OF_INTEGRATOR * math.exp(x[SECOND[type_]]) if type_ in SECOND else 0.0
    return near(instants_s, changes_s, min(lag, LONGEST_LAG * span_s), math.exp(x[THETA]), dt_s)


def near(
    instants_s: FloatArray, changes_s: tuple[float, ...], lag_s: float, theta_s: float, dt_s: float
) -> npt.NDArray[np.bool_]:
    """Which of the instants lie within the interval round a setpoint change, see the head of this file."""
    before = max(NEAR_SAMPLES * dt_s, lag_s / 2)
    after = theta_s + max(NEAR_SAMPLES * dt_s, lag_s)
    since = np.asarray(instants_s)[..., None] - np.asarray(changes_s)
    inside: npt.NDArray[np.bool_] = ((since >= -before) & (since <= after)).any(axis=-1)
    return inside


def apart(one: ProcessModel, other: ProcessModel, dt_s: float) -> float:
    """D: how far the settings and the dead times of two models lie apart, as a logarithm; infinite for opposite signs.

    dt_s : sampling interval, half of which counts as dead time.
    """
    first, second = (without_second_lag(model).seen_by_controller(dt_s) for model in (one, other))
    ratios = [
        first.theta_s / second.theta_s,
        *(getattr(simc(first).gains, g) / getattr(simc(second).gains, g) for g in ("kp", "ki")),
    ]
    if min(ratios) <= 0:
        return math.inf
    times, *gains = (abs(math.log(ratio)) for ratio in ratios)
    return max(times / SLACK_OF_TIMES, *gains)


# ---- What pv and co at rest, before and after a setpoint change, say of the gain.
#
#     r = (co2 - co1) / (pv2 - pv1)      1/k of a process with a gain, 0 of an integrating one, whatever its lags are
#
# That holds but for one case: a load came in between, and stayed. A fit with load steps is free to invent one. It
# then hides what its structure lacks, and the gain follows. So r is a measurement with two explanations, and the
# criterion of every fit counts how likely it makes r:
#
#     -2 ln [(1 - q) N(r; 1/k, s^2) + q N(r; 1/k, s^2 + L^2)]
#
# q is the probability of such a load; L is its size, as large as co moved in the record. A load that the record shows
# outvotes it: the second term limits what r can cost.

LOADED = 0.05  # probability that a load came between the two rests, and stayed
INEXACT = 0.05  # A gain is not the same at two places: s is at least this share of r
LEAST_SAMPLES = 8  # A shorter stretch is no rest
REST_SHARE = 0.25  # last part of the time until the next change that is taken for the rest
DRIFTS_ON = 2.0
"""What a stretch moves from its first half to its second counts so many times: it has not come to its end."""


@dataclass(frozen=True, slots=True)
class RestRatio:
    """co over pv from rest to rest, co units per pv unit. std : of it. most : L, what a load may add to it."""

    ratio: float
    std: float
    most: float

    def cost(self, type_: ProcessType, x: FloatArray, sign: int) -> float:
        """-2 ln of how likely a process with the parameters x makes it, over the most that any can."""
        inverse = sign * math.exp(-x[SLOPE] - x[LAG[type_]]) if type_ in LAG else 0.0
        off = (self.ratio - inverse) ** 2
        one, other = self.std**2, self.std**2 + self.most**2
        share = LOADED / (1 - LOADED) * math.sqrt(one / other)
        likely = math.exp(-off / (2 * one)) + share * math.exp(-off / (2 * other))
        return 2 * (math.log1p(share) - math.log(max(likely, np.finfo(np.float64).tiny)))


def rest_ratios(window: Window) -> tuple[RestRatio, ...]:
    """The ratio at every setpoint change between two rests."""
    since = window.t_s - window.t_s[0]
    places = [int(np.searchsorted(since, change_s)) for change_s in setpoint_changes(window)]
    starts, ends = [0, *places], [*places, len(window.t_s)]
    rests = [_Rest.of(window, a, b) for a, b in zip(starts, ends, strict=True)]
    found = (_ratio(one, other, window) for one, other in pairwise(rests))
    return tuple(ratio for ratio in found if ratio is not None)


@dataclass(frozen=True, slots=True)
class _Rest:
    """Means of pv and co over a stretch, with their standard deviations."""

    pv: float
    co: float
    pv_std: float
    co_std: float

    @classmethod
    def of(cls, window: Window, first: int, end: int) -> "_Rest | None":
        """The last part of a stretch between two setpoint changes; None where it is too short."""
        n = max(int(REST_SHARE * (end - first)), LEAST_SAMPLES)
        if end - first < n:
            return None
        pv, co = (_mean(values[end - n : end]) for values in (window.pv, window.co))
        return cls(pv[0], co[0], pv[1], co[1])


def _mean(values: FloatArray) -> tuple[float, float]:
    """A mean with its standard deviation: of the noise, and of what still moves."""
    half = len(values) // 2
    moves = float(np.mean(values[half:]) - np.mean(values[:half]))
    return float(np.mean(values)), math.hypot(DRIFTS_ON * moves, noise_sigma(values) / math.sqrt(len(values)))


def _ratio(one: _Rest | None, other: _Rest | None, window: Window) -> RestRatio | None:
    """The ratio between two rests; None where pv did not go anywhere."""
    if one is None or other is None:
        return None
    pv, pv_std = other.pv - one.pv, math.hypot(one.pv_std, other.pv_std)
    if abs(pv) <= DRIFTS_ON * pv_std:
        return None
    ratio, most = (other.co - one.co) / pv, float(np.ptp(window.co)) / abs(pv)
    std = math.hypot(math.hypot(one.co_std, other.co_std) / pv, ratio * math.hypot(pv_std / pv, INEXACT))
    return RestRatio(ratio, std, most) if std > 0 and most > 0 else None


# ---- A record made ready for fitting

GAP = 3.5  # an interval this many times the usual one is a gap: what co did meanwhile is not known
MOST_GAPS = 4  # more gaps than this are no longer bridged by a state of their own each; the longest are
START_SAMPLES, START_SHARE = 6, 50
"""The start is this many samples, or one part in so many of the record, whichever is more."""
LEAST_MOTION = 0.003  # A start that moves by less than this share of pv's range is rest
MOTION_REACH = 5.0  # the unknown time before the record may have moved so many times as much as the start
LEAST_NOISE = 1e-6
"""A record without noise is fitted to this share of pv's range: finer than any instrument, coarser than rounding."""


@dataclass(frozen=True, slots=True)
class Record:
    """What a fit needs of a record.

    t_s, pv, co : shape (n,), t_s from zero. co is counted from its first value.
    clock : the instants. sample_time_s : median interval. span_s : length.
    noise_std : standard deviation of the noise on pv by itself, pv units. resolution : nothing finer than this is in pv
        (a share of its range, or its quantum), as a standard deviation. pv_range, co_range : largest minus smallest.
    gaps_s : instants at which a gap in time ends. motion_at_start : how much pv moves at once when the record begins,
        as a share of its range: 0 from rest. The co of the time before the record will have moved as much, and no more.
    barred_s : setpoint changes at which no load step is to stand (see above), from zero.
    rests : co over pv from rest to rest (see above). logged_s : median interval before the record was condensed.
    """

    pv: FloatArray
    co: FloatArray
    clock: SamplingInstants
    sample_time_s: float
    span_s: float
    noise_std: float
    resolution: float
    pv_range: float
    co_range: float
    gaps_s: tuple[float, ...]
    motion_at_start: float
    barred_s: tuple[float, ...] = ()
    rests: tuple[RestRatio, ...] = ()
    logged_s: float = 0.0

    @classmethod
    def of(cls, window: Window, most_samples: int | None = None) -> "Record":
        """Prepare a window, condensed to most_samples."""
        return _prepared(window.content, most_samples)

    @property
    def t_s(self) -> FloatArray:
        """Sampling instants from zero, shape (n,)."""
        return self.clock.t_s


@lru_cache(maxsize=16)  # a record is made ready for each question that is asked of it
def _prepared(content: tuple[tuple[bytes, ...], float], most_samples: int | None) -> Record:
    window = Window.holding(content)
    hidden, rests, logged_s = hidden_sigma(window.pv), rest_ratios(window), window.sample_time_s
    window = window if most_samples is None else window.condensed(most_samples)
    t = window.t_s - window.t_s[0]  # seconds since 1970 leave too few digits for derivatives by the dead time
    pv_range = float(np.ptp(window.pv))
    resolution = max(quantum_sigma(window.pv), hidden, LEAST_NOISE * pv_range)
    noise = max(noise_sigma(window.pv), resolution, window.noise_std)
    lengths = np.diff(t)
    longest = np.argsort(-lengths, kind="stable")[:MOST_GAPS].tolist()
    # Travel of pv in the first samples beyond its noise, as a share of its range, and somewhat more
    m = min(max(START_SAMPLES, len(window.pv) // START_SHARE), len(window.pv))
    share = (abs(median(window.pv[m - 3 : m]) - median(window.pv[:3])) - 2 * noise) / (pv_range or 1.0)
    return Record(
        np.ascontiguousarray(window.pv),
        window.co - window.co[0],
        SamplingInstants.of(t),
        dt := window.sample_time_s,
        float(t[-1]),
        noise,
        resolution,
        pv_range,
        float(np.ptp(window.co)),
        tuple(float(t[i + 1]) for i in sorted(longest) if lengths[i] > GAP * dt),
        min(MOTION_REACH * share, 1.0) if share > LEAST_MOTION else 0.0,
        rests=rests,
        logged_s=logged_s,
    )
