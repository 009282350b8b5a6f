"""The installed characteristic: how strongly a percent of co acts, over co itself.

    v = phi(u),   ln phi'(u) = slope and bends over co, without a level of its own (that is the slope gain's)

A valve's curve, burst firing, a fan's law: on the way co is far from where it rests, and the process answers there with
another gain than at rest. A fit that knows only the place of pv puts that into lags and bends of the place
(Hammerstein model; Narendra and Gallman 1966). At rest the two are one: the gain at a place is that of the co which
holds it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.schedule_design.shapes import Axis, Shape
from retuner.adaptive.schedule_design.stretches import Signals, Stretch
from retuner.adaptive.signals.sample import FloatArray

GRID = 101
"""Values of co at which phi is worked out; a straight line between."""
LEAST_TRAVEL = 1e-6
"""Of co, as a share of its size, below which it has no characteristic."""


@dataclass(frozen=True, slots=True)
class Characteristic:
    """Over axis, the range of co in the records. shape : LINE or BENT; CONSTANT is co as it is.

    slope : of ln phi' per unit of co, as it is known beforehand. doubt : of its coefficients, 1 where nothing is.
    """

    axis: Axis
    shape: Shape = Shape.CONSTANT
    slope: float = 0.0
    doubt: float = 1.0

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.shape) - 1

    def columns(self, co: FloatArray) -> FloatArray:
        """d ln phi'/dz at co, shape (*co.shape, size)."""
        return self.doubt * self.axis.columns(co, self.shape)[..., 1:]

    def known(self, co: FloatArray) -> FloatArray:
        """ln phi' as it is known beforehand, shape (*co.shape); 0 in the middle of the axis."""
        inside = np.clip(co, self.axis.low, self.axis.high)
        return np.asarray(self.slope * (inside - (self.axis.low + self.axis.high) / 2), dtype=np.float64)

    def felt(self, co: FloatArray, z: FloatArray) -> FloatArray:
        """phi(co) for each variant of z, shape (size, variants): (n, variants). Beyond the axis its slope stays."""
        grid = self.axis.grid(GRID)
        rate = np.exp(self.known(grid)[:, None] + self.columns(grid) @ z)
        width = (self.axis.high - self.axis.low) / (GRID - 1)
        summed = np.concatenate([np.zeros((1, z.shape[1])), np.cumsum((rate[1:] + rate[:-1]) / 2 * width, axis=0)])
        inside = np.clip(co, self.axis.low, self.axis.high)
        found = [np.interp(inside, grid, summed[:, i]) for i in range(z.shape[1])]
        ends = np.where((co > self.axis.high)[:, None], rate[-1], rate[0])
        return np.asarray(np.stack(found, axis=1) + (co - inside)[:, None] * ends, dtype=np.float64)


def over(stretches: Sequence[Stretch], shape: Shape = Shape.BENT) -> Characteristic | None:
    """Over what co does in the records; None where it stands still."""
    rates = [np.diff(s.fired(s.t_s)) / np.diff(s.t_s) for s in stretches]
    low, high = min(float(np.min(r)) for r in rates), max(float(np.max(r)) for r in rates)
    if not high - low > LEAST_TRAVEL * max(abs(low), abs(high)):
        return None
    return Characteristic(Axis(low, high), shape)


def summed(characteristic: Characteristic, stretches: Sequence[Stretch], z: FloatArray) -> list[FloatArray]:
    """The integral of phi(co) until each of a stretch's Signals.begun_s, (n, variants), for each; worked out once."""
    done: list[tuple[Signals, FloatArray]] = []
    found = []
    for stretch in stretches:
        signals = stretch.signals
        known = next((values for of, values in done if of is signals), None)
        if known is None:
            held = np.diff(signals.begun_s)
            felt = characteristic.felt(np.diff(signals.fired) / held, z) * held[:, None]
            known = np.concatenate([np.zeros((1, z.shape[1])), np.cumsum(felt, axis=0)])
            done.append((signals, known))
        found.append(known)
    return found
