"""From roots to time constants, and to polynomials: how other tools write what process.py holds.

    k' prod(s - z_i) / prod(s - p_j)  =  k prod(1 - s/z_i) / (s^n prod(1 - s/p_j)),   lag = -1/p,  lead = -1/z

Poles at the origin are integrators. Conjugate poles p, p* are the factor 1 - 2 Re(p) s/|p|^2 + s^2/|p|^2, with
damping -Re(p)/|p|; the roots of a multiple pole come out of a polynomial as a small ring round it, whose pairs have a
damping of nearly one and whose sum of time constants is right.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from retuner.adaptive.process.model import LinearProcess

AT_ORIGIN = 1e-9
"""Roots smaller than this share of the largest are at the origin: single precision resolves 1e-7 of a coefficient."""
REAL_DAMPING = 0.99
"""Zeros of more damping are taken as two real ones: the ring that a double zero's rounding makes of it."""
UNSTABLE = 1e-6  # A pole this share of its size to the right of the imaginary axis is unstable, not rounded

Roots = Sequence[complex] | npt.NDArray[np.complex128] | npt.NDArray[np.float64]


def from_roots(zeros: Roots, poles: Roots, gain: float, theta_s: float = 0.0) -> LinearProcess:
    """The process gain prod(s - z)/prod(s - p) e^(-theta s), as scipy.signal's ZerosPolesGain has it.

    Raises ValueError: an unstable pole, a zero at the origin (no steady effect), or complex zeros: none of the models
    has these.
    """
    z, p = np.asarray(zeros, dtype=np.complex128), np.asarray(poles, dtype=np.complex128)
    scale = float(max(np.max(np.abs(z), initial=0.0), np.max(np.abs(p), initial=0.0)))
    if np.any(np.abs(z) <= AT_ORIGIN * scale) and z.size:
        raise ValueError("a zero at the origin: this process has no steady or ramping effect that a PID could use")
    moving = p[np.abs(p) > AT_ORIGIN * scale]
    wrong = moving[moving.real > UNSTABLE * np.abs(moving)]
    if wrong.size:
        raise ValueError(
            f"a pole at {_shown(wrong[0])} per second is unstable; the models have stable poles and integrators"
        )
    k = gain * float(np.real(np.prod(-z) / np.prod(-moving)))
    lags = sorted((-1 / float(p.real) for p in moving if p.imag == 0), reverse=True)
    pairs = [(max(-2 * float(p.real), 0.0) / abs(p) ** 2, 1 / abs(p) ** 2) for p in moving if p.imag > 0]
    leads = [-1 / float(one.real) for one in z if one.imag == 0]
    for one in z[z.imag > 0]:  # a nearly real pair is a double one
        if abs(one.real) < REAL_DAMPING * abs(one):
            raise ValueError(
                f"complex zeros at {_shown(one)} and its conjugate: the models have real numerator time constants only"
            )
        leads += [-float(one.real) / abs(one) ** 2] * 2
    return LinearProcess(k, tuple(lags), tuple(leads), theta_s, len(p) - len(moving), tuple(pairs))


def _shown(root: complex) -> str:
    return f"{root.real:.4g}" + (f"{root.imag:+.4g}j" if root.imag else "")


def to_polynomials(process: LinearProcess, pade_order: int) -> tuple[list[float], list[float]]:
    """num and den of a process, highest power first, its dead time by a Pade approximation of this order.

    Raises ValueError: there is dead time, and the order is not positive.
    """
    num, den = np.array([process.k]), np.array([1.0])
    for lead in process.leads_s:
        num = np.polymul(num, [lead, 1.0])
    factors = [[lag, 1.0] for lag in process.lags_s if lag] + [[c2, c1, 1.0] for c1, c2 in process.quadratics]
    for factor in [*factors, *([[1.0, 0.0]] * process.integrators)]:
        den = np.polymul(den, factor)
    if process.theta_s:
        late, early = pade(process.theta_s, pade_order)
        num, den = np.polymul(num, late), np.polymul(den, early)
    return num.tolist(), den.tolist()


def pade(theta_s: float, order: int) -> tuple[list[float], list[float]]:
    """Numerator and denominator of the diagonal Pade approximation of e^(-theta s), highest power first.

    Coefficients (2n - j)! n! / ((2n)! j! (n - j)!) theta^j (Golub & Van Loan 2013, section 9.3). Its phase
    is right to 0.2 degrees up to w = n / theta for n >= 5, and soon wrong beyond.

    Raises ValueError: the order is not positive.
    """
    if order < 1:
        raise ValueError(f"pade_order = {order}: a dead time of {theta_s:g} s needs a positive order, 5 for example")
    c = [
        math.factorial(2 * order - j)
        * math.factorial(order)
        / (math.factorial(2 * order) * math.factorial(j) * math.factorial(order - j))
        * theta_s**j
        for j in range(order, -1, -1)
    ]
    return [x * (-1) ** (order - i) for i, x in enumerate(c)], c
