"""How a process moves whose gain, lags and dead time change along the way, without its resting points being known.

    dq/dt = -q / tau + dv/dt,   dy/dt = b q,   tau2 dv/dt = u(t - theta) - v        b = k / tau at y

q is how far v is from what would hold y: with v0(y) that input at rest, dv0/dy = 1/k, and dy/dt = b(y) (v - v0(y)),
dq/dt = dv/dt - (1/k) dy/dt. So it is exact for every process that is linear in its input, however far it travels, and
for a slowly moving one with a curved input as well (tank with a valve's curve: b is then that at v, which leads y).
The velocity of y must not be what decays (velocity-based linearisation, Leith and Leithead 1998, with 1/tau at y): that
leaves out dy/dt d(ln b)/dt. The error is small beside the lag and many times a dead time, so dead times came out up to
20 times too long. An integrating process has 1/tau = 0. co is held between rows at its mean over the interval that
arrives in it.

Arrays have the row first: (rows, stretches) or (rows, stretches, variants).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from retuner.adaptive.schedule_design.record_stretches import Characteristic, Stretch, summed
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass


class Local(NamedTuple):
    """ln b, ln theta, ln tau, ln tau2 at every row, each of shape (rows, stretches, variants).

    tau : None for an integrating process. tau2 : None without a second lag.
    """

    b: FloatArray
    theta: FloatArray
    tau: FloatArray | None
    tau2: FloatArray | None

    def repeated(self, variants: int) -> "Local":
        """The one variant that it has, so many times."""
        b, theta, tau, tau2 = (None if p is None else np.broadcast_to(p, (*p.shape[:2], variants)) for p in (*self,))
        assert b is not None
        assert theta is not None
        return Local(b, theta, tau, tau2)


@dataclass(frozen=True, slots=True)
class Batch:
    """Stretches of like length beside each other, the shorter ones filled up. Shapes (rows, stretches).

    pv, x, x2 : filled with their last value. h_s : of each stretch, shape (stretches,).
    """

    stretches: tuple[Stretch, ...]
    pv: FloatArray
    x: FloatArray
    h_s: FloatArray
    x2: FloatArray | None = None

    @classmethod
    def of(cls, stretches: Sequence[Stretch]) -> "Batch":
        """Stretches as they come."""
        rows = max(len(s) for s in stretches)
        pv, x = (_filled([getattr(s, name) for s in stretches], rows) for name in ("pv", "x"))
        seconds = [s.x2 for s in stretches if s.x2 is not None]
        h = np.array([s.signals.h_s for s in stretches])
        return cls(tuple(stretches), pv, x, h, _filled(seconds, rows) if seconds else None)

    def arriving(
        self, theta_s: FloatArray, characteristic: Characteristic | None = None, z: FloatArray | None = None
    ) -> FloatArray:
        """Mean co that arrives between row i and i + 1, shape (rows - 1, stretches, variants).

        theta_s : at every row, shape (rows, stretches, variants). characteristic, z : through which it acts, with its
        coefficients for each variant; left out, as it is.
        """
        found = np.empty((theta_s.shape[0] - 1, *theta_s.shape[1:]))
        which, sums = np.zeros(theta_s.shape[2], dtype=int), [s.signals.fired[:, None] for s in self.stretches]
        if characteristic is not None and z is not None and len(z):
            kinds, which = np.unique(z, axis=1, return_inverse=True)
            sums = summed(characteristic, self.stretches, kinds)
        for j, stretch in enumerate(self.stretches):
            h = float(self.h_s[j])
            t = stretch.t_s[0] + h * np.arange(theta_s.shape[0])
            ends = t[:, None] - theta_s[:, j]
            of = sums[j]
            fired = np.stack([stretch.summed(of[:, k], e) for k, e in zip(which.ravel(), ends.T, strict=True)], axis=1)
            span = np.diff(ends, axis=0)
            found[:, j] = np.diff(fired, axis=0) / np.maximum(span, 0.1 * h)
        return found


def response(local: Local, arriving: FloatArray, h_s: FloatArray, start: FloatArray | None = None) -> FloatArray:
    """y from zero, shape (rows, stretches, variants).

    arriving : the input held after each row. start : q at the first row, shape (stretches, variants).
    """
    h = h_s[:, None]
    s = arriving
    if local.tau2 is not None:  # means over each interval of a first-order lag of the input, which rests at the start
        tau2 = np.exp(local.tau2[:-1])
        decay = np.exp(-h / tau2)
        v = recursion(decay, (1 - decay) * s, s[0])[:-1]
        s = np.asarray(s + (v - s) * (tau2 / h * (1 - decay)), dtype=np.float64)
    kick = np.zeros_like(s)
    kick[1:] = np.diff(s, axis=0)
    if local.tau is None:
        decay, held = np.ones_like(s), np.broadcast_to(h, s.shape)
    else:
        tau = np.exp(_between(local.tau))
        decay = np.exp(-h / tau)
        held = tau * (1 - decay)
    # The two recursions of q and y
    gain = np.exp(_between(local.b)) * held
    q = recursion(decay[:-1], kick[1:], kick[0] if start is None else kick[0] + start)
    y = np.zeros((len(kick) + 1, *kick.shape[1:]))
    np.cumsum(q * gain, axis=0, out=y[1:])
    return y


def _filled(several: Sequence[FloatArray], rows: int) -> FloatArray:
    """The arrays beside each other, each filled up with its last value."""
    return np.stack([np.pad(values, (0, rows - len(values)), mode="edge") for values in several], axis=1)


def push_ways(batch: Batch, local: Local, outside: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """y where a variable itself moves it, by each of the ways it may take: as co does, and past the second lag.

    A flow meets the heat that is stored and not the steam valve. outside : variables at every row. Each of shape
    (rows, stretches, variants).
    """
    ways = []
    for x in outside:
        away = (x[1:] + x[:-1]) / 2 - x[0]
        moved = np.broadcast_to(away[..., None], (*away.shape, local.b.shape[2]))
        ways.append(response(local, moved, batch.h_s))
        if local.tau2 is not None:
            ways.append(response(local._replace(tau2=None), moved, batch.h_s))
    return tuple(ways)


def drifted(batch: Batch, local: Local, ln_k: FloatArray) -> FloatArray:
    """y where the gain changes by an outside variable while pv is away from where it was: (rows, stretches, variants).

    The input at rest is v0(y, x) = v0(y0, x) + (y - y0) / k(x). Of its change with x the first part is a push of
    unknown size; the second follows from k and the pv that was recorded. ln_k : that part of ln k which follows
    outside variables.
    """
    if local.tau is None:
        return np.zeros_like(local.b)
    away = _between(batch.pv - np.mean(batch.pv, axis=0))[..., None]
    moved = -away * np.exp(-_between(local.b + local.tau)) * np.diff(ln_k, axis=0)
    return response(local._replace(tau2=None), -np.cumsum(moved, axis=0), batch.h_s)


def _between(rows: FloatArray) -> FloatArray:
    return np.asarray((rows[:-1] + rows[1:]) / 2, dtype=np.float64)


BLOCK = 32  # rows that are gone through at a time
LEAST_DECAY = 1e-8
"""What has decayed further than this within a row counts as that: products over a block stay far from zero."""


def recursion(decay: FloatArray, moved: FloatArray, start: FloatArray) -> FloatArray:
    """x_0 = start, x_(i+1) = decay_i x_i + moved_i along the first axis; by blocks, x_(j+1) = P_j (x_0 + sum m_i/P_i).

    P_j is the product of the decays of a block up to j.
    """
    decay = np.broadcast_to(np.maximum(decay, LEAST_DECAY), moved.shape)
    x = np.empty((len(moved) + 1, *moved.shape[1:]))
    x[0] = start
    for first in range(0, len(moved), BLOCK):
        block = slice(first, first + BLOCK)
        product = np.cumprod(decay[block], axis=0)
        x[1:][block] = product * (x[first] + np.cumsum(moved[block] / product, axis=0))
    return x
