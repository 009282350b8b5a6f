"""What every output of a plant does to one of its process values, from setpoint moves of any of its loops.

    pv(s) = sum over j of G_j(s) co_j(s) + offset + ramp,   G_j = k_j exp(-theta_j s) / ((tau1_j s + 1) (tau2_j s + 1))

All outputs are recorded, those of the other loops' controllers too, so G_j is the process alone, whatever gains the
loops had. Output error over all windows at once: lags and dead times by least squares, gains, offsets and ramps inside
it (variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973, 413-432).
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.signal import lfilter

from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass

ComplexArray = npt.NDArray[np.complex128]

LAGS, LATE = (0.01, 0.03, 0.08, 0.2, 0.6), (0.0, 0.02, 0.06, 0.15)
"""First guesses of a lag and of a dead time, as shares of the longest window: all pairs are tried with all."""
REFINED = 2  # best of them that are refined
SLOWEST, QUICKEST = 20.0, 0.2  # largest lag in longest windows, smallest in samples
LATEST = 0.4  # largest dead time as a share of the longest window
MOST_TRIES = 30  # evaluations of a start


class Moved(NamedTuple):
    """The samples after a setpoint move, of all loops at the same times, a sample apart. co : shape (loops, n), what is
    held from each time on. pv : shape (n,), of one loop. The first sample is from before the move.
    """

    co: FloatArray
    pv: FloatArray


@dataclass(frozen=True, slots=True)
class Element:
    """What one output does to one process value; times in seconds, k in pv units per co unit."""

    k: float
    tau1_s: float
    tau2_s: float
    theta_s: float

    def at(self, w: FloatArray) -> ComplexArray:
        """The element's frequency response at w rad/s."""
        s = 1j * w
        return np.asarray(self.k * np.exp(-s * self.theta_s) / ((1 + s * self.tau1_s) * (1 + s * self.tau2_s)))


@dataclass(frozen=True, slots=True)
class StepAnswers:
    """elements : one an output. left : share of pv's variation in the windows that they do not explain."""

    elements: tuple[Element, ...]
    left: float


def answers(windows: Sequence[Moved], dt_s: float) -> StepAnswers:
    """The elements of one process value.

    windows : one or more, each of ten samples at least; between them every output moves. dt_s : sample time, seconds.
    """
    loops, longest = len(windows[0].co), max(len(one.pv) for one in windows)
    low = [math.log(QUICKEST), 0.0, 0.0] * loops
    high = [math.log(SLOWEST * longest), 1.0, LATEST * longest] * loops
    data = _Data(windows)
    best: tuple[float, FloatArray] | None = None
    # the best of all combinations of first guesses
    shapes = [(math.log(max(lag * longest, QUICKEST)), 0.2, late * longest) for lag in LAGS for late in LATE]
    columns = np.stack([[data.column(i, *shape) for shape in shapes] for i in range(loops)])
    flat = columns.reshape(loops * len(shapes), -1)
    gram, onto = flat @ flat.T, flat @ data.rest
    picks = np.array(list(product(range(len(shapes)), repeat=loops))) + np.arange(loops) * len(shapes)
    blocks = gram[picks[:, :, None], picks[:, None, :]]
    blocks = blocks + 1e-9 * np.trace(blocks, axis1=1, axis2=2)[:, None, None] * np.eye(loops)
    gained = np.einsum("pi,pi->p", onto[picks], np.linalg.solve(blocks, onto[picks][:, :, None])[:, :, 0])
    order = np.argsort(-gained)[:REFINED]
    for z0 in [np.array([x for at in picks[one] for x in shapes[at % len(shapes)]]) for one in order]:
        found = least_squares(data.left, z0, bounds=(low, high), x_scale="jac", max_nfev=MOST_TRIES)
        if best is None or found.cost < best[0]:
            best = float(found.cost), found.x
    assert best is not None
    gains, error = data.fitted(best[1])
    elements = tuple(
        Element(float(k), math.exp(lag) * dt_s, math.exp(lag) * ratio * dt_s, late * dt_s)
        for k, (lag, ratio, late) in zip(gains, best[1].reshape(loops, 3), strict=True)
    )
    return StepAnswers(elements, float(error @ error) / data.whole if data.whole else 1.0)


class _Data:
    """The windows as one array each; what is beyond the end of a short one counts nothing."""

    def __init__(self, windows: Sequence[Moved]) -> None:
        inside = [len(one.pv) for one in windows]
        n = max(inside)
        self._co = np.stack([np.pad(one.co - one.co[:, :1], ((0, 0), (0, n - len(one.pv)))) for one in windows], 1)
        offsets = []  # orthonormal offset and ramp of each window, shape (n, 2), nothing beyond its end
        for m in inside:
            q, _ = np.linalg.qr(np.stack([np.ones(m), np.arange(m) / n], axis=1))
            offsets.append(np.concatenate([q, np.zeros((n - m, 2))]))
        self._offs = np.stack(offsets)
        pv = np.stack([np.pad(one.pv - one.pv[0], (0, n - len(one.pv))) for one in windows])
        self.whole = float(np.sum(pv**2))
        self._mask = np.stack([np.arange(n) < m for m in inside])
        self.rest = self._without_offsets(pv)

    def column(self, loop: int, lag: float, ratio: float, late: float) -> FloatArray:
        """pv for a gain of 1 of one output, without offset and ramp of each window; times in samples."""
        return self._without_offsets(_moved(self._co[loop], lag, ratio, late))

    def fitted(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The best gains for these lags and dead times, and what is left of pv."""
        shapes = z.reshape(-1, 3)
        matrix = np.stack([self.column(i, *shape) for i, shape in enumerate(shapes)], axis=1)
        gains = np.asarray(np.linalg.lstsq(matrix, self.rest, rcond=None)[0])
        return gains, np.asarray(self.rest - matrix @ gains)

    def left(self, z: FloatArray) -> FloatArray:
        return self.fitted(z)[1]

    def _without_offsets(self, values: FloatArray) -> FloatArray:
        values = values * self._mask
        along = np.einsum("wnk,wn->wk", self._offs, values)
        return np.asarray(values - np.einsum("wnk,wk->wn", self._offs, along)).ravel()


def _moved(co: FloatArray, lag: float, ratio: float, late: float) -> FloatArray:
    """pv for a gain of 1, along the last axis; co is held from sample to sample."""
    whole = math.floor(late)
    share = late - whole
    n = co.shape[-1]
    held = np.concatenate([np.zeros((*co.shape[:-1], whole + 1)), co], axis=-1)
    u = (1 - share) * held[..., 1 : n + 1] + share * held[..., :n]
    tau1, tau2 = math.exp(lag), math.exp(lag) * min(ratio, 0.98)
    first = _first_order(u, tau1)
    if tau2 < QUICKEST / 4:
        return first
    return (tau1 * first - tau2 * _first_order(u, tau2)) / (tau1 - tau2)


def _first_order(u: FloatArray, tau: float) -> FloatArray:
    a = math.exp(-1.0 / tau)
    return np.asarray(lfilter([0.0, 1.0 - a], [1.0, -a], u, axis=-1))
