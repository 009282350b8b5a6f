"""Rows in the order of time: newest first, a few out of place, several to a stamp; signals of several clocks as one.

A signal that a historian stores by exception has a row only when it changed; between its rows it stands where it stood.
So where most stamps of pv are not among those of co or sp, these are held from their last row.
"""

import numpy as np

from retuner.adaptive.signals.sample import FloatArray, all_finite
from retuner.drivers.historian.assumption import Assumption
from retuner.drivers.recorded.recording import RecordingError
from retuner.schedule.late_dataclass import dataclass

FEW_OUT_OF_ORDER = 0.01
"""Share of rows that may be out of order and are put in place; more of them are two records in one file."""
SHARED = 0.95  # share of the stamps of pv from which another signal has the same clock


@dataclass(frozen=True, slots=True)
class OneSignal:
    """One signal: stamps in seconds and values, shape (n,) each; no value is nan. held : it is stored by exception."""

    t_s: FloatArray
    values: FloatArray
    held: bool = False


def in_order(t_s: FloatArray, source: str) -> tuple[np.ndarray, FloatArray, list[Assumption]]:
    """Rows to be kept in the order of time, their stamps (increasing), and what was assumed.

    Raises RecordingError: time goes back too often for rows that were put in a wrong place.
    """
    told: list[Assumption] = []
    if all_finite(t_s[[0, -1]] if len(t_s) else t_s) and bool(np.all(t_s[1:] > t_s[:-1])):  # no nan is over any
        return np.arange(len(t_s)), t_s, told
    places = np.flatnonzero(np.isfinite(t_s))
    if len(places) < len(t_s):
        told.append(Assumption(f"{len(t_s) - len(places)} rows without a stamp: left out"))
    steps = np.diff(t_s[places])
    if len(steps) and np.mean(steps <= 0) > 1 - FEW_OUT_OF_ORDER and np.any(steps < 0):
        places = places[::-1]
        told.append(Assumption("newest first: turned round"))
        steps = np.diff(t_s[places])
    if np.all(steps > 0):
        return places, t_s[places], told
    back = np.flatnonzero(steps < 0)
    displaced = 0
    if len(back):  # a step back may be a late row; it is a second record where many rows after it are early
        t = t_s[places]
        late, early = t < np.maximum.accumulate(t), t > np.minimum.accumulate(t[::-1])[::-1]
        displaced = int(min(np.sum(late), np.sum(early)))
    if displaced > FEW_OUT_OF_ORDER * len(places):
        i = places[back[0] + 1]
        raise RecordingError(
            f"{source}: sample {i + 1}: t = {t_s[i]:.12g} follows {t_s[places[back[0]]]:.12g}; time must increase, "
            "so cut the file where another record begins"
        )
    if len(back):
        places = places[np.argsort(t_s[places], kind="stable")]
        told.append(Assumption(f"{displaced} rows out of order: put in place"))
    # Every stamp once: several rows to each are spread over it, of single repeats the last is kept
    stamps = t_s[places]
    unique, first, counts = np.unique(stamps, return_index=True, return_counts=True)
    repeats, usual = len(stamps) - len(unique), int(np.median(counts))
    if not repeats:
        return places, stamps, told
    if usual < 2 or len(unique) < 2:
        told.append(Assumption(f"{repeats} repeated stamps: the last row of each kept"))
        return places[first + counts - 1], unique, told
    width = float(np.median(np.diff(unique)))
    rank = np.arange(len(stamps)) - np.repeat(first, counts)
    rank[: counts[0]] += max(usual - int(counts[0]), 0)  # the first stamp may be cut: its last rows are there
    spread = np.repeat(unique, counts) + rank * width / np.maximum(np.repeat(counts, counts), usual)
    return places, spread, [*told, Assumption(f"{usual} rows to a stamp: spread evenly over {width:g} s")]


def joined(pv: OneSignal, others: dict[str, OneSignal]) -> tuple[FloatArray, dict[str, FloatArray], list[Assumption]]:
    """Stamps of pv at which all signals are known, all signals there (pv too), and what was assumed."""
    t_s, told = pv.t_s, []
    known = np.ones(len(t_s), dtype=bool)
    values: dict[str, FloatArray] = {"pv": pv.values}
    for role, trend in others.items():
        if not trend.held and (trend.t_s is t_s or np.array_equal(trend.t_s, t_s)):
            values[role] = trend.values
            continue
        at, same = np.searchsorted(trend.t_s, t_s, side="right") - 1, np.zeros(len(t_s), dtype=bool)
        inside = at >= 0
        same[inside] = np.abs(trend.t_s[at[inside]] - t_s[inside]) < 1e-6
        values[role] = trend.values[np.maximum(at, 0)]
        if not trend.held and same.mean() >= SHARED:
            known &= same
            continue
        # stored by exception, a signal is known until its last row and as long again as it ever stood
        longest = float(np.max(np.diff(trend.t_s))) if len(trend.t_s) > 1 else np.inf
        known &= inside & (t_s <= float(trend.t_s[-1]) + longest)
        told.append(Assumption(f"{role} has rows of its own: held between them"))
    if known.all():
        return t_s, values, told
    return t_s[known], {role: v[known] for role, v in values.items()}, told
