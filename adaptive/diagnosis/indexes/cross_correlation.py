"""Cross-correlation of co and pv round lag 0 (Horch 1999): odd for a sticking valve, even for other oscillations.

    r(k) = sum_i co_i pv_(i+k),     t_l, t_r   lags of the first zero crossings left and right of lag 0,
    dtau = |t_l - t_r| / (t_l + t_r),
    drho = |r(0) - r_opt| / |r(0) + r_opt|,   r_opt = sign(r(0)) max |r(k)|,  -t_l <= k <= t_r

Both lie in 0 to 1: above 2/3 the correlation is odd (a sticking valve in a self-regulating loop with PI control), below
1/3 it is even (aggressive tuning, outside oscillation). Not for integrating processes: there both cases look alike.
"""

from typing import NamedTuple

import numpy as np

from retuner.adaptive.diagnosis.indexes.crossings import crossings, detrended
from retuner.adaptive.sample import FloatArray


class CrossCorrelation(NamedTuple):
    """Horch's two measures, 0 even to 1 odd."""

    dtau: float
    drho: float


def cross_correlation(pv: FloatArray, co: FloatArray, band: float = 0.02) -> CrossCorrelation | None:
    """Horch's measures; None where the correlation does not cross zero on both sides of lag 0.

    Parameters
    ----------
    pv, co : an oscillating record, shape (n,). band : correlations within +-band of the largest one count as zero.

    Source: Horch (1999), Control Engineering Practice 7, 1221-1231.
    """
    n = len(pv)
    length = 1 << (2 * n - 1).bit_length()
    product = np.fft.rfft(detrended(pv), length) * np.fft.rfft(detrended(co), length).conj()
    circular = np.fft.irfft(product)
    reach = n // 2
    r = np.concatenate([circular[-reach:], circular[: reach + 1]])
    largest = float(np.max(np.abs(r)))
    if largest <= 0:
        return None
    at = crossings(r, band * largest) - reach
    left, right = at[at < 0], at[at >= 0]
    if not left.size or not right.size:
        return None
    t_l, t_r = -float(left[-1]), float(right[0])
    part = r[reach + int(np.ceil(-t_l)) : reach + int(t_r) + 1]
    r0 = float(r[reach])
    sign = 1.0 if r0 >= 0 else -1.0
    r_opt = sign * float(np.max(np.abs(part), initial=abs(r0)))
    drho = abs(r0 - r_opt) / abs(r0 + r_opt) if r0 + r_opt else 1.0
    return CrossCorrelation(abs(t_l - t_r) / (t_l + t_r), drho)
