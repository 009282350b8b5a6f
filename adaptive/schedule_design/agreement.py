"""How far the stretches agree on the curves through them, and what that says of how well the curves are known.

No equation is quite a plant's, no curve quite its own, and what is wrong with either looks in each stretch as if ln p
were another there: a lag twice too long on the way up and too short on the way down. So the stretches are allowed to
differ, ln p = curve + d_j with d_j ~ N(0, V), V diagonal, and V is what makes what is left likeliest:

    ln L(V) = sum_j  1/2 g_j' (V^-1 + I_j)^-1 g_j - 1/2 ln det(I + V I_j),     g_j = -A_j' r_j / c,  I_j = A_j' A_j / c

with A_j = dr_j/d(ln p) of a whole stretch (random effects: Laird and Ware 1982). The covariance of the coefficients is
then that of curves through local models which differ by V, instead of one that believes every sample of every stretch.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from retuner.adaptive.schedule_design.joint import At, Form
from retuner.adaptive.schedule_design.shapes import LEVEL_STD
from retuner.adaptive.signals.sample import FloatArray

DIFFERENCES = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
"""Standard deviations of ln p between stretches that are tried."""
ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Agreement:
    """differences : standard deviation of each ln p between the stretches. covariance : of the coefficients."""

    differences: tuple[float, ...]
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class _Piece:
    """One stretch by what its samples say: of ln p as a whole (information, score), of the coefficients, of both."""

    information: FloatArray
    score: FloatArray
    coefficients: FloatArray
    mixed: FloatArray

    def likelihood(self, v: FloatArray) -> float:
        """ln L of these variances."""
        s = np.sqrt(v)
        inner = np.eye(len(v)) + s[:, None] * self.information * s
        pulled = s * self.score
        return 0.5 * float(pulled @ np.linalg.solve(inner, pulled)) - 0.5 * float(np.linalg.slogdet(inner)[1])

    def known(self, v: FloatArray) -> FloatArray:
        """What it says of the coefficients when its ln p may differ by v."""
        s = np.sqrt(v)
        inner = np.eye(len(v)) + s[:, None] * self.information * s
        share = s[:, None] * self.mixed
        return self.coefficients - share.T @ np.linalg.solve(inner, share)


def agreement(form: Form, now: At, sizes: Sequence[int], c: float) -> Agreement:
    """Of a fit with its derivatives.

    sizes : rows of r by stretch. c : variance of r over that of white noise.
    """
    assert now.jacobian is not None
    whole = np.stack([now.jacobian[:, place.start] / LEVEL_STD for place in form.places], axis=1)
    pieces = []
    for first, end in pairwise(np.cumsum([0, *sizes]).tolist()):
        a, j, r = whole[first:end], now.jacobian[first:end], now.r[first:end]
        pieces.append(_Piece(a.T @ a / c, -a.T @ r / c, j.T @ j / c, a.T @ j / c))
    v = _likeliest(pieces, len(form.places))
    information = np.eye(form.size) + sum(piece.known(v) for piece in pieces)
    return Agreement(tuple(np.sqrt(v).tolist()), np.asarray(np.linalg.inv(information), dtype=np.float64))


def _likeliest(pieces: Sequence[_Piece], count: int) -> FloatArray:
    """The variances with the largest likelihood, one after the other."""
    v = np.zeros(count)
    for _ in range(ROUNDS):
        for i in range(count):
            tried = {std: v.copy() for std in DIFFERENCES}
            for std, other in tried.items():
                other[i] = std**2
            v = max(tried.values(), key=lambda other: sum(piece.likelihood(other) for piece in pieces))
    return v
