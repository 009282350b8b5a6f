"""A drawn record with everything that is true of it."""

import math
import signal
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Record:
    """What a historian would hold: time in seconds, setpoint, process value, controller output, each of shape (n,)."""

    t: FloatArray
    sp: FloatArray
    pv: FloatArray
    co: FloatArray


@dataclass(frozen=True, slots=True)
class IdentificationCase:
    """A record to identify from.

    group : how the record came about. family : of the process. gains : in force, None for an experiment in manual.
    co_min, co_max : limits of the output. process : the truth, without the sampling's own delay. best, best_pid : SIMC
    with perfect knowledge (half rule, tau_c = theta, theta + dt/2), PI and, where there is a second lag, PID.
    theta_eff_s : effective dead time of that PI. noise : standard deviation of the measurement noise, pv units.
    """

    group: str
    family: str
    seed: int
    index: int
    record: Record
    gains: PidGains | None
    co_min: float
    co_max: float
    process: LinearProcess
    dt_s: float
    best: PidGains
    best_pid: PidGains | None
    theta_eff_s: float
    noise: float
    note: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DiagnosisCase:
    """A record with the cause that made it.

    group : a cause, or the name of a trap. right : the answers that count as right. retune_right : whether a change of
    gains is. hidden : the cause by construction, where it is one of the eight; else what was built.
    """

    group: str
    family: str
    seed: int
    index: int
    record: Record
    gains: PidGains
    co_min: float
    co_max: float
    process: LinearProcess
    dt_s: float
    right: frozenset[str]
    retune_right: bool
    hidden: str
    best: PidGains
    theta_eff_s: float
    note: dict[str, float] = field(default_factory=dict)


# ---- Counts with their uncertainty, work on several cores, and a picture of a record

Z_95 = 1.959964
"""Two-sided 95 % of the normal distribution."""

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
