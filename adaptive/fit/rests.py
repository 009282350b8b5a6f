"""What pv and co at rest, before and after a setpoint change, say of the gain.

    r = (co2 - co1) / (pv2 - pv1)      1/k of a process with a gain, 0 of an integrating one, whatever its lags are

That holds but for one case: a load came in between, and stayed. A fit with load steps is free to invent one. It then
hides what its structure lacks, and the gain follows. So r is a measurement with two explanations, and the criterion of
every fit counts how likely it makes r:

    -2 ln [(1 - q) N(r; 1/k, s^2) + q N(r; 1/k, s^2 + L^2)]

q is the probability of such a load; L is its size, as large as co moved in the record. A load that the record shows
outvotes it: the second term limits what r can cost.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from retuner.adaptive.fit.coincident_loads import setpoint_changes
from retuner.adaptive.fit.structure import LAG, SLOPE
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

LOADED = 0.05
"""Probability that a load came between the two rests, and stayed."""
INEXACT = 0.05
"""A gain is not the same at two places: s is at least this share of r."""
LEAST_SAMPLES = 8
"""A shorter stretch is no rest."""
REST_SHARE = 0.25
"""Of the time until the next change: the last part of it is taken for the rest."""
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
    """Of every setpoint change between two rests."""
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
    """Of two rests; None where pv did not go anywhere."""
    if one is None or other is None:
        return None
    pv, pv_std = other.pv - one.pv, math.hypot(one.pv_std, other.pv_std)
    if abs(pv) <= DRIFTS_ON * pv_std:
        return None
    ratio, most = (other.co - one.co) / pv, float(np.ptp(window.co)) / abs(pv)
    std = math.hypot(math.hypot(one.co_std, other.co_std) / pv, ratio * math.hypot(pv_std / pv, INEXACT))
    return RestRatio(ratio, std, most) if std > 0 and most > 0 else None
