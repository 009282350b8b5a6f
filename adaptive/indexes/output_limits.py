"""How long the controller output stands at its limits.

    share = samples with co at a limit / all samples

Where the limits are not given they are recognised: co stands exactly at the extreme of the record for a stretch of
samples, and not only once, while elsewhere it moves. A controller that stands still anyway shows no limit. Nor does a
hand that holds co: at a limit the error pushes outwards, or comes back once at the end, wound up; in manual it goes as
it likes, and co does not follow.
"""

import numpy as np

from retuner.adaptive.indexes.recording_quality import runs
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass

TOLERANCE = 1e-3  # co counts as at its limit within this share of its range in the record
STRETCH = 5  # samples in a row at the extreme value that make a limit recognised
MOVING = 0.3  # share of the other samples in which co must change for a recognised limit

BACK = 0.75
"""Share of the samples at an extreme in which the error pushes inwards, from which a hand must hold co there."""
REST = 1e-9  # share of the largest error up to which there is none: digits of a double
CROSSINGS = 6.0
"""Times a long stretch in which the error changes its sign, from which the same is so: a wound-up one does so once."""


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


def at_limits(
    co: FloatArray, co_min: float | None = None, co_max: float | None = None, error: FloatArray | None = None
) -> AtLimits:
    """Time at the limits; co of shape (n,), limits in co units (None: recognise it). error : sp - pv, tells a hand."""
    # Which way the controller acts: the sign with which co follows the error in most samples; 0 for neither
    outwards = None if error is None else error * float(np.sign(np.sum(np.sign(np.diff(co) * np.diff(error)))))
    span = float(np.ptp(co))
    shares = []
    for limit, sign in ((co_min, -1.0), (co_max, 1.0)):
        x = sign * co
        if limit is not None:
            reach = TOLERANCE * span
            shares.append(float(np.mean(x >= sign * limit - reach)))
        else:
            shares.append(_recognised(x, None if outwards is None else sign * outwards))
    return AtLimits(shares[0], shares[1], co_min is not None or co_max is not None)


def _recognised(x: FloatArray, push: FloatArray | None) -> float:
    """Share of samples at the upper extreme where it looks like a limit, else 0. push : of the error, outwards."""
    top = x == np.max(x)
    there = runs(top)
    long = [(start, end) for start, end in there if end - start >= STRETCH]
    if push is not None:
        held = np.zeros_like(top)
        for start, end in long:
            held[start:end] = True
        if float(np.mean(np.abs(push[top]) <= REST * np.max(np.abs(push)))) > BACK:
            return 0.0  # nothing pushes
        crossings = int(np.count_nonzero(np.diff(np.sign(push[held]))))
        if float(np.mean(push[top] < 0)) > BACK or crossings > CROSSINGS * max(len(long), 1):
            return 0.0  # a hand holds co at its extreme
    changes, longest = int(np.count_nonzero(np.diff(x))), max(end - start for start, end in there)
    seen = is_limit(len(x), changes, int(np.sum(top)), len(there), len(long), longest)
    return float(np.mean(top)) if seen else 0.0


def is_limit(samples: int, changes: int, at_it: int, stretches: int, long: int, longest: int) -> bool:
    """Whether an extreme of co is a limit.

    samples : of the record. changes : steps in which co changes. at_it : samples at the extreme, in so many stretches.
    long : stretches of STRETCH samples or more. longest : stretch, in samples.
    """
    elsewhere = samples - 1 - (at_it - stretches)
    moving = changes / elsewhere if elsewhere > 0 else 0.0
    return moving > MOVING and (long > 1 or (long == 1 and longest >= 4 * STRETCH))


BETWEEN = 0.03  # share of the samples between two values up to which co knows only these
FEWEST_SWITCHES = 8


def switches_between(co: FloatArray) -> tuple[float, float] | None:
    """The two values between which co of shape (n,) is switched again and again; None where it moves otherwise."""
    low, high = float(np.min(co)), float(np.max(co))
    near = TOLERANCE * (high - low)
    up = co >= high - near
    between = 1 - float(np.mean(up | (co <= low + near)))
    switches = int(np.sum(np.diff(up.astype(np.int8)) != 0))
    return (low, high) if switches >= FEWEST_SWITCHES and between <= BETWEEN else None
