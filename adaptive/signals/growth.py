"""Does the loop swing by its own fault? What can be told without a model, from the swing itself.

    grows       half waves of the control error whose heights rise by the same factor each, e^(sigma t): an unstable
                loop. A tone from outside has a height of its own; one that sets in near the loop's resonance rises
                towards it, by less at every half wave; a valve that sticks has its band
    goes on     as many even half waves, of like heights, with no rest between: whatever single responses it is cut into
    at limits   the output goes from limit to limit: an unstable loop is held up there

Such a swing has no other cause to wait for: a verdict of before ("from outside", "unknown") does not stand against it.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.signals.sample import LoopSample, median
from retuner.schedule.late_dataclass import dataclass


@dataclass(frozen=True, slots=True)
class GrowthSettings:
    """When a swing grows."""

    half_waves: int = setting(6, "Half waves in a row that a growing swing shows at least", "4..20", "three cycles")
    most_half_waves: int = setting(
        24, "Half waves that are looked at, the newest", "6..60", "twelve cycles, as for a cause"
    )
    growth: float = setting(1.6, "Growth over them at the least", "1.2..5", "a sensor's noise is a quarter of its band")
    steady: float = setting(
        0.5,
        "Growth, in logarithms, of the later half over that of the earlier",
        "0.2..1",
        "1 for an exponential; 0.2 for a tone that sets in",
    )
    chance: float = setting(
        1e-4,
        "Probability that heights without a trend rise so (Student 1908)",
        "1e-6..0.05",
        "a loop under a tone is looked at some hundred times",
    )
    fewest_before: int = setting(
        3, "Fewest half waves before a growing swing that tell how high it was", "1..10", "a load is one"
    )
    lasting_half_waves: int = setting(
        5, "Half waves in a row, of which a swing goes on, at least", "4..24", "two and a half cycles"
    )
    like: float = setting(
        2.0, "Highest of its half waves over the lowest", "1.2..4", "noise of a quarter of the least height"
    )
    restless: float = setting(
        0.6,
        "Share of its time outside the noise band, at least",
        "0.3..0.9",
        "a sinusoid of twice the band: 0.67; load steps apart rest in between",
    )
    even: float = setting(1.7, "Longest of the half periods over the shortest", "1.1..3", "a linear swing is even")

    def __post_init__(self) -> None:
        require_in_range(self, "growth")


class HalfWave(NamedTuple):
    """A half wave of the control error: time of its extreme, s, and how high that is, pv units."""

    t_s: float
    height: float


class Growth(NamedTuple):
    """A swing that grows: by which factor in each half period, over how many half waves, of which period."""

    factor: float
    half_waves: int
    period_s: float

    def to_dict(self) -> dict[str, float]:
        """Plain values."""
        return {"growth": self.factor, "half_waves": float(self.half_waves), "period_s": self.period_s}

    @property
    def sentence(self) -> str:
        """What is seen."""
        return (
            f"growing oscillation, by a factor of {self.factor:.2f} per half cycle of {self.period_s / 2:.3g} s, "
            f"{self.half_waves} times: the loop is unstable with the active gains"
        )


def half_waves(samples: Sequence[LoopSample], band: float) -> list[HalfWave]:
    """Half waves of the error since the setpoint and the gains last changed, oldest first; the newest is left out.

    band : what the error must pass on the other side for a half wave to have ended.
    """
    newest = samples[-1]
    found: list[HalfWave] = []
    top_s = top = 0.0
    for sample in reversed(samples):
        if sample.revision != newest.revision or sample.sp != newest.sp:
            break
        e = sample.sp - sample.pv
        if top and e * top < 0 and abs(e) > band:
            found.append(HalfWave(top_s, abs(top)))
            top_s, top = sample.t_s, e
        elif abs(e) > max(abs(top), band):
            top_s, top = sample.t_s, e
    return found[:0:-1]


def grows(samples: Sequence[LoopSample], band: float, settings: GrowthSettings) -> Growth | None:
    """The growth of the swing under way, None where it does not grow as an unstable loop's does."""
    waves = half_waves(samples, band)
    for n in range(min(len(waves), settings.most_half_waves), settings.half_waves - 1, -1):
        found = _growth(waves[-n:], settings)
        if found is not None and not _as_high_before(waves[:-n], waves[-n], found, settings):
            return found
    return None


def _as_high_before(before: list[HalfWave], first: HalfWave, found: Growth, settings: GrowthSettings) -> bool:
    """Whether the same swing went on at such a height before its first half wave: what grows by itself was lower."""
    heights, after_s = [], first.t_s
    for wave in reversed(before[-found.half_waves :]):
        if after_s - wave.t_s > settings.even * found.period_s / 2:
            break
        heights.append(wave.height)
        after_s = wave.t_s
    return len(heights) >= settings.fewest_before and median(heights) >= first.height


def lasting(samples: Sequence[LoopSample], band: float, settings: GrowthSettings) -> float | None:
    """Period, s, of a swing that goes on evenly without a rest, None where none does.

    One that is slow against the loop comes to rest at every crossing, and is seen as one load response after the other.
    """
    waves = half_waves(samples, band)[-settings.lasting_half_waves :]
    if len(waves) < settings.lasting_half_waves:
        return None
    apart, heights = np.diff([wave.t_s for wave in waves]), [wave.height for wave in waves]
    if apart.max() > settings.even * apart.min() or max(heights) > settings.like * min(heights):
        return None
    during = [abs(s.sp - s.pv) > band for s in samples if waves[0].t_s <= s.t_s <= waves[-1].t_s]
    return 2 * median(apart) if sum(during) >= settings.restless * len(during) else None


def _growth(waves: list[HalfWave], settings: GrowthSettings) -> Growth | None:
    times = np.array([wave.t_s for wave in waves])
    heights = np.log([wave.height for wave in waves])
    apart = np.diff(times)
    if apart.max() > settings.even * apart.min():
        return None
    n = len(waves)
    index = np.arange(n) - (n - 1) / 2
    rise = float(index @ heights / (index @ index))
    left = heights - heights.mean() - rise * index
    error = math.sqrt(float(left @ left) / (n - 2) / float(index @ index))
    if rise * (n - 1) < math.log(settings.growth) or rise < _errors_by_chance(n, settings.chance) * error:
        return None
    middle = n // 2
    earlier, later = heights[middle] - heights[0], heights[-1] - heights[middle]
    if later * middle < settings.steady * earlier * (n - 1 - middle):
        return None
    return Growth(math.exp(rise), n, 2 * median(apart))


@lru_cache(maxsize=64)
def _errors_by_chance(half_waves: int, chance: float) -> float:
    """Standard errors of a slope that as many heights without a trend pass with this probability: Student's t."""
    from scipy.special import stdtrit  # takes longer to load than all of a short command

    return float(stdtrit(half_waves - 2, 1.0 - chance))
