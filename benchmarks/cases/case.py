"""A drawn record, counts with their uncertainty, and work on several cores."""

import math
import signal
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class Record(NamedTuple):
    """What a historian would hold: time in seconds, setpoint, process value, controller output, each of shape (n,)."""

    t: FloatArray
    sp: FloatArray
    pv: FloatArray
    co: FloatArray


Z_95 = 1.959964  # Two-sided 95 % of the normal distribution

A = TypeVar("A")
B = TypeVar("B")


def interval(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share after hits of n (Wilson 1927)."""
    if n == 0:
        return 0.0, 1.0
    p, z2 = hits / n, Z_95**2
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = Z_95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def share(hits: int, n: int) -> str:
    """hits of n as a percentage with its 95 % interval."""
    if n == 0:
        return "none"
    low, high = interval(hits, n)
    return f"{hits:4d} of {n:4d}  {hits / n:6.1%}  [{low:.1%}, {high:.1%}]"


def spread(work: Callable[[A], B], items: Iterable[A], jobs: int) -> Iterator[B]:
    """The results in order, on that many cores."""
    if jobs == 1:
        yield from map(work, items)
        return
    with get_context("spawn").Pool(jobs, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        yield from pool.imap(work, items)


def picture(record: Record, title: str, path: Path) -> None:
    """sp and pv above, co below, as PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    above.plot(record.t, record.pv, lw=0.8, label="pv")
    above.plot(record.t, record.sp, lw=0.8, label="sp")
    below.plot(record.t, record.co, lw=0.8, color="C2", label="co")
    above.set_title(title, fontsize=7, loc="left")
    for axes in (above, below):
        axes.tick_params(labelsize=7)
        axes.legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
