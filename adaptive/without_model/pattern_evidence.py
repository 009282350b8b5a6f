"""What a response looks like, in numbers by name: peaks of the error, and what pv and co did meanwhile.

Of every response, as far as it goes: height_bands (the largest error), overshoot, damping, period_s, the times between
its peaks (response.py), and limited_share, how much of the time that the error was outside the noise band co stood at
one of its extremes: integral action moves it there, unless a limit holds it.

Of a load response: rise_s, until the error is largest; tail_s, from there until it stays inside the noise band;
rebound, how far it grows again on its way back, as a share of its largest value (a swing that rides on a slow return);
left_bands, how far pv was from its setpoint just before: a tail of the last response is part of this one; co_way, how
far co ended from where it began, as a share of its travel; and co_overshoot. A load d at the process input
is answered by co = co_0 - T d, so co shows the overshoot that a setpoint step of the same loop would show, also where
the error never changes sign.

Of a setpoint response: tenth_s, until pv has made a tenth of its way; only where pv rested before. It is the dead time
and a little more: a second-order process takes 0.45 of its radians for that.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import FloatArray, Window

SMOOTHED = 5
"""Samples of the moving mean before extremes are taken: noise would make them larger."""
AT_REST_BANDS = 1.5
"""pv rested where it stayed within this many noise bands of its median."""
TENTH, MOVED_BANDS = 0.1, 2.0
"""pv has answered when it is this share of its way from where it rested, and at least so many noise bands."""


@dataclass(frozen=True, slots=True)
class SecondPeak(Numbers):
    """What the second peak shows; period_s is twice the time between the first two while there is no third."""

    overshoot: float
    period_s: float


@dataclass(frozen=True, slots=True)
class ThirdPeak(Numbers):
    """What the third peak shows. first_s, second_s : from the first peak to the second, and on to the third."""

    damping: float
    first_s: float
    second_s: float


@dataclass(frozen=True, slots=True)
class LoadNumbers(Numbers):
    """Numbers of a load response, see the head of this file; co_overshoot : None where co stays or comes back."""

    rise_s: float
    tail_s: float
    rebound: float
    left_bands: float
    co_way: float
    co_overshoot: float | None = None


@dataclass(frozen=True, slots=True)
class PatternNumbers(Numbers):
    """The numbers at the head of this file; None for those that a response does not show."""

    peaks: float
    height_bands: float
    limited_share: float
    second: SecondPeak | None = None
    third: ThirdPeak | None = None
    tenth_s: float | None = None
    after_load: LoadNumbers | None = None


def pattern_numbers(response: Response, window: Window) -> PatternNumbers:
    """The numbers of a response.

    window : the response with some time before it.
    """
    during = (window.t_s >= response.t_start_s) & (window.t_s <= response.t_end_s)
    height = float(np.max(np.abs(window.sp - window.pv)[during], initial=0.0))
    # None without one
    overshoot, period_s = response.overshoot, response.period_s
    return PatternNumbers(
        peaks=float(len(response.peaks)),
        height_bands=height / response.band,
        limited_share=_limited_share(window, during, response.band),
        second=(None if overshoot is None or period_s is None else SecondPeak(overshoot, period_s)),
        third=_third_peak(response),
        tenth_s=_tenth_s(response, window) if response.sp_changed else None,
        after_load=None if response.sp_changed else _of_load(response, window),
    )


def _third_peak(response: Response) -> ThirdPeak | None:
    """None without one."""
    damping = response.damping
    if damping is None:
        return None
    first, second, third = (peak.t_s for peak in response.peaks)
    return ThirdPeak(damping, second - first, third - second)


def _limited_share(window: Window, during: npt.NDArray[np.bool_], band: float) -> float:
    """Share of the upset in which co stood still at its largest or smallest value; 0 without an upset."""
    upset = during & (np.abs(window.sp - window.pv) > band)
    co = window.co[upset]
    if not co.size:
        return 0.0
    still = sum(max(int(np.sum(co == extreme)) - 1, 0) for extreme in (window.co.max(), window.co.min()))
    return still / co.size


def _tenth_s(response: Response, window: Window) -> float | None:
    """How soon pv answers; None where it did not rest before."""
    t_s = window.t_s - response.t_start_s
    before = window.pv[t_s < 0]
    if not len(before):
        return None
    rest = float(np.median(before))
    if np.max(np.abs(before - rest)) > AT_REST_BANDS * response.band:
        return None
    way = abs(float(window.sp[-1]) - rest)
    far = max(TENTH * way, MOVED_BANDS * response.band)
    moved = np.flatnonzero((t_s > 0) & (np.abs(window.pv - rest) > far))
    return float(t_s[moved[0]]) if moved.size else None


def _of_load(response: Response, window: Window) -> LoadNumbers | None:
    """Rise, tail, rebound, and the overshoot of co; None of an error that stays inside the noise band."""
    during = (window.t_s >= response.t_start_s) & (window.t_s <= response.t_end_s)
    t_s, error = window.t_s[during] - response.t_start_s, (window.sp - window.pv)[during]
    outside = np.flatnonzero(np.abs(error) > response.band)
    if not outside.size or len(error) < 3 * SMOOTHED:
        return None
    top = int(np.argmax(np.abs(error)))
    rise_s, tail_s = float(t_s[top]), float(t_s[outside[-1]] - t_s[top])
    before = (window.sp - window.pv)[window.t_s < response.t_start_s][-SMOOTHED:]
    left_bands = abs(float(np.mean(before))) / response.band if before.size else 0.0
    rebound = _rebound(_smooth(error), response.band)
    return LoadNumbers(rise_s, tail_s, rebound, left_bands, *_of_co(window.co, during))


def _rebound(error: FloatArray, band: float) -> float:
    """Largest growth on the way back, as a share of the largest error; half a band of it may be noise."""
    top = int(np.argmax(np.abs(error)))
    back = error[top:] * np.sign(error[top])
    growth = float(np.max(back - np.minimum.accumulate(back)))
    return max(growth - band / 2, 0.0) / float(back[0]) if back[0] else 0.0


def _of_co(co: FloatArray, during: npt.NDArray[np.bool_]) -> tuple[float, float | None]:
    """How far co ended from where it began, as a share of its travel; how far it went beyond, as a share of that."""
    first, last = (int(i) for i in np.flatnonzero(during)[[0, -1]])
    own = _smooth(co[first : last + 1])
    before = float(np.median(co[: max(first, SMOOTHED)]))
    way = float(np.mean(co[last + 1 - 2 * SMOOTHED : last + 1])) - before
    travel = max(float(np.max(own)), before) - min(float(np.min(own)), before)
    if way == 0 or travel == 0:
        return 0.0, None
    return abs(way) / travel, float(np.max((own - before) / way)) - 1.0


def _smooth(values: FloatArray) -> FloatArray:
    return np.asarray(np.convolve(values, np.ones(SMOOTHED) / SMOOTHED, mode="valid"), dtype=np.float64)
