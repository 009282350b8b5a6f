"""Which stretches of a long record are diagnosed: where something happens, and spread over time.

A setpoint change shows the process; a stretch in which the error is largest shows what is wrong; the newest one shows
whether it still is. A stretch holds CYCLES periods of the oscillation, where there is one, and never a gap.
"""

import numpy as np

from retuner.adaptive.audit.loop_screen import GAP
from retuner.adaptive.signals.sample import Window

CYCLES = 15.0
"""Ten to twenty show a cause, and drift little."""
FEWEST, USUAL, MOST = 200, 800, 4_000
"""Samples of a stretch: at least, without an oscillation, and at most."""
BEFORE = 0.2
"""Share of a stretch that lies before the setpoint change that it is taken for."""


def stretches_of_interest(record: Window, period_s: float | None, most: int) -> list[Window]:
    """At most `most` stretches of a record in the order of time; they do not overlap.

    Parameters
    ----------
    record : of any length. period_s : of its oscillation, None where there is none. most : at least 1.
    """
    n = len(record.t_s)
    usual_s = record.sample_time_s
    length = USUAL if period_s is None else int(np.clip(CYCLES * period_s / usual_s, FEWEST, MOST))
    if n <= 1.5 * length:
        return [record]
    whole = _without_gaps(record, length, usual_s)
    if not len(whole):
        return [record]
    taken: list[int] = []
    for begin in _wanted(record, length, whole):
        if len(taken) < most and all(abs(begin - other) >= length for other in taken):
            taken.append(begin)
    return [_part(record, begin, begin + length) for begin in sorted(taken)]


def _part(record: Window, begin: int, end: int) -> Window:
    """Some of the samples."""
    return Window(record.t_s[begin:end], record.sp[begin:end], record.pv[begin:end], record.co[begin:end])


def _without_gaps(record: Window, length: int, usual_s: float) -> np.ndarray:
    """Begins of stretches that hold no gap."""
    gap = np.concatenate([[0], np.cumsum(np.diff(record.t_s) > GAP * usual_s)])
    begins = np.arange(len(record.t_s) - length + 1)
    return np.asarray(begins[gap[begins + length - 1] == gap[begins]])


def _wanted(record: Window, length: int, whole: np.ndarray) -> list[int]:
    """Begins of stretches, the most telling first: the newest, a setpoint change, the largest error, in turn."""
    newest = [int(whole[-1])]
    moves = np.abs(np.diff(record.sp))
    largest = np.argsort(moves)[::-1][:20]
    changes = [int(i - BEFORE * length) for i in largest if moves[i] > 0]
    error = (record.sp - record.pv) ** 2
    sums = np.concatenate([[0.0], np.cumsum(error)])
    energy = sums[whole + length] - sums[whole]
    strongest = [int(whole[i]) for i in np.argsort(energy)[::-1][:: max(length // 4, 1)][:20]]
    spread = [int(b) for b in whole[np.linspace(0, len(whole) - 1, 12).astype(int)]]
    allowed = set(whole.tolist())
    order: list[int] = []
    columns = [_padded(begins, 20) for begins in (newest, changes, strongest, spread)]
    for some in zip(*columns, strict=True):
        order += [begin for begin in some if begin in allowed]
    return order


def _padded(begins: list[int], count: int) -> list[int]:
    """A list of a given length; -1 is no begin."""
    return (begins + [-1] * count)[:count]
