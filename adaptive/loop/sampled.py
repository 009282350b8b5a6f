"""The response of a sampled loop to a setpoint step, exact at the samples.

    pv = h * co,   co = c_r * sp - c_y * pv   ->   pv = h * c_r * sp / (1 + h * c_y)

with * the convolution of series in the sample: h is what one held sample of co does to pv, c_r and c_y are the control
law's answers to one sample of sp and of pv (schedule/pid.py). The division is made where products of series are
products of values: on a circle in the z plane, a little outside the unit circle so that a response has died away after
one turn (Cauchy's formula by fast Fourier transform, Abate & Whitt 1992).
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

Spectrum = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class SampledLaw:
    """gains : parallel. dt_s : sampling interval. b : setpoint weight. filter_s : of the derivative."""

    gains: PidGains
    dt_s: float
    b: float = 1.0
    filter_s: float = 0.0

    def series(self, n: int) -> tuple[FloatArray, FloatArray]:
        """c_r and c_y, shape (n,) each."""
        from_sp = np.full(n, self.gains.ki * self.dt_s)
        from_pv = from_sp.copy()
        from_sp[0], from_pv[0] = self.b * self.gains.kp, self.gains.kp
        if self.gains.kd:
            whole = self.filter_s + self.dt_s
            left = (self.filter_s / whole) ** np.arange(n)
            slope = left / whole
            slope[1:] -= left[:-1] / whole
            from_pv += self.gains.kd * slope
        return from_sp, from_pv


OVERSAMPLED = 4  # points on the circle for each sample
ALIAS = 1e-14  # what the first term of the next turn round the circle counts in this one
BEFORE = 1e-6
"""Share of the largest value that rounding may leave in the last quarter of the turn, which is before the step."""


@lru_cache(maxsize=64)
def _on_the_circle(law: SampledLaw, n: int, size: int) -> tuple[Spectrum, Spectrum]:
    """c_r and c_y on the circle: the same for every process that is tried."""
    shrunk = ALIAS ** (np.arange(n) / size)
    from_sp, from_pv = (np.fft.rfft(series * shrunk, size) for series in law.series(n))
    return from_sp, from_pv


def setpoint_response(held: FloatArray, law: SampledLaw) -> FloatArray:
    """pv after a unit setpoint step in sample 0, shape (n,).

    held : pv after co has stepped by one in sample 0, shape (n,), 0 in sample 0: co acts from then on. Not a number
    where the loop runs away so fast that its poles lie outside the circle: what is found then came before the step.
    """
    n = len(held)
    size = 1 << (OVERSAMPLED * n - 1).bit_length()
    shrunk = ALIAS ** (np.arange(n) / size)
    pulse = np.fft.rfft(np.diff(held, prepend=0.0) * shrunk, size)
    from_sp, from_pv = _on_the_circle(law, n, size)
    turned = np.fft.irfft(pulse * from_sp / (1 + pulse * from_pv), size)
    if not np.max(np.abs(turned[-size // OVERSAMPLED :])) <= BEFORE * np.max(np.abs(turned)):
        return np.full(n, np.nan)
    return np.asarray(np.cumsum(turned[:n] / shrunk), dtype=np.float64)
