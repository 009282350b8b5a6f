"""How long the controller output stands at its limits.

    share = samples with co at a limit / all samples

Where the limits are not given they are recognised: co stands exactly at the extreme of the record for a stretch of
samples, and not only once, while elsewhere it moves. A controller that stands still anyway shows no limit.
"""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.signals.sample import FloatArray

TOLERANCE = 1e-3
"""co counts as at its limit within this share of its range in the record."""
STRETCH = 5
"""Samples in a row at the extreme value that make a limit recognised."""
MOVING = 0.3
"""Share of the other samples in which co must change for a recognised limit."""


@dataclass(frozen=True, slots=True)
class AtLimits:
    """Shares of the samples at each limit, 0 to 1; given : the limits were told, not recognised."""

    low: float
    high: float
    given: bool

    @property
    def hit(self) -> int:
        """How many of the two limits were touched."""
        return int(self.low > 0) + int(self.high > 0)


def at_limits(co: FloatArray, co_min: float | None = None, co_max: float | None = None) -> AtLimits:
    """Time at the limits; co of shape (n,), limits in co units (None: recognise it)."""
    span = float(np.ptp(co))
    shares = []
    for limit, sign in ((co_min, -1.0), (co_max, 1.0)):
        x = sign * co
        if limit is not None:
            reach = TOLERANCE * span
            shares.append(float(np.mean(x >= sign * limit - reach)))
        else:
            shares.append(_recognised(x))
    return AtLimits(shares[0], shares[1], co_min is not None or co_max is not None)


def _recognised(x: FloatArray) -> float:
    """Share of samples at the upper extreme where it looks like a limit, else 0."""
    top = x == np.max(x)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], top.astype(np.int8), [0]])))
    lengths = edges[1::2] - edges[::2]
    stretches = int(np.sum(lengths >= STRETCH))
    steps = np.diff(x) != 0
    elsewhere = ~(top[1:] & top[:-1])
    moving = float(np.mean(steps[elsewhere])) if np.any(elsewhere) else 0.0
    recognised = moving > MOVING and (stretches > 1 or (stretches == 1 and bool(np.max(lengths) >= 4 * STRETCH)))
    return float(np.mean(top)) if recognised else 0.0
