"""What a response looks like, in numbers by name: peaks of the error, and what pv and co did meanwhile.

Of every response, as far as it goes: height_bands (the largest error), overshoot, damping, period_s, the times between
its peaks (response.py), and limited_share, how much of the time that the error was outside the noise band co stood at
one of its extremes: integral action moves it there, unless a limit holds it.

Of a load response: rise_s, until the error is largest; tail_s, from there until it stays inside the noise band;
rebound, how far it grows again on its way back, as a share of its largest value (a swing that rides on a slow return);
co_way, how far co ended from where it began, as a share of its travel; and co_overshoot. A load d at the process input
is answered by co = co_0 - T d, so co shows the overshoot that a setpoint step of the same loop would show, also where
the error never changes sign.

Of a setpoint response: tenth_s, until pv has made a tenth of its way; only where pv rested before. It is the dead time
and a little more: a second-order process takes 0.45 of its radians for that.
"""

import numpy as np
import numpy.typing as npt

from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import FloatArray, Window

SMOOTHED = 5
"""Samples of the moving mean before extremes are taken: noise would make them larger."""
AT_REST_BANDS = 1.5
"""pv rested where it stayed within this many noise bands of its median."""
TENTH, MOVED_BANDS = 0.1, 2.0
"""pv has answered when it is this share of its way from where it rested, and at least so many noise bands."""


def pattern_numbers(response: Response, window: Window) -> dict[str, float]:
    """The numbers at the head of this file; those that a response does not show are missing.

    window : the response with some time before it.
    """
    during = (window.t_s >= response.t_start_s) & (window.t_s <= response.t_end_s)
    height = float(np.max(np.abs(window.sp - window.pv)[during], initial=0.0))
    found = {"peaks": float(len(response.peaks)), "height_bands": height / response.band}
    found["limited_share"] = _limited_share(window, during, response.band)
    shown = {"overshoot": response.overshoot, "damping": response.damping, "period_s": response.period_s}
    found |= {name: value for name, value in shown.items() if value is not None}
    times = [peak.t_s for peak in response.peaks]
    if len(times) == 3:
        found |= {"first_s": times[1] - times[0], "second_s": times[2] - times[1]}
    return found | (_of_setpoint(response, window) if response.sp_changed else _of_load(response, window))


def _limited_share(window: Window, during: npt.NDArray[np.bool_], band: float) -> float:
    """Share of the upset in which co stood still at its largest or smallest value; 0 without an upset."""
    upset = during & (np.abs(window.sp - window.pv) > band)
    co = window.co[upset]
    if not co.size:
        return 0.0
    still = sum(max(int(np.sum(co == extreme)) - 1, 0) for extreme in (window.co.max(), window.co.min()))
    return still / co.size


def _of_setpoint(response: Response, window: Window) -> dict[str, float]:
    """How soon pv answers."""
    t_s = window.t_s - response.t_start_s
    before = window.pv[t_s < 0]
    if not len(before):
        return {}
    rest = float(np.median(before))
    if np.max(np.abs(before - rest)) > AT_REST_BANDS * response.band:
        return {}
    way = abs(float(window.sp[-1]) - rest)
    far = max(TENTH * way, MOVED_BANDS * response.band)
    moved = np.flatnonzero((t_s > 0) & (np.abs(window.pv - rest) > far))
    return {"tenth_s": float(t_s[moved[0]])} if moved.size else {}


def _of_load(response: Response, window: Window) -> dict[str, float]:
    """Rise, tail, rebound, and the overshoot of co."""
    during = (window.t_s >= response.t_start_s) & (window.t_s <= response.t_end_s)
    t_s, error = window.t_s[during] - response.t_start_s, (window.sp - window.pv)[during]
    outside = np.flatnonzero(np.abs(error) > response.band)
    if not outside.size or len(error) < 3 * SMOOTHED:
        return {}
    top = int(np.argmax(np.abs(error)))
    found = {"rise_s": float(t_s[top]), "tail_s": float(t_s[outside[-1]] - t_s[top])}
    found["rebound"] = _rebound(_smooth(error), response.band)
    return found | _of_co(window.co, during)


def _rebound(error: FloatArray, band: float) -> float:
    """Largest growth on the way back, as a share of the largest error; half a band of it may be noise."""
    top = int(np.argmax(np.abs(error)))
    back = error[top:] * np.sign(error[top])
    growth = float(np.max(back - np.minimum.accumulate(back)))
    return max(growth - band / 2, 0.0) / float(back[0]) if back[0] else 0.0


def _of_co(co: FloatArray, during: npt.NDArray[np.bool_]) -> dict[str, float]:
    """How far co ended from where it began, as a share of its travel; how far it went beyond, as a share of that."""
    first, last = (int(i) for i in np.flatnonzero(during)[[0, -1]])
    own = _smooth(co[first : last + 1])
    before = float(np.median(co[: max(first, SMOOTHED)]))
    way = float(np.mean(co[last + 1 - 2 * SMOOTHED : last + 1])) - before
    travel = max(float(np.max(own)), before) - min(float(np.min(own)), before)
    if way == 0 or travel == 0:
        return {"co_way": 0.0}
    return {"co_way": abs(way) / travel, "co_overshoot": float(np.max((own - before) / way)) - 1.0}


def _smooth(values: FloatArray) -> FloatArray:
    """Moving mean."""
    return np.asarray(np.convolve(values, np.ones(SMOOTHED) / SMOOTHED, mode="valid"), dtype=np.float64)
