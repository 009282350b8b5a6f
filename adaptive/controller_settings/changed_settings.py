"""Settings that were changed during a record: it is then several records, each under settings of its own.

Under two sets of gains co follows neither: one law for both is a mixture, and what it foretells of the loop is true at
no time; and where few rows hold the newer gains they are left out as moves that no law made. So a record is parted
where two laws leave least of the moves of co, if they leave much less than one does, and its parts are parted again:

    k = arg min  RSS(moves before k) + RSS(moves from k on)                                            (Quandt 1958)
"""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from retuner.adaptive.controller_settings.read_off import (
    LawSettings,
    SettingsInForce,
    apart,
    settings_in_force,
    usable_increments,
)
from retuner.adaptive.controller_settings.regression import columns
from retuner.adaptive.signals.sample import FloatArray, Window, quantile
from retuner.schedule.late_dataclass import replace

MOST_CHANGES = 3  # of more in one record the gains are scheduled, not set
FEWEST_ROWS = 100  # rows of a part; fewer hold no response
TRIED = 256  # places of a change that are tried at first
USUAL = 0.995  # quantile of the moves of co above which they may be a hand's, or a bump of the change
LEFT = 0.5  # share of what one law leaves of co's moves, squared, that two leave at the most
NOTHING = 1e-6  # share of co's moves, squared, that a law leaves where it leaves rounding alone
IntArray = npt.NDArray[np.int64]


def differ(one: SettingsInForce, other: SettingsInForce) -> bool:
    """Whether two records surely show different settings."""
    if one.gains is None or other.gains is None:
        return False
    for name in ("kp", "ki"):
        values = [getattr(found.gains, name) for found in (one, other)]
        spread = float(np.hypot(one.std.get(name, 0.0), other.std.get(name, 0.0)))
        if apart(values, spread, LawSettings().disagreement):
            return True
    return False


def under_one_setting(window: Window, co_min: float | None = None, co_max: float | None = None) -> list[Window]:
    """The parts of a record between changes of the settings; the record itself where none is seen.

    Each part shows settings, unlike those of the part beside it.
    """
    parts = _parted(window, (co_min, co_max), MOST_CHANGES)
    shown = [settings_in_force(part, co_min, co_max) for part in parts]
    if not all(differ(*two) for two in pairwise(shown)):
        return [window]
    return parts


def _parted(window: Window, limits: tuple[float | None, float | None], changes: int) -> list[Window]:
    n, found = len(window.t_s), settings_in_force(window, *limits)
    if found.structure is None or not changes or n < 2 * FEWEST_ROWS:
        return [window]
    # where two laws leave least
    x = columns(window, replace(found.structure, pv_filter_s=0.0))[1]
    moves = np.diff(window.co)
    made = np.column_stack([x, moves]) * usable_increments(window, *limits)[:, None]
    made *= (np.abs(moves) <= quantile(np.abs(moves), USUAL))[:, None]
    made /= np.maximum(np.sqrt(np.mean(made**2, axis=0)), np.finfo(np.float64).tiny)
    squares = np.concatenate([np.zeros((1, *(2 * (made.shape[1],)))), np.cumsum(made[:, :, None] * made[:, None], 0)])

    def left(rows: IntArray) -> FloatArray:
        total = np.zeros(len(rows))
        for side in (squares[rows], squares[-1] - squares[rows]):
            inside, with_co = side[:, :-1, :-1], side[:, :-1, -1:]
            total += (side[:, -1:, -1:] - np.swapaxes(with_co, 1, 2) @ np.linalg.pinv(inside) @ with_co).ravel()
        return np.asarray(total, dtype=np.float64)

    rows = np.linspace(FEWEST_ROWS, n - FEWEST_ROWS, TRIED).astype(np.int64)
    at = int(np.argmin(left(rows)))
    near = np.arange(rows[max(at - 1, 0)], rows[min(at + 1, len(rows) - 1)] + 1)
    least, whole = left(near), float(left(np.zeros(1, dtype=np.int64))[0])
    if whole < NOTHING * n or np.min(least) > LEFT * whole:
        return [window]
    row = int(near[np.argmin(least)]) + 1
    halves = window.part(slice(row)), window.part(slice(row, n))
    return [part for half in halves for part in _parted(half, limits, changes - 1)]
