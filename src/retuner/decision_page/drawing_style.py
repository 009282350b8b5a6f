"""What all drawings have in common: colours, curves of many samples that keep their extremes, held signals, time."""

import numpy as np

from retuner.adaptive.signals.sample import FloatArray

BEFORE, AFTER, MODEL, SETPOINT, FAINT, LIMIT = "#d55e00", "#0072b2", "#d55e00", "#222222", "#9a9a9a", "#cc79a7"
"""Colours that colour-blind readers tell apart (Okabe & Ito 2008), each with a line style of its own beside it."""
PV, SP, FIXED = AFTER, SETPOINT, BEFORE
BANDS = ("#e4eef7", "#f8f0df", "#f5e4ec", "#e2f1ea", "#ecebf5")
"""Behind the time spent in each region."""
MARK = "#a3261b"
"""Colour of a change of gains."""
TONES = {
    "#000000": "ink",
    "#ffffff": "paper",
    "#b0b0b0": "line",
    BEFORE: "before",
    AFTER: "pv",
    SETPOINT: "sp",
    FAINT: "faint",
    MARK: "bad",
} | {band: f"band{i}" for i, band in enumerate(BANDS)}
"""Which colour of the pages' palette (templates/palette.css) each is: drawings follow light and dark."""
MOST_POINTS = 900  # Points of a drawn curve


def thinned(x: FloatArray, y: FloatArray, most: int = MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """A curve with at most about so many points: the lowest and the highest of every stretch are kept in order."""
    stretch = 2 * len(x) // most
    if stretch < 2:
        return x, y
    rows = y[: len(x) // stretch * stretch].reshape(-1, stretch)
    places = np.stack([rows.argmin(axis=1), rows.argmax(axis=1)], axis=1) + stretch * np.arange(len(rows))[:, None]
    kept = np.unique(np.concatenate([[0], places.ravel(), [len(x) - 1]]))
    return x[kept], y[kept]


def steps(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A held signal as a line: the value stays until the next sample."""
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]


def time_axis(t_s: np.ndarray) -> tuple[np.ndarray, str]:
    """Time in the unit that suits the length: hours, minutes or seconds."""
    span = float(t_s[-1] - t_s[0]) if len(t_s) else 0.0
    for seconds, name in ((3600.0, "hours"), (60.0, "minutes")):
        if span > 3 * seconds:
            return (t_s - t_s[0]) / seconds, name
    return t_s - t_s[0], "seconds"
